#!/usr/bin/env python3
"""Recordings of the built program, read by the stock Python reader.

    python3 tests/recorder/suite.py [NAME...]            all tests, or those whose name holds one of the words
    python3 tests/recorder/suite.py --load SECONDS       the canonical load with and without a recorder, figures as JSON

Invariant: the program is driven from outside only, and nothing here knows how a recorder works. Prints what libtest prints, since
`tests/run` counts by that; exit 77 when the packages of packages.txt cannot be had.
"""

import argparse
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
BIN = pathlib.Path(os.environ.get("TROCAR_BIN_DIR", TARGET / "release"))
VENV = TARGET / "recorder-venv"
# Nothing here is judged by time; this only ends what would hang.
PATIENCE_S = 120
OK, REFUSED, USAGE, PARTIAL = 0, 1, 2, 5
SKIPPED = 77


class Skip(Exception):
    """Why a test cannot run here."""


def enter_venv():
    """Makes the venv where it is missing, and goes on in it."""
    python = VENV / "bin" / "python"
    if pathlib.Path(sys.prefix) == VENV:
        return
    if not python.exists():
        made = subprocess.run([sys.executable, "-m", "venv", str(VENV)], capture_output=True, text=True)
        if made.returncode:
            print(f"suite.py: no venv can be made: {made.stderr.strip()[-200:]}")
            sys.exit(SKIPPED)
    install = [python, "-m", "pip", "install", "-q", "--retries", "1", "-r", str(HERE / "packages.txt")]
    done = subprocess.run(install, capture_output=True, text=True)
    if done.returncode:
        print(f"suite.py: the packages of packages.txt cannot be had: {done.stderr.strip().splitlines()[-1:]}")
        sys.exit(SKIPPED)
    os.execv(python, [str(python), *sys.argv])


def eventually(what, probe):
    """Asks again until it is so."""
    end = time.monotonic() + PATIENCE_S
    while True:
        answer = probe()
        if answer:
            return answer
        if time.monotonic() > end:
            raise AssertionError(f"never: {what}; last seen: {answer!r}")
        time.sleep(0.02)


class World:
    """A host in a directory of its own, ended with the test."""

    def __init__(self, plugins):
        self.dir = pathlib.Path(tempfile.mkdtemp(prefix="trocar-recorder-"))
        (self.dir / "plugins").mkdir()
        (self.dir / "rec").mkdir()
        for name in ("recorder", *plugins):
            shutil.copy(BIN / f"libtrocar_{name}.so", self.dir / "plugins")
        self.env = {**os.environ, "XDG_STATE_HOME": str(self.dir / "state"), "NO_COLOR": "1"}
        self.env.pop("TROCAR_GCM", None)
        self.log = open(self.dir / "host.log", "w+")
        command = [BIN / "trocar", "host", "--name", "host", "--plugins", "plugins", "--listen", "127.0.0.1:0",
                   "--state", "host-state"]
        self.host = subprocess.Popen(command, cwd=self.dir, env=self.env, stdout=self.log, stderr=subprocess.STDOUT)
        address = eventually("the host says its address", self.address)
        self.env["TROCAR_GCM"] = address
        eventually("the classes are there", lambda: "recorder/recorder" in self.run("ls", "--json").stdout or None)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.host.poll() is None:
            self.host.terminate()
            try:
                self.host.wait(20)
            except subprocess.TimeoutExpired:
                self.host.kill()
                self.host.wait()
        self.log.close()
        shutil.rmtree(self.dir, ignore_errors=True)

    def address(self):
        found = re.search(r"127\.0\.0\.1:\d+", (self.dir / "host.log").read_text())
        return found and found.group(0)

    def run(self, *words, code=None):
        done = subprocess.run([BIN / "trocar", *map(str, words)], cwd=self.dir, env=self.env, capture_output=True, text=True,
                              timeout=PATIENCE_S)
        if code is not None and done.returncode != code:
            raise AssertionError(f"trocar {' '.join(map(str, words))}: {done.returncode}, not {code}\n{done.stdout}\n{done.stderr}")
        return done

    def json(self, *words, code=OK):
        return json.loads(self.run(*words, "--json", code=code).stdout)

    def call(self, path, arg=None, code=OK):
        words = ["call", path] + ([] if arg is None else [json.dumps(arg)])
        return self.run(*words, "--deadline", "20s", code=code)

    def read(self, path):
        return json.loads(self.call(path).stdout)

    def source(self, name="sine", cls="sine", config=None):
        self.run("create", f"host/{name}", cls, "--config", json.dumps(config or {}), code=OK)
        self.run("start", f"host/{name}", code=OK)
        return f"host/{name}"

    def recorder(self, connections, config=None):
        """A recorder that runs, connected by name to what is said."""
        config = {"directory": "rec", "topics": list(connections), **(config or {})}
        self.run("create", "host/rec", "recorder", "--config", json.dumps(config), code=OK)
        for name, server in connections.items():
            self.run("connect", f"host/rec/{name}", server, "--fifo", "4096", code=OK)
        self.run("start", "host/rec", code=OK)

    def begin(self, path, delay=0, duration=0, code=OK):
        return self.call("host/rec/ctl/start", {"path": path, "delay": delay, "duration": duration}, code=code)

    def wait(self, what, wanted):
        return eventually(what, lambda: (lambda s: s if wanted(s) else None)(self.read("host/rec/ctl/status")))

    def end(self):
        self.call("host/rec/ctl/stop")
        return eventually("the file is closed", lambda: (lambda s: s if s["reason"] else None)(self.read("host/rec/ctl/last")))


