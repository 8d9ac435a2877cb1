"""What the tests of recordings stand on: the packages, a host in a directory of its own, a file read by the stock reader."""

import fcntl
import itertools
import json
import os
import pathlib
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
BIN = pathlib.Path(os.environ.get("TROCAR_BIN_DIR", TARGET / "release"))
VENV = TARGET / "recorder-venv"
# Nothing here is judged by time. A wait fails when what it observes has not changed for so long, whatever it
# takes in all;
STANDSTILL_S = 60
# and a program that says nothing until it ends is taken for one that hangs after so long.
PATIENCE_S = 120
OK, REFUSED, USAGE, PARTIAL = 0, 1, 2, 5
SKIPPED = 77


class Skip(Exception):
    """Why a test cannot run here."""


def enter_venv():
    """Makes the venv where it is missing, and goes on in it. Whoever else wants it meanwhile waits."""
    python = VENV / "bin" / "python"
    if pathlib.Path(sys.prefix) == VENV:
        return
    VENV.parent.mkdir(parents=True, exist_ok=True)
    with open(f"{VENV}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        prepare_venv(python)
    os.execv(python, [str(python), *sys.argv])


def prepare_venv(python):
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


def eventually(what, probe, progress=None):
    """Asks again until it is so. `progress` is observed beside the answer: a count or a state on the way
    there.
    """
    last, since = None, time.monotonic()
    while True:
        answer = probe()
        if answer:
            return answer
        now = (repr(answer), repr(progress()) if progress else "")
        if now != last:
            last, since = now, time.monotonic()
        elif time.monotonic() - since > STANDSTILL_S:
            raise AssertionError(f"{what}: nothing has changed for {STANDSTILL_S} s; last seen: {answer!r} {now[1]}")
        time.sleep(0.02)


def reaches(what, count, least):
    """Waits until the count is so large; each change of it is progress."""
    eventually(what, lambda: count() >= least, progress=count)


class World:
    """A host in a directory of its own, ended with the test."""

    def __init__(self, plugins, system=None, ready=None, managed=False):
        """`ready` makes what the system finds in its directory: `made`; `managed`: the GCM is a process of its own, `manager`."""
        self.dir = pathlib.Path(tempfile.mkdtemp(prefix="trocar-recorder-"))
        (self.dir / "plugins").mkdir()
        (self.dir / "rec").mkdir()
        for name in ("recorder", *plugins):
            shutil.copy(BIN / f"libtrocar_{name}.so", self.dir / "plugins")
        self.made = ready and ready(self)
        self.env = {**os.environ, "XDG_STATE_HOME": str(self.dir / "state"), "NO_COLOR": "1"}
        self.env.pop("TROCAR_GCM", None)
        self.log = open(self.dir / "host.log", "w+")
        command = [BIN / "trocar", "host", "--name", "host", "--plugins", "plugins", "--listen", "127.0.0.1:0",
                   "--state", "host-state"]
        if system:
            (self.dir / "system.json").write_text(json.dumps(system))
            command = [BIN / "trocar", "up", "system.json", "--listen", "127.0.0.1:0"]
        self.manager = None
        if managed:
            self.manage("127.0.0.1:0")
            command += ["--gcm", eventually("the GCM says its address", lambda: self.address("gcm.log"))]
        self.host = self.begun(command, self.log)
        address = eventually("the host says its address", self.address)
        self.env["TROCAR_GCM"] = self.address("gcm.log") if managed else address
        classes = lambda: self.run("ls", "--json").stdout
        eventually("the classes are there", lambda: "recorder/recorder" in classes(), progress=classes)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in filter(None, (self.host, self.manager)):
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.log.close()
        shutil.rmtree(self.dir, ignore_errors=True)

    def begun(self, command, log):
        return subprocess.Popen(command, cwd=self.dir, env=self.env, stdout=log, stderr=subprocess.STDOUT)

    def manage(self, address):
        """A GCM that goes on with what an earlier one left."""
        with open(self.dir / "gcm.log", "a") as log:
            self.manager = self.begun([BIN / "trocar", "gcm", "--listen", address, "--state", "gcm-state"], log)

    def address(self, log="host.log"):
        found = re.search(r"127\.0\.0\.1:\d+", (self.dir / log).read_text())
        return found and found.group(0)

    def run(self, *words, code=None):
        done = subprocess.run([BIN / "trocar", *map(str, words)], cwd=self.dir, env=self.env, capture_output=True, text=True,
                              timeout=PATIENCE_S)
        if code is not None and done.returncode != code:
            raise AssertionError(f"trocar {' '.join(map(str, words))}: {done.returncode}, not {code}\n{done.stdout}\n{done.stderr}")
        return done

    def json(self, *words, code=OK):
        return json.loads(self.run(*words, "--json", code=code).stdout)

    def record(self, *words, least, code=OK):
        """`trocar record`, ended as by Ctrl-C once so many messages of each topic are kept, named as in the
        file.
        """
        with open(self.dir / "record.log", "w+") as log:
            process = subprocess.Popen([BIN / "trocar", "record", *map(str, words), "--json"], cwd=self.dir, env=self.env,
                                       stdout=subprocess.PIPE, stderr=log, text=True)
            try:
                for topic, count in least.items():
                    reaches(f"{count} of {topic} are kept", lambda: self.kept_by(process, topic), count)
                process.send_signal(signal.SIGINT)
                out, _ = process.communicate(timeout=PATIENCE_S)
            finally:
                process.kill()
                process.wait()
            log.seek(0)
            assert process.returncode == code, (words, process.returncode, out, log.read())
        return json.loads(out)

    def kept_by(self, process, topic):
        """Messages of a topic that a running `trocar record` has kept so far."""
        assert process.poll() is None, (process.returncode, (self.dir / "record.log").read_text())
        path = next((c["path"] for c in self.json("ls")["components"] if c["path"].endswith(f"/rec-{process.pid}")), None)
        # A topic has its name once the recorder was told where its input comes from; then it has a number.
        for at in itertools.count() if path else ():
            told = self.run("call", f"{path}/ctl/topic", str(at), "--deadline", "20s")
            if told.returncode != OK:
                break
            told = json.loads(told.stdout)
            if told["topic"] == topic:
                return told["kept"]
        return 0

    def call(self, path, arg=None, code=OK):
        words = ["call", path] + ([] if arg is None else [json.dumps(arg)])
        return self.run(*words, "--deadline", "20s", code=code)

    def read(self, path):
        return self.json("call", path, "--deadline", "20s")["value"]

    def follow(self, component, event):
        """Hears an event of a component from now on."""
        echo = subprocess.Popen([BIN / "trocar", "echo", component, f"{component}/{event}", "--json"], cwd=self.dir, env=self.env,
                                stdout=subprocess.PIPE, text=True)
        # How the component stands comes first: then it hears.
        assert json.loads(echo.stdout.readline())["kind"] == "state"
        return echo

    def source(self, name="sine", cls="sine", config=None):
        self.run("create", f"host/{name}", cls, "--config", json.dumps(config or {}), code=OK)
        self.run("start", f"host/{name}", code=OK)
        return f"host/{name}"

    def recorder(self, connections, config=None, path="host/rec"):
        """A recorder that runs, connected by name to what is said."""
        config = {"directory": "rec", "topics": list(connections), **(config or {})}
        self.run("create", path, "recorder", "--config", json.dumps(config), code=OK)
        for name, server in connections.items():
            # Frames are few and large.
            self.run("connect", f"{path}/{name}", server, "--fifo", "64" if server.endswith("/image") else "4096", code=OK)
        self.run("start", path, code=OK)

    def begin(self, path, delay=0, duration=0, code=OK):
        return self.call("host/rec/ctl/start", {"path": path, "delay": delay, "duration": duration}, code=code)

    def topic(self, at, path="host/rec"):
        return json.loads(self.call(f"{path}/ctl/topic", at).stdout)

    def kept(self, at, least):
        """Waits until so many messages of a topic are kept, of a recording that began, or of the time before
        it.
        """
        reaches(f"{least} messages of topic {at} are kept", lambda: self.topic(at)["kept"], least)

    def wait(self, what, phase=None, **least):
        """Waits for a phase, and for figures of the status that are to be so large. Only what is still
        missing is observed: messages that come by themselves are no progress of a phase that does not.
        """
        missing, status = {}, {}

        def there():
            status.update(self.read("host/rec/ctl/status"))
            missing.clear()
            if phase is not None and status["phase"] != phase:
                missing["phase"] = status["phase"]
            missing.update((key, status[key]) for key, count in least.items() if status[key] < count)
            return not missing

        eventually(what, there, progress=missing.copy)
        return status

    def end(self):
        self.call("host/rec/ctl/stop")
        return self.ended("the file is closed")

    def ended(self, what, path=""):
        """Waits until a recording has ended, that of the path if one is named."""
        last = lambda: self.read("host/rec/ctl/last")
        return eventually(what, lambda: (lambda s: s if s["reason"] and s["path"].endswith(path) else None)(last()))


class Terminal:
    """The program as somebody sees it who looks."""

    def __init__(self, world, *words):
        self.master, slave = pty.openpty()
        self.process = subprocess.Popen([BIN / "trocar", *words], cwd=world.dir, env=world.env, stdin=slave, stdout=slave, stderr=slave)
        os.close(slave)
        self.shown = ""

    def read(self):
        """More of it; false at its end."""
        assert select.select([self.master], [], [], STANDSTILL_S)[0], f"nothing more was shown: {self.shown!r}"
        try:
            more = os.read(self.master, 4096)
        except OSError:  # The other end is closed.
            more = b""
        self.shown += more.decode(errors="replace")
        return bool(more)

    def shows(self, text):
        """Text, or a pattern."""
        pattern = text if isinstance(text, re.Pattern) else re.compile(re.escape(text))
        while not pattern.search(self.shown):
            assert self.read(), f"never {text!r}: {self.shown!r}"

    def ends(self):
        while self.read():
            pass
        os.close(self.master)
        return self.process.wait(PATIENCE_S)


# The record that fills a page up where a recording passes the page cache by.
FILLER = 0x80


def opcodes(path):
    """Of the records of a file, those inside of chunks left out."""
    seen = set()
    with open(path, "rb") as file:
        file.seek(8)
        while len(head := file.read(9)) == 9 and head[:8] != b"\x89MCAP0\r\n":
            seen.add(head[0])
            file.seek(int.from_bytes(head[1:], "little"), 1)
    return seen


def passes_the_page_cache_by(directory):
    try:
        os.close(os.open(directory / "direct", os.O_CREAT | os.O_WRONLY | os.O_DIRECT))
    except OSError:
        return False
    return True


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


def missing(records):
    """How many numbers are left out between the first and the last."""
    numbers = [message.sequence for message, _ in records]
    return sum(b - a - 1 for a, b in zip(numbers, numbers[1:]))


def explained(topics, topic):
    """The samples of a topic are in order, and what is not there is what the file says was lost: a sample shows what was lost before it.
    What was lost after that was told last may show as well, and what was lost after the last sample cannot.
    """
    numbers = [message.sequence for message, _ in topics[topic]]
    gaps = [b - a - 1 for a, b in zip(numbers, numbers[1:])]
    told = topics["/recorder/loss"][-1][1]["topics"] if "/recorder/loss" in topics else {}
    lost = sum(n for name, n in told.items() if topic == name or topic.startswith(f"{name}/"))
    shown = [0, *itertools.accumulate(gaps)]
    return all(gap >= 0 for gap in gaps) and (lost in shown or lost > shown[-1])


def contiguous(records):
    numbers = [message.sequence for message, _ in records]
    return all(b == a + 1 for a, b in zip(numbers, numbers[1:]))
