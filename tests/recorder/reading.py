"""What becomes of a recording: pictures, arrays and tables of what was sent, Rerun; and what is refused on the way."""

import csv
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

from world import (BIN, FILLER, HERE, OK, PARTIAL, PATIENCE_S, REFUSED, ROOT, USAGE, VENV, Skip, World, messages, missing, opcodes,
                   passes_the_page_cache_by)


def test_video_is_recorded_raw_and_without_loss_in_less_room():
    with World(["stereo"]) as world:
        camera = world.source("camera", "phantom_source", {"width": 160, "height": 120})
        for kind in ("raw", "qoi", "jpeg"):
            least = {f"/{camera}/image": 3}
            done = world.record(f"{camera}/image", "-o", f"{kind}.mcap", "--video", kind, least=least)
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
            picture = world.dir / f"{kind}-png" / "host_camera_image_left" / f"000000.{ending}"
            assert picture.read_bytes()[1:4] == b"PNG" or kind == "jpeg"


def pairs(directory, many):
    """Stereo pairs in a folder, each image another one, larger than what the recorder copies: their pixels."""
    import numpy as np
    from PIL import Image
    directory.mkdir()
    y, x = np.mgrid[0:256, 0:320]
    made = []
    for n in range(many):
        pair = [np.stack([(x + 40 * n) % 256, (y * (2 + eye)) % 256, (x // 8 * 8 + y // 8 * 8 + 90 * n) % 256], axis=2).astype(np.uint8)
                for eye in range(2)]
        for name, pixels in zip(("left", "right"), pair):
            Image.fromarray(pixels).save(directory / f"{name}{n}.png")
        made.append(pair)
    return made


# Of each camera, of three that it sends in turn.
PAIRS = 20


def test_every_recorded_pixel_is_the_one_that_was_sent():
    import numpy as np
    from PIL import Image
    system = {"version": 1,
              "processes": {name: {"plugins": ["plugins"]} for name in ("host", "far")},
              "components": {path: {"class": "stereo/image_source", "config": {"directory": "pairs"}}
                             for path in ("host/camera", "far/camera")},
              "connections": []}
    with World(["stereo"], system, ready=lambda world: pairs(world.dir / "pairs", 3)) as world:
        sent = [[pixels.tobytes() for pixels in pair] for pair in world.made]
        sizes = {}
        for kind in ("raw", "qoi"):
            images = [f"/{process}/camera/image" for process in ("host", "far")]
            done = world.record("host/camera/image", "far/camera/image", "-o", f"{kind}.mcap", "--in", "host", "--video", kind,
                                least=dict.fromkeys(images, PAIRS))
            assert done["whole"], done
            topics, _, _ = messages(world.dir / f"{kind}.mcap")
            # A machine that does something else, too, may be too slow for all of it: then the counts say what
            # is not there.
            for eye in ("left", "right"):
                assert sum(missing(topics[f"{image}/{eye}"]) for image in images) == done["lost"], done
            frames = sum(len(topics[f"{image}/left"]) for image in images)
            sizes[kind] = (world.dir / f"{kind}.mcap").stat().st_size / frames
            world.run("export", f"{kind}.mcap", "--png", code=OK)
            for process in ("host", "far"):
                seen = []
                for eye, name in enumerate(("left", "right")):
                    images = topics[f"/{process}/camera/image/{name}"]
                    folder = world.dir / f"{kind}-png" / f"{process}_camera_image_{name}"
                    which = []
                    for n, (message, image) in enumerate(images):
                        exported = np.asarray(Image.open(folder / f"{n:06}.png")).tobytes()
                        if kind == "raw":
                            rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)[:, : 3 * image.width]
                            pixels = rows.reshape(image.height, image.width, 3)
                            pixels = pixels[:, :, ::-1] if image.encoding == "bgr8" else pixels
                            assert pixels.tobytes() == exported, (process, name, n)
                        of = [k for k, pair in enumerate(sent) if pair[eye] == exported]
                        assert len(of) == 1, f"{kind}: {process}/camera {name} {n}: no pixels that were sent"
                        which.append((message.sequence, of[0]))
                    assert len({k for _, k in which}) == 3, which
                    seen.append(which)
                assert seen[0] == seen[1], f"{kind}: {process}: left and right are of different pairs"
        assert sizes["qoi"] < sizes["raw"] / 2, sizes


def test_frames_that_are_no_pictures_go_to_numpy_as_they_were_sent():
    import numpy as np
    member = {"stream_of": "host/source"}
    system = {"version": 1,
              "processes": {"host": {"plugins": ["plugins"]}},
              "components": {"host/source": {"class": "oct/oct_source", "execution": {"model": "stream", "rate_hz": 200}},
                             "host/ascan": {"class": "oct/oct_processor", "execution": member},
                             "host/camera": {"class": "stereo/phantom_source", "config": {"width": 320, "height": 240}},
                             "host/depth": {"class": "stereo-depth/stereo_depth", "execution": {"model": "on_signal"},
                                            "config": {"method": "bm", "width": 320, "height": 240}}},
              "connections": [{"client": "host/ascan/spectra", "server": "host/source/spectra"},
                              {"client": "host/depth/rectified", "server": "host/camera/image"}]}
    with World(["oct", "stereo", "stereo_depth"], system) as world:
        least = {"/host/source/spectra": 20, "/host/ascan/ascan": 20, "/host/depth/disparity": 2, "/host/camera/image": 2}
        done = world.record(*(name[1:] for name in least), "-o", "a.mcap", least=least)
        assert done["whole"], done
        topics, _, _ = messages(world.dir / "a.mcap")
        lost = [name if name in topics else f"{name}/left" for name in least]
        assert sum(missing(topics[name]) for name in lost) == done["lost"], done
        exported = world.json("export", "a.mcap", "--npz")
        pictures = sum(len(topics[f"/host/camera/image/{eye}"]) for eye in ("left", "right"))
        assert exported["pictures"] == pictures > 2 and exported["unplaced"] == 0, (exported, pictures)
        arrays = np.load(world.dir / "a.npz")
        for topic, items in (("host/source/spectra", ("<u2",)), ("host/ascan/ascan", ("<f4", "|u1"))):
            frames = [frame for _, frame in topics[f"/{topic}"]]
            data = arrays[f"{topic}/data"]
            assert data.dtype.str in items and data.shape == (sum(f.lines for f in frames), frames[0].samples), (topic, data.dtype, data.shape)
            used = [f.data[: f.lines * f.samples * data.dtype.itemsize] for f in frames]
            assert data.tobytes() == b"".join(used) and len(np.unique(data)) > 10, topic
        disparities = topics["/host/depth/disparity"]
        data = arrays["host/depth/disparity/data"]
        assert data.shape == (len(disparities), 240, 320) and data.dtype == np.int16, (data.shape, data.dtype)
        assert data[0].tobytes() == disparities[0][1].data and data.any()
        assert not any(name.startswith("host/camera/image/") and name.endswith("/data") for name in arrays.files), arrays.files


def test_numbers_go_to_numpy_and_tables():
    import numpy as np
    with World(["sine", "eyerobot"]) as world:
        world.source()
        world.source("robot", "eyerobot")
        world.record("host/sine/value", "host/robot/tip", "-o", "a.mcap", least={"/host/sine/value": 301, "/host/robot/tip": 101})
        world.run("export", "a.mcap", "--npz", code=OK)
        arrays = np.load(world.dir / "a.npz")
        n = len(arrays["host/sine/value/value"])
        assert n > 100 and arrays["host/sine/value/log_time_ns"].shape == (n,)
        assert arrays["host/robot/tip/pose.position"].shape[1] == 3
        sequence = arrays["host/robot/tip/sequence"]
        assert (np.diff(sequence.astype(np.int64)) == 1).all(), sequence
        whole = arrays["host/sine/value/log_time_ns"].astype(np.int64)
        begin = min(message.log_time for topic in messages(world.dir / "a.mcap")[0].values() for message, _ in topic)
        # The middle third of it, whenever that was.
        first_ms, last_ms = (int(whole[at] - begin) // 1_000_000 + 1 for at in (n // 3, 2 * n // 3))
        part = ["--from", f"{first_ms}ms", "--to", f"{last_ms}ms"]
        world.run("export", "a.mcap", "--csv", *part, "--topic", "host/sine", code=OK)
        rows = (world.dir / "a-csv/host_sine_value.csv").read_text().splitlines()
        assert rows[0] == "log_time_ns,publish_time_ns,sequence,stamp,value" and 1 < len(rows) < n, rows[:2]
        assert [p.name for p in (world.dir / "a-csv").iterdir()] == ["host_sine_value.csv"]
        world.run("export", "a.mcap", "--npz", *part, "-o", "part.npz", code=OK)
        some = np.load(world.dir / "part.npz")["host/sine/value/log_time_ns"].astype(np.int64)
        wanted = whole[(whole >= begin + first_ms * 1_000_000) & (whole <= begin + last_ms * 1_000_000)]
        assert 0 < len(some) < n and (some == wanted).all(), (len(some), len(wanted), n)


def test_tables_of_more_topics_than_files_may_be_open_are_written_all():
    from mcap.writer import CompressionType, Writer
    with World([]) as world:
        with open(world.dir / "small.mcap", "wb") as file:
            writer = Writer(file, compression=CompressionType.ZSTD)
            writer.start()
            writer.add_message(writer.register_channel("/a", "json", 0), 1, b'{"n": 1}', 1)
            writer.finish()
        refused = world.run("export", "small.mcap", "--csv", code=REFUSED).stderr
        assert "zstd" in refused and "--compression none" in refused, refused
        with open(world.dir / "many.mcap", "wb") as file:
            writer = Writer(file, compression=CompressionType.NONE)
            writer.start()
            schema = writer.register_schema("numbers", "jsonschema", b'{"type": "object"}')
            channels = [writer.register_channel(f"/host/c{n}/value", "json", schema) for n in range(300)]
            for k in range(3):
                for n, channel in enumerate(channels):
                    writer.add_message(channel, k, json.dumps({"n": n * 10 + k}).encode(), k)
            writer.finish()
        done = subprocess.run(["prlimit", "--nofile=64", BIN / "trocar", "export", "many.mcap", "--csv", "--json"], cwd=world.dir, env=world.env,
                              capture_output=True, text=True)
        assert done.returncode == OK and json.loads(done.stdout)["files"] == 300, (done.returncode, done.stdout, done.stderr)
        for n in (0, 299):
            with open(world.dir / f"many-csv/host_c{n}_value.csv", newline="") as file:
                told = [json.loads(row["json"])["n"] for row in csv.DictReader(file)]
            assert told == [n * 10, n * 10 + 1, n * 10 + 2], told


def test_an_export_that_finds_no_room_says_what_there_is_of_it():
    with World(["sine"]) as world:
        world.source()
        world.record("host/sine/value", "-o", "a.mcap", least={"/host/sine/value": 1000})
        for kind, output in (("--csv", "a-csv"), ("--npz", "a.npz")):
            # Python ignores the signal that comes with it, and so does who inherits that.
            done = subprocess.run(["prlimit", "--fsize=8192", BIN / "trocar", "export", "a.mcap", kind], cwd=world.dir, env=world.env,
                                  capture_output=True, text=True, restore_signals=False)
            assert done.returncode == REFUSED and (world.dir / output).exists(), (kind, done.returncode, done.stderr)
            for says in ("cannot be written: File too large", f"; {output} has what was written before that", f"remove {output} before"):
                assert says in " ".join(done.stderr.split()), (kind, says, done.stderr)
            assert done.stderr.startswith("error:") and "panicked" not in done.stderr, (kind, done.stderr)


def test_what_has_names_goes_to_tables_by_name_and_to_numpy_by_number():
    import numpy as np
    with World(["eyerobot"]) as world:
        world.source("robot", "eyerobot")
        world.record("host/robot/tap_rows", "-o", "a.mcap", least={"/host/robot/tap_rows": 2})
        world.run("export", "a.mcap", "--npz", code=OK)
        world.run("export", "a.mcap", "--csv", code=OK)
        heads, first, *_ = (world.dir / "a-csv/host_robot_tap_rows.csv").read_text().splitlines()
        said = dict(zip(heads.split(","), first.split(",")))
        assert said["operating_state.state"].startswith("STATE_"), said
        numbers = np.load(world.dir / "a.npz")["host/robot/tap_rows/operating_state.state"]
        topics, _, _ = messages(world.dir / "a.mcap")
        state = topics["/host/robot/tap_rows"][0][1].operating_state.state
        assert numbers.dtype == np.int64 and numbers[0] == state, (numbers, state)


def test_bad_input_is_refused_in_a_sentence_and_nothing_is_written_over():
    with World(["sine"]) as world:
        sine = world.source()
        precious = world.dir / "there.mcap"
        precious.write_text("precious")
        for words, code, says in (
            (["record", "host/**", "-o", "there.mcap"], REFUSED, "nothing is written over"),
            (["record", "host/nothing/**", "-o", "a.mcap"], REFUSED, "host/sine/value"),
            (["record", "host/sine/valeu", "-o", "a.mcap"], REFUSED, "did you mean host/sine/value?"),
            (["record", "host/**", "-o", "a.txt"], USAGE, ".mcap"),
            (["record", "host/**", "-o", "nowhere/a.mcap"], REFUSED, "make the directory"),
            # Not even root makes a file there.
            (["record", "host/**", "-o", "/sys/a.mcap"], REFUSED, "choose a directory that the host may write to"),
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
        world.json("record", "host/**", "-o", "good.mcap", "--seconds", "0.5")
        for made in ("good-csv", "good-png"):
            (world.dir / made).mkdir()
        (world.dir / "good.npz").write_text("precious")
        for words, code, says in (
            (["--csv"], REFUSED, "good-csv exists, and nothing is written over"),
            (["--png"], REFUSED, "good-png exists, and nothing is written over"),
            (["--npz"], REFUSED, "good.npz exists, and nothing is written over"),
            (["--csv", "-o", "good.mcap"], REFUSED, "nothing is written over"),
            (["--npz", "-o", "/sys/a.npz"], REFUSED, "choose another place"),
            (["--csv", "-o", "/sys/a"], REFUSED, "choose another place"),
            (["--csv", "-o", "new", "--topic", "host/nothing/**"], REFUSED, "/host/sine/value"),
            (["--csv", "-o", "new", "--from", "5s"], REFUSED, "in that time"),
            (["--csv", "-o", "new", "--from", "2s", "--to", "1s"], USAGE, "--from is not before --to"),
            (["--csv", "-o", "new", "--from=-1s"], USAGE, "--from"),
            (["--csv", "--npz", "-o", "new"], USAGE, "cannot be used with"),
            (["--png", "-o", "new"], REFUSED, "no picture among"),
            (["--csv", "-o", "new", "--topic", "host/sine/valeu"], REFUSED, "did you mean /host/sine/value?"),
        ):
            done = world.run("export", "good.mcap", *words)
            assert done.returncode == code and says in done.stderr + done.stdout, (words, done.returncode, done.stderr)
        assert (world.dir / "good.npz").read_text() == "precious" and not list(world.dir.glob("good-*/*"))
        assert not (world.dir / "new").exists()
        world.recorder({"a": f"{sine}/value"})
        (world.dir / "rec/there.mcap").write_text("precious")
        for path, says in (("../a.mcap", "leads out"), ("/tmp/a.mcap", "outside"), ("there.mcap", "nothing is written over"),
                           ("a", ".mcap"), ("a\nb.mcap", "cannot be seen"), ("none/a.mcap", "make it first")):
            refused = world.begin(path, code=REFUSED)
            assert says in refused.stderr, (path, refused.stderr)
        for delay, duration in ((-1, 0), (1e300, 0), (0, -5)):
            assert "is not between" in world.call("host/rec/ctl/start", {"path": "x.mcap", "delay": delay, "duration": duration},
                                                  code=REFUSED).stderr
        for every, rate in ((0, 0.0), (1, -1.0), (1, 1e30)):
            refused = world.call("host/rec/ctl/thin", {"input": "a", "every": every, "max_rate": rate}, code=REFUSED)
            assert "error:" in refused.stderr, (every, rate, refused.stderr)
        assert "a" in world.call("host/rec/ctl/thin", {"input": "none", "every": 1, "max_rate": 0.0}, code=REFUSED).stderr
        for config in ({"topics": ["a", "a"]}, {"topics": ["a/b"]}, {"topics": ["a"], "max_rate_hz": [-1]},
                       {"topics": ["a"], "every": [0]}, {"topics": [], "every": [1]}, {"pre_trigger_s": 1e9}):
            refused = world.run("create", "host/bad", "recorder", "--config", json.dumps(config))
            assert refused.returncode != OK and "error:" in refused.stderr, (config, refused.stdout, refused.stderr)
            world.run("rm", "host/bad")
        assert (world.dir / "rec/there.mcap").read_text() == "precious"
        assert [p.name for p in (world.dir / "rec").iterdir()] == ["there.mcap"]


def test_what_the_recorder_says_of_itself_is_read_by_the_stock_reader_as_the_manual_says():
    manual = (HERE.parents[1] / "docs/RECORDER.md").read_text()
    code = re.search(r"```python\n(.*?)```", manual, re.S).group(1)
    with World(["sine"]) as world:
        world.source()
        world.record("host/sine/value", "-o", "trial.mcap", least={"/host/sine/value": 101})
        done = subprocess.run([sys.executable, "-c", code], cwd=world.dir, capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == 0, done.stderr
        lines = done.stdout.splitlines()
        assert any(line.startswith("/recorder/graph ") and "'host/sine'" in line for line in lines), lines[:3]
        assert sum(line.startswith("/host/sine/value ") for line in lines) > 100, len(lines)
        exported = world.json("export", "trial.mcap", "--csv")
        own = [line for line in lines if line.startswith("/recorder/")]
        assert exported["recorders"] == len(own) > 0, (exported, own)
        told = world.run("export", "trial.mcap", "--csv", "-o", "own", "--topic", "/recorder/*", code=OK)
        assert "note" not in told.stderr and (world.dir / "own/recorder_graph.csv").exists(), told.stderr
        arrays = world.json("export", "trial.mcap", "--npz", "--topic", "/recorder/*")
        assert arrays["texts"] == len(own), arrays


def test_a_recording_that_is_being_written_says_so():
    with World(["sine"]) as world:
        world.recorder({"a": f"{world.source()}/value"})
        world.begin("a.mcap")
        world.wait("it records", messages=501)
        told = world.json("info", "rec/a.mcap", code=PARTIAL)
        assert not told["whole"] and "it is being written" in told["wrong"] and told["messages"] > 100, told
        world.end()
        assert world.json("info", "rec/a.mcap")["whole"]


def test_hostile_recordings_end_in_a_sentence():
    import random
    with World(["sine", "stereo"]) as world:
        world.source()
        world.source("camera", "phantom_source", {"width": 32, "height": 32})
        chance = random.Random(7)
        for kind in ("raw", "qoi"):
            world.json("record", "host/sine", "host/camera/image", "-o", f"{kind}.mcap", "--seconds", "0.5", "--video", kind)
            good = (world.dir / f"{kind}.mcap").read_bytes()
            for n in range(30):
                bad = bytearray(good[: chance.randrange(9, len(good))] if n % 2 else good)
                for _ in range(chance.randrange(1, 30)):
                    bad[chance.randrange(len(bad))] = chance.randrange(256)
                if n % 5 == 0:
                    at = chance.randrange(8, len(bad) - 9)
                    bad[at + 1 : at + 9] = (1 << chance.randrange(40, 64)).to_bytes(8, "little")
                path = world.dir / f"{kind}{n}.mcap"
                path.write_bytes(bad)
                for words in (["info", path], ["export", path, "--csv", "-o", f"{path}.csv"], ["export", path, "--npz", "-o", f"{path}.npz"],
                              ["export", path, "--png", "-o", f"{path}.png"]):
                    done = world.run(*words)
                    assert done.returncode in (OK, REFUSED, PARTIAL), (words, done.returncode, done.stderr[-500:])
                    assert "panicked" not in done.stderr, done.stderr[-500:]
                    said = [line for line in done.stderr.splitlines() if line.startswith(("error: ", "warning: "))]
                    assert said or done.returncode == OK, (words, done.returncode, done.stderr[-500:])


def test_hostile_recordings_of_megabytes_take_no_gigabytes():
    sys.path.insert(0, str(ROOT / "tests/data/recordings"))
    import make
    size = 3 << 20
    many = range(1, size // 200)
    big = make.types(make.LINE, *(make.kind(f"T{n}", *(make.field(f"f{k}", k, make.DOUBLE) for k in range(1, 20))) for n in range(1000)))
    wide = make.types(make.kind("V", *(make.field(f"field_{k}", k, make.DOUBLE) for k in range(1, 4000))))
    listed = make.types(make.kind("V", make.field("x", 1, make.DOUBLE, repeated=True)))
    described = make.schema(1, "p.V", big)
    hostile = {
        "a type for many channels": described + b"".join(make.channel(n, 1, f"/a/b/{n}") + make.message(n, 1, make.double(1, 1.0)) for n in many),
        "a description of empty parts": make.schema(1, "p.V", make.inner(1, b"\x22\0" * (size // 2))) + make.channel(1, 1, "/a/b/c") + make.lines(1),
        "a description of empty files": make.schema(1, "p.V", b"\x0a\0" * (250 << 10)) + make.channel(1, 1, "/a/b/c") + make.lines(1),
        "zeros that take no room": make.schema(1, "p.V", wide) + make.channel(1, 1, "/a/b/c") + make.message(1, 1, b"") * (size // 3000),
        "branches for each message": make.schema(1, "p.M0", make.chain(30, 2)) + make.channel(1, 1, "/a/b/c") + make.message(1, 1, b"") * (size // 3000),
        "a long list behind short ones": make.schema(1, "p.V", listed) + make.channel(1, 1, "/a/b/c") + make.message(1, 1, b"") * (size // 310)
        + make.message(1, 2, make.inner(1, bytes(8 * 4000))),
        "a name for all": make.schema(1, "p." + "V" * size, make.types(make.LINE)) + b"".join(make.channel(n, 1, f"/{n}") for n in many),
        "names of one file": make.ONE + b"".join(make.channel(n, 1, f"/{chr(0x4e00 + n)}") + make.message(n, 1, b"") for n in many[1:]),
    }
    with tempfile.TemporaryDirectory(prefix="trocar-recorder-") as place:
        for name, records in hostile.items():
            path = pathlib.Path(place) / "a.mcap"
            path.write_bytes(make.whole(records))
            for words in (["info"], ["export", "--csv"], ["export", "--npz"]):
                output = [] if words == ["info"] else ["-o", f"{place}/out"]
                # 1.5 GiB of address space.
                limited = ["sh", "-c", 'ulimit -v 1572864; exec "$@"', "sh", BIN / "trocar", *words, path, *output]
                done = subprocess.run(limited, capture_output=True, text=True, timeout=PATIENCE_S)
                assert done.returncode in (OK, REFUSED, PARTIAL), (name, words, done.returncode, done.stderr[-500:])
                assert "panicked" not in done.stderr and len(done.stderr) < 20_000, (name, words, done.stderr[-500:])
                shutil.rmtree(f"{place}/out", ignore_errors=True)
                pathlib.Path(f"{place}/out").unlink(missing_ok=True)


def test_the_corpus_of_recordings_is_what_its_script_makes():
    sys.path.insert(0, str(ROOT / "tests/data/recordings"))
    import make
    place = ROOT / "tests/data/recordings"
    there = {path.stem: path.read_bytes() for path in place.glob("*.mcap")}
    assert there == make.corpus(), "make it anew: python3 tests/data/recordings/make.py tests/data/recordings"


def test_rerun_shows_images_poses_and_plots():
    rerun = VENV / "bin" / "rerun"
    if not rerun.exists():
        install = [sys.executable, "-m", "pip", "install", "-q", "--retries", "1", "-r", str(HERE / "packages-rerun.txt")]
        done = subprocess.run(install, capture_output=True, text=True)
        if done.returncode:
            raise Skip(f"the package of packages-rerun.txt cannot be had: {done.stderr.strip().splitlines()[-1:]}")
    with World(["sine", "eyerobot", "stereo"]) as world:
        world.source()
        world.source("robot", "eyerobot")
        world.source("camera", "phantom_source", {"width": 160, "height": 120})
        world.source("large", "phantom_source", {"width": 1024, "height": 768})
        least = {"/host/sine/value": 501, "/host/robot/measured_cp": 501, "/host/camera/image": 11}
        world.record(*(name[1:] for name in least), "-o", "trial.mcap", least=least)
        world.record("host/camera/image", "-o", "jpeg.mcap", "--video", "jpeg", least={"/host/camera/image": 11})
        # So much that it goes past the page cache, with records of our own in between.
        world.record("host/large/image", "-o", "large.mcap", least={"/host/large/image": 40})
        assert FILLER in opcodes(world.dir / "large.mcap") or not passes_the_page_cache_by(world.dir)

        def asked(*words):
            # Neither a viewer nor a word home.
            env = {**world.env, "RERUN_ANALYTICS_ENABLED": "0", "HOME": str(world.dir)}
            done = subprocess.run([rerun, *words], cwd=world.dir, env=env, capture_output=True, text=True, timeout=PATIENCE_S)
            assert done.returncode == 0, (words, done.stderr[-2000:])
            return done.stdout

        def converted(name):
            """(entity, column) -> how many rows it has."""
            asked("mcap", "convert", f"{name}.mcap", "-o", f"{name}.rrd")
            rows = {}
            for n, entity, columns in re.findall(r"with (\d+) rows .*? - (/\S+) - data columns: \[(.*?)\]", asked("rrd", "print", f"{name}.rrd")):
                for column in columns.split():
                    rows[entity, column] = rows.get((entity, column), 0) + int(n)
            return rows

        rows, jpeg, large = converted("trial"), converted("jpeg"), converted("large")
        for eye in ("left", "right"):
            assert rows[f"/host/camera/image/{eye}", "Image:buffer"] > 10, rows
            assert jpeg[f"/host/camera/image/{eye}", "EncodedImage:blob"] > 10, jpeg
            assert large[f"/host/large/image/{eye}", "Image:buffer"] > 10, large
        assert rows["/host/robot/measured_cp", "InstancePoses3D:translations"] > 500, rows
        assert rows["/host/robot/measured_cp", "InstancePoses3D:quaternions"] > 500, rows
        plots = [column for entity, column in rows if entity == "/host/sine/value" and column.endswith(".Scalar:message")]
        assert len(plots) == 1 and rows["/host/sine/value", plots[0]] > 500, rows
        # A plot is drawn of a field: each has its name and is a number.
        shown = asked("rrd", "print", "-vv", "--entity", "/host/sine/value", "trial.rrd")
        assert re.search(r'"value": (non-null )?Float64', shown), shown[:3000]