def messages(path, whole=True):
    """Topic -> [(record, decoded)], metadata, and whether the reader came to the file's end."""
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader, make_reader
    from mcap_protobuf.decoder import DecoderFactory
    topics, ended = {}, True
    with open(path, "rb") as file:
        factories = [DecoderFactory()]
        reader = make_reader(file, decoder_factories=factories) if whole else NonSeekingReader(file, decoder_factories=factories)
        decoders = {}
        try:
            for schema, channel, message in reader.iter_messages(log_time_order=whole):
                if channel.message_encoding == "json":
                    value = json.loads(message.data)
                else:
                    if channel.id not in decoders:
                        decoders[channel.id] = factories[0].decoder_for(channel.message_encoding, schema)
                    value = decoders[channel.id](message.data)
                topics.setdefault(channel.topic, []).append((message, value))
        except EndOfFile:
            ended = False
        metadata = {m.name: m.metadata for m in reader.iter_metadata()} if whole else {}
    return topics, metadata, ended


def contiguous(records):
    numbers = [message.sequence for message, _ in records]
    return all(b == a + 1 for a, b in zip(numbers, numbers[1:]))


# ---- tests

def test_a_recording_by_the_command_line_is_whole_and_explains_itself():
    with World(["sine"]) as world:
        world.source()
        done = world.json("record", "host/**", "-o", "a.mcap", "--seconds", "1.5")
        assert done["lost"] == 0 and done["whole"] and done["topics"] >= 1, done
        topics, metadata, _ = messages(world.dir / "a.mcap")
        values = topics["/host/sine/value"]
        assert len(values) > 100 and contiguous(values), len(values)
        assert all(-1.0 <= value.value <= 1.0 for _, value in values)
        assert any(value.value != values[0][1].value for _, value in values)
        assert all(message.publish_time == value.stamp and message.log_time >= message.publish_time for message, value in values)
        graph = topics["/recorder/graph"][0][1]
        assert "host/sine" in [c["path"] for c in graph["components"]]
        assert len(metadata["trocar.plugins"]["sine"].split("sha256:")[1]) == 64
        assert int(metadata["trocar.clock"]["offset_to_unix_ns"]) != 0 and metadata["trocar.end"]["lost"] == "0"
        info = world.json("info", "a.mcap")
        assert info["whole"] and info["profile"] == "trocar"
        counted = {t["topic"]: t["messages"] for t in info["topics"]}
        assert counted["/host/sine/value"] == len(values), counted
        # Nothing of it stays behind.
        assert [c["path"] for c in world.json("ls")["components"]] == ["host/sine"]


