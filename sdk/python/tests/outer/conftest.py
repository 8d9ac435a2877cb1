"""The built program: systems that a test starts, and that end with it."""

import json
import os
import pathlib
import re
import signal
import subprocess

import pytest

import trocar

from ..conftest import STANDSTILL_S, eventually

DEADLINE_S = 30
BIN = os.environ.get("TROCAR_BIN_DIR")
ROOT = pathlib.Path(__file__).resolve().parents[4]


def pytest_collection_modifyitems(items):
    if BIN is None:
        for item in items:
            if "outer" in item.path.parts:
                item.add_marker(pytest.mark.skip(reason="TROCAR_BIN_DIR is not set: ./tests/run builds the program and runs these"))


class Program:
    """A ``trocar`` that serves, killed by its handle."""

    def __init__(self, directory, name, *args, env=None):
        self.directory, self.name = directory, name
        self.log = directory / f"{name}.log"
        environment = {k: v for k, v in os.environ.items() if k != "TROCAR_GCM"}
        environment.update(XDG_STATE_HOME=str(directory / "state"), **(env or {}))
        with open(self.log, "ab") as out:
            self.child = subprocess.Popen(
                [f"{BIN}/trocar", *map(str, args)], cwd=directory, stdin=subprocess.DEVNULL, stdout=out, stderr=out, env=environment
            )

    def printed(self):
        return self.log.read_text(errors="replace")

    def address(self, pattern):
        def look():
            assert self.child.poll() is None, f"{self.name} ended with {self.child.returncode}:\n{self.printed()}"
            return re.search(pattern, self.printed()) or ""

        return eventually(f"{self.name} prints its address", look, progress=lambda: len(self.printed())).group(1)

    def end(self, how=signal.SIGTERM):
        if self.child.poll() is None:
            self.child.send_signal(how)
            try:
                self.child.wait(30)
            except subprocess.TimeoutExpired:
                self.child.kill()
                self.child.wait(30)


def linked(directory, *names):
    """A plugin directory with copies of these plugins; those that were not built are left out, and answered."""
    plugins = directory / "plugins"
    plugins.mkdir(exist_ok=True)
    missing = []
    for name in names:
        file = pathlib.Path(BIN) / f"libtrocar_{name}.so"
        if not file.exists():
            missing.append(name)
            continue
        target = plugins / file.name
        target.write_bytes(file.read_bytes())
        target.chmod(0o755)
    return plugins, missing


SYSTEM = {
    "version": 1,
    "//": "Named as in the shell session of the documentation.",
    "processes": {"ProcessServer": {}, "robot": {}, "oct": {}, "host": {}},
    "components": {
        "ProcessServer/Server": {"class": "example/Server"},
        "robot/EyeRobot": {"class": "EyeRobot", "execution": {"model": "periodic", "rate_hz": 500}},
        "oct/spectrometer": {"class": "oct/oct_source", "execution": {"model": "stream", "rate_hz": 50}},
        "oct/lines": {"class": "oct/oct_processor", "execution": {"stream_of": "oct/spectrometer"}},
        "host/eye": {
            "class": "stereo/phantom_source",
            "execution": {"model": "stream", "rate_hz": 10},
            "config": {"width": 320, "height": 240},
        },
    },
    "connections": [{"client": "oct/lines/spectra", "server": "oct/spectrometer/spectra"}],
}
PLUGINS = ("example", "fixture_lecture", "oct", "stereo", "eyerobot", "bscan", "vision_filters", "display", "stereo_depth",
           "picture_writer", "recorder")  # fmt: skip


class System:
    """Several processes with their GCM."""

    def __init__(self, directory):
        self.directory = directory
        self.plugins, self.missing = linked(directory, *PLUGINS)
        (directory / "session.json").write_text(json.dumps(SYSTEM))
        (directory / "bscan.json").write_bytes((ROOT / "host/demo/bscan.json").read_bytes())
        self.program = Program(directory, "up", "up", "session.json", "--plugins", self.plugins, "--listen", "127.0.0.1:0")
        self.address = self.program.address(r"GCM (127\.0\.0\.1:\d+)")

    def connect(self, **settings):
        # How long a call waits for its answer is judged where a test says a deadline itself.
        return trocar.connect(self.address, **{"deadline": DEADLINE_S, "timeout": STANDSTILL_S, **settings})

    def await_outputs(self):
        """Waits for the first of all that streams, so that each test finds it also where it runs alone."""
        with self.connect() as ire:
            for path in ("robot/EyeRobot/position", "host/eye/image", "oct/spectrometer/spectra", "oct/lines/ascan"):
                eventually(f"{path} has sent", lambda path=path: there(lambda: ire.latest(path)))


def there(read):
    """Whether it can be read by now; why not, as an observation."""
    try:
        read()
    except trocar.TrocarError as e:
        raise AssertionError(str(e)) from None
    return True


@pytest.fixture(scope="session")
def system(tmp_path_factory):
    made = System(tmp_path_factory.mktemp("session"))
    try:
        made.await_outputs()
        yield made
    finally:
        made.program.end()


@pytest.fixture
def ire(system):
    with system.connect() as session:
        yield session


def listed(ire):
    """The paths of all components as the GCM has them; a session's own copy of the graph may come later."""
    return {component.path for component in ire._call("GcmService/List").components}


@pytest.fixture
def server(ire):
    """The example's server, running."""
    if ire.state("ProcessServer/Server") != "ACTIVE":
        ire.start("ProcessServer/Server")
    return ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))