def test_commands_begin_pause_mark_thin_and_end_a_recording():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"all": f"{sine}/value", "some": f"{sine}/value"}, {"every": [1, 10]})
        world.call("host/rec/ctl/marker", "too early", code=REFUSED)
        world.begin("a.mcap")
        world.wait("it records", lambda s: s["phase"] == "RECORDING" and s["messages"] > 200)
        world.call("host/rec/ctl/marker", "incision")
        world.call("host/rec/ctl/annotate", {"kind": "operator", "json": '{"name": "A"}'})
        world.call("host/rec/ctl/pause")
        world.wait("it pauses", lambda s: s["phase"] == "PAUSED")
        world.call("host/rec/ctl/resume")
        before = world.read("host/rec/ctl/status")["messages"]
        world.call("host/rec/ctl/thin", {"input": "all", "every": 1, "max_rate": 20.0})
        world.wait("it goes on", lambda s: s["phase"] == "RECORDING" and s["messages"] > before + 50)
        last = world.end()
        assert last["whole"] and last["reason"] == "stopped as asked" and last["lost"] == 0, last
        topics, _, _ = messages(world.dir / "rec/a.mcap")
        assert topics["/recorder/markers"][0][1].message == "incision"
        assert topics["/recorder/note_operator"][0][1] == {"name": "A"}
        values = topics["/host/sine/value"]
        assert len(values) > 200, len(values)


def test_a_pre_trigger_puts_the_past_into_a_recording():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"}, {"pre_trigger_s": 2.0})
        begun = world.read("host/rec/ctl/status")
        assert begun["phase"] == "IDLE"
        time.sleep(1.0)  # What is recorded of this second is the claim; how long it takes is none.
        world.begin("a.mcap")
        world.wait("it records", lambda s: s["messages"] > 100)
        world.end()
        topics, metadata, _ = messages(world.dir / "rec/a.mcap")
        values = topics["/host/sine/value"]
        begun_ns = int(metadata["trocar.graph"]["monotonic_ns"])
        before = [message for message, _ in values if message.log_time < begun_ns]
        assert contiguous(values) and len(before) > 100, (len(before), len(values))


def test_a_recorder_that_is_killed_leaves_what_was_written_to_stock_readers():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"})
        world.begin("a.mcap")
        world.wait("it records", lambda s: s["messages"] > 500)
        world.host.send_signal(signal.SIGKILL)
        world.host.wait()
        topics, _, ended = messages(world.dir / "rec/a.mcap", whole=False)
        values = topics["/host/sine/value"]
        assert not ended and len(values) > 400 and contiguous(values), len(values)
        told = world.run("info", "rec/a.mcap", code=PARTIAL)
        assert "before it could close it" in told.stderr, told.stderr
        world.run("export", "rec/a.mcap", "--csv", code=PARTIAL)
        rows = (world.dir / "rec/a/host_sine_value.csv").read_text().splitlines()
        assert len(rows) == len(values) + 1, (len(rows), len(values))


def test_a_full_disk_ends_a_recording_with_a_whole_file_and_disturbs_nobody():
    with World(["sine"]) as world:
        disk = world.dir / "rec"
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", disk], capture_output=True, text=True)
        if mounted.returncode:
            raise Skip(f"no tmpfs can be mounted: {mounted.stderr.strip()}")
        try:
            sine = world.source()
            world.recorder({"a": f"{sine}/value"})
            world.begin("a.mcap")
            world.wait("it records", lambda s: s["messages"] > 20)
            filler = disk / "filler"
            with open(filler, "wb") as file:
                try:
                    while True:
                        os.posix_fallocate(file.fileno(), file.tell(), file.tell() + 4096)
                        file.seek(4096, 1)
                except OSError:
                    pass
            last = eventually("it ends by itself", lambda: (lambda s: s if s["reason"] else None)(world.read("host/rec/ctl/last")))
            assert last["whole"] and "disk is full" in last["reason"], last
            topics, metadata, ended = messages(disk / "a.mcap")
            assert ended and "disk is full" in metadata["trocar.end"]["reason"]
            assert contiguous(topics["/host/sine/value"])
            states = {c["path"]: c["state"] for c in world.json("ls")["components"]}
            assert states == {"host/sine": "ACTIVE", "host/rec": "ACTIVE"}, states
            filler.unlink()
            world.begin("b.mcap")
            world.wait("it records again", lambda s: s["messages"] > 50)
            assert world.end()["whole"]
        finally:
            subprocess.run(["umount", "-l", disk], capture_output=True)


def test_video_is_recorded_raw_and_without_loss_in_less_room():
    with World(["stereo"]) as world:
        camera = world.source("camera", "phantom_source", {"width": 160, "height": 120})
        for kind in ("raw", "qoi", "jpeg"):
            done = world.json("record", f"{camera}/image", "-o", f"{kind}.mcap", "--seconds", "1", "--video", kind)
            assert done["messages"] > 4 and done["whole"], done
            topics, _, _ = messages(world.dir / f"{kind}.mcap")
            image = topics["/host/camera/image/left"][0][1]
            assert set(topics) >= {"/host/camera/image/left", "/host/camera/image/right"}
            if kind == "raw":
                assert (image.width, image.height) == (160, 120) and len(image.data) >= image.step * 119
            else:
                assert image.format == kind and image.data[:4] in (b"qoif", b"\xff\xd8\xff\xe0"), image.format
            world.run("export", f"{kind}.mcap", "--png", code=OK)
            ending = "jpg" if kind == "jpeg" else "png"
            picture = world.dir / kind / "host_camera_image_left" / f"000000.{ending}"
            assert picture.read_bytes()[1:4] == b"PNG" or kind == "jpeg"


def test_numbers_go_to_numpy_and_tables():
    import numpy as np
    with World(["sine", "eyerobot"]) as world:
        world.source()
        world.source("robot", "eyerobot")
        world.json("record", "host/sine/value", "host/robot/tip", "-o", "a.mcap", "--seconds", "1")
        world.run("export", "a.mcap", "--npz", code=OK)
        arrays = np.load(world.dir / "a.npz")
        n = len(arrays["host/sine/value/value"])
        assert n > 100 and arrays["host/sine/value/log_time_ns"].shape == (n,)
        assert arrays["host/robot/tip/pose.position"].shape[1] == 3
        world.run("export", "a.mcap", "--csv", "--from", "300ms", "--to", "600ms", "--topic", "host/sine", code=OK)
        rows = (world.dir / "a/host_sine_value.csv").read_text().splitlines()
        assert rows[0] == "log_time_ns,publish_time_ns,sequence,stamp,value" and 1 < len(rows) < n, rows[:2]
        assert [p.name for p in (world.dir / "a").iterdir()] == ["host_sine_value.csv"]


def test_bad_input_is_refused_in_a_sentence_and_nothing_is_written_over():
    with World(["sine"]) as world:
        sine = world.source()
        precious = world.dir / "there.mcap"
        precious.write_text("precious")
        for words, code, says in (
            (["record", "host/**", "-o", "there.mcap"], REFUSED, "nothing is written over"),
            (["record", "host/nothing/**", "-o", "a.mcap"], REFUSED, "host/sine/value"),
            (["record", "host/**", "-o", "a.txt"], USAGE, ".mcap"),
            (["record", "host/**", "-o", "nowhere/a.mcap"], REFUSED, "make the directory"),
            (["record", "host/**", "-o", "a.mcap", "--seconds", "-1"], USAGE, "seconds"),
            (["record", "host/**", "-o", "a.mcap", "--seconds", "nan"], USAGE, "seconds"),
            (["record", "host/**", "-o", "a.mcap", "--max-rate-hz", "1e30"], USAGE, "1000000"),
            (["record", "host/**", "-o", "a.mcap", "--in", "elsewhere"], REFUSED, "elsewhere"),
            (["info", "there.mcap"], REFUSED, "no MCAP file"),
            (["info", "missing.mcap"], REFUSED, "cannot be read"),
            (["export", "there.mcap", "--csv"], REFUSED, "no MCAP file"),
        ):
            done = world.run(*words)
            assert done.returncode == code and says in done.stderr + done.stdout, (words, done.returncode, done.stderr)
        assert precious.read_text() == "precious" and not list(world.dir.glob("a.*"))
        world.recorder({"a": f"{sine}/value"})
        (world.dir / "rec/there.mcap").write_text("precious")
        for path, says in (("../a.mcap", "leads out"), ("/tmp/a.mcap", "outside"), ("there.mcap", "nothing is written over"),
                           ("a", ".mcap"), ("none/a.mcap", "make it first")):
            refused = world.begin(path, code=REFUSED)
            assert says in refused.stderr, (path, refused.stderr)
        for delay, duration in ((-1, 0), (1e300, 0), (0, -5)):
            assert "is not between" in world.call("host/rec/ctl/start", {"path": "x.mcap", "delay": delay, "duration": duration},
                                                  code=REFUSED).stderr
        for config in ({"topics": ["a", "a"]}, {"topics": ["a/b"]}, {"topics": ["a"], "max_rate_hz": [-1]},
                       {"topics": ["a"], "every": [0]}, {"topics": [], "every": [1]}, {"pre_trigger_s": 1e9}):
            refused = world.run("create", "host/bad", "recorder", "--config", json.dumps(config))
            assert refused.returncode != OK and "error:" in refused.stderr, (config, refused.stdout, refused.stderr)
            world.run("rm", "host/bad")
        assert (world.dir / "rec/there.mcap").read_text() == "precious"
        assert [p.name for p in (world.dir / "rec").iterdir()] == ["there.mcap"]


def test_hostile_recordings_end_in_a_sentence():
    import random
    with World(["sine"]) as world:
        world.source()
        world.json("record", "host/sine", "-o", "a.mcap", "--seconds", "0.5")
        good = (world.dir / "a.mcap").read_bytes()
        chance = random.Random(7)
        for n in range(40):
            bad = bytearray(good[: chance.randrange(9, len(good))] if n % 2 else good)
            for _ in range(chance.randrange(1, 30)):
                bad[chance.randrange(len(bad))] = chance.randrange(256)
            if n % 5 == 0:
                at = chance.randrange(8, len(bad) - 9)
                bad[at + 1 : at + 9] = (1 << chance.randrange(40, 64)).to_bytes(8, "little")
            path = world.dir / f"bad{n}.mcap"
            path.write_bytes(bad)
            for words in (["info", path], ["export", path, "--csv"], ["export", path, "--npz"]):
                done = world.run(*words)
                assert done.returncode in (OK, REFUSED, PARTIAL), (words, done.returncode, done.stderr[-500:])
                assert "panicked" not in done.stderr, done.stderr[-500:]


# ---- the load

def ticks(pid):
    """Processor time of each thread, s."""
    each = {}
    for task in pathlib.Path(f"/proc/{pid}/task").iterdir():
        try:
            stat = (task / "stat").read_text()
        except OSError:
            continue
        name, rest = stat[stat.index("(") + 1 : stat.rindex(")")], stat[stat.rindex(")") + 2 :].split()
        each[(task.name, name)] = (int(rest[11]) + int(rest[12])) / os.sysconf("SC_CLK_TCK")
    return each


def load(seconds):
    """1.13 Gbit/s of video, 4 kHz, 1 kHz: as much without a recorder as with one."""
    with World(["sine", "fixture_ledger", "eyerobot"]) as world:
        world.source("fast", "sine", {})
        world.run("stop", "host/fast")
        world.run("configure", "host/fast", "--rate-hz", "4000")
        world.run("start", "host/fast", code=OK)
        world.source("slow", "sine")
        world.run("create", "host/blank", "blank_source", "--config", "{}", "--model", "stream", "--rate-hz", "30", code=OK)
        world.run("start", "host/blank", code=OK)

        def figures():
            all_ = {c["path"]: c for c in world.json("ls")["components"]}
            return {p: (c.get("stats") or {}) for p, c in all_.items()}

        def measured(doing):
            for name in ("fast", "slow", "blank"):
                world.run("stop", f"host/{name}", code=OK)
                world.run("start", f"host/{name}", code=OK)
            before, begun = ticks(world.host.pid), time.monotonic()
            told = doing()
            spent, took = ticks(world.host.pid), time.monotonic() - begun
            cpu = {k[1]: round((v - before.get(k, 0)) / took, 4) for k, v in spent.items()}
            return told, figures(), cpu, took

        _, control, _, _ = measured(lambda: time.sleep(seconds))
        told, with_it, cpu, took = measured(
            lambda: world.run("record", "host/**", "-o", "load.mcap", "--seconds", str(seconds), "--json"))
        told = json.loads(told.stdout)
        own = sum(v for k, v in cpu.items() if k.startswith("rec-"))
        print(json.dumps({"recorded": told, "recorder_core": own, "control": control, "with": with_it,
                          "bits_per_s": told["bytes"] * 8 / seconds, "cpu": cpu, "load_average": os.getloadavg()}, indent=1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--load", type=float, metavar="SECONDS")
    args = parser.parse_args()
    enter_venv()
    if args.load:
        load(args.load)
        return
    tests = [(name, test) for name, test in globals().items() if name.startswith("test_")
             and (not args.names or any(word in name for word in args.names))]
    passed, failed = 0, 0
    for name, test in tests:
        try:
            test()
            word, passed = "ok", passed + 1
        except Skip as why:
            word, passed = "ok", passed + 1
            with open(os.environ.get("TROCAR_SKIPS", os.devnull), "a") as skips:
                skips.write(f"recorder::{name}: {why}\n")
        except Exception:
            traceback.print_exc()
            word, failed = "FAILED", failed + 1
        print(f"test recorder::{name} ... {word}", flush=True)
    print(f"test result: {'FAILED' if failed else 'ok'}. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
