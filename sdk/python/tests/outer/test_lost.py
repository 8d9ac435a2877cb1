"""Promise: a GCM that goes and comes back is told of, found again, and the session is in the graph with all it had."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

import trocar

from ..conftest import STANDSTILL_S, eventually, reaches
from .conftest import DEADLINE_S, Program, linked


@pytest.fixture
def site(tmp_path):
    """A GCM by itself and a host: the one may go while the other runs."""
    plugins, missing = linked(tmp_path, "example", "eyerobot", "recorder")
    state = tmp_path / "gcm-state"
    running = []

    class Site:
        address = ""

        def gcm(self):
            listen = self.address or "127.0.0.1:0"
            program = Program(tmp_path, f"gcm{len(running)}", "gcm", "--listen", listen, "--state", state)
            running.append(program)
            self.address = program.address(r"(127\.0\.0\.1:\d+)")
            return program

    made = Site()
    made.missing, made.first = missing, made.gcm()
    running.append(Program(tmp_path, "host", "host", "--name", "ProcessServer", "--gcm", made.address, "--plugins", plugins,
                           "--listen", "127.0.0.1:0", "--state", tmp_path / "host-state"))  # fmt: skip
    yield made
    for program in reversed(running):
        program.end()


def connect(site, said):
    return trocar.connect(site.address, say=said.append, deadline=DEADLINE_S, timeout=STANDSTILL_S)


def test_a_gcm_that_goes_and_comes_back_finds_the_session_as_it_was(site):
    said, got = [], []
    ire = connect(site, said)
    eventually("the host has attached", lambda: "example/Server" in ire.classes(), progress=ire.classes)
    ire.create("ProcessServer/Server", "Server")
    ire.start("ProcessServer/Server")
    r = ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))
    hears = r.on.SetPointReached(got.append)
    r.Write(30)
    eventually("the event came", lambda: got == [30])
    term = ire._graph.term

    site.first.end(signal.SIGKILL)
    eventually("its loss is said", lambda: any("is gone" in s for s in said), progress=said.copy)
    with pytest.raises(trocar.TrocarError) as e:
        r.Read()
    assert e.value.code == "UNAVAILABLE" and e.value.reason == "GCM_UNREACHABLE" and site.address in e.value.sentence, e.value
    assert "which is gone" in repr(ire) and not ire.connected

    site.gcm()
    eventually("its return is said", lambda: any("is back (term" in s for s in said), progress=said.copy)
    assert ire._graph.term != term
    joined = "joined again as ire/shell, 1 of 1 connected again"
    eventually("the session has its place again", lambda: any(joined in s for s in said), progress=said.copy)
    eventually("calls are answered", lambda: _read(r) == 30)
    eventually(
        "the graph shows its connection",
        lambda: any(c.client == "ire/shell/Provided" and c.server == r._path for c in ire._graph.connections.values()),
    )
    # What is followed is followed again.
    reaches("the event is followed again", lambda: hears.breaks, 1)

    def heard():
        # It may break once more while the host attaches, and an event that is sent then is lost by right.
        r.Write(31)
        return 31 in got

    eventually("an event comes", heard, progress=lambda: hears.breaks)
    ire.close()


def _read(r):
    try:
        return r.Read()
    except trocar.TrocarError as e:
        return e


@pytest.fixture
def robot(site):
    """A session with something to record, and what it said."""
    if {"eyerobot", "recorder"} & set(site.missing):
        pytest.skip("the plugins eyerobot and recorder were not built")
    said = []
    ire = connect(site, said)
    wanted = {"eyerobot/eyerobot", "recorder/recorder"}
    eventually("the host has attached", lambda: wanted <= set(ire.classes()), progress=ire.classes)
    ire.create("ProcessServer/robot", "eyerobot/eyerobot", {}, {"rate_hz": 200})
    ire.start("ProcessServer/robot")
    yield ire, said
    ire.close()


def gone(site, ire):
    site.first.end(signal.SIGKILL)
    eventually("its loss is seen", lambda: not ire.connected)


def back(site, ire):
    """The GCM is there again and knows the host and all it has."""
    site.gcm()
    eventually("the session is connected", lambda: ire.connected)
    robot = "ProcessServer/robot"
    eventually("the robot is there", lambda: _state(ire, robot) == "ACTIVE", progress=lambda: _state(ire, robot))


def _state(ire, path):
    try:
        return ire.state(path)
    except trocar.TrocarError as e:
        return str(e)


def _tried(what):
    """Whether it works by now; the manager is back before all it manages is."""
    try:
        what()
    except trocar.TrocarError as e:
        assert "is left behind" in e.sentence, e
        return False
    return True


def recorders(ire):
    return [c.path for c in ire._call("GcmService/List").components if getattr(c, "class") == "recorder/recorder"]


def left_behind(error, rec):
    """The refusal names the recorder and the way to get rid of it, and nothing of it is forgotten."""
    assert error.reason == "GCM_UNREACHABLE" and "is left behind" in error.sentence, error
    assert f"trocar rm --force {rec.component}" in error.sentence and error.metadata["component"] == rec.component, error
    assert rec.component == "ProcessServer/rec_trial" and rec in rec._session._recordings


def test_a_recorder_that_could_not_be_removed_is_removed_when_the_gcm_is_back(site, robot):
    ire, _ = robot
    rec = ire.record("trial", ["ProcessServer/robot"])
    gone(site, ire)
    for _ in range(2):
        with pytest.raises(trocar.TrocarError) as e:
            rec.close()
        left_behind(e.value, rec)
    assert "armed" in repr(rec)
    back(site, ire)
    assert recorders(ire) == [rec.component], "it was left behind"
    eventually("it can be closed again", lambda: _tried(rec.close))
    assert recorders(ire) == [] and rec.component == "" and not ire._recordings and "over" in repr(rec)
    rec.close()


def test_a_recording_goes_on_without_a_gcm_and_is_ended_whole_when_that_is_back(site, robot, tmp_path):
    ire, _ = robot
    with pytest.raises(trocar.TrocarError) as e, ire.record("trial", ["ProcessServer/robot"], directory=str(tmp_path)) as rec:
        reaches("messages are written", lambda: rec.status()["messages"], 51)
        gone(site, ire)
        lost_ns = time.monotonic_ns()
    left_behind(e.value, rec)
    assert "recording" in repr(rec) and rec.result is None
    written = (tmp_path / "trial.mcap").stat().st_size
    reaches("it goes on recording", lambda: (tmp_path / "trial.mcap").stat().st_size, written + 1)
    back(site, ire)
    eventually("it can be stopped again", lambda: _tried(rec.stop))
    assert rec.result["whole"] and rec.result["reason"] == "stopped as asked" and rec.path == str(tmp_path / "trial.mcap")
    file = rec.read()
    assert file.complete and (file["/ProcessServer/robot/tip"].publish_time > lost_ns).any(), file
    assert recorders(ire) == [] and not ire._recordings


def test_a_recorder_that_somebody_else_removed_is_over_and_its_file_is_whole(site, robot, tmp_path):
    ire, _ = robot
    rec = ire.record("trial", ["ProcessServer/robot"], directory=str(tmp_path)).start()
    reaches("messages are written", lambda: rec.status()["messages"], 51)
    # What `trocar rm --force` asks.
    ire.remove(rec.component, force=True)
    rec.close()
    assert rec.component == "" and not ire._recordings
    file = trocar.read(tmp_path / "trial.mcap")
    assert file.complete and len(file["/ProcessServer/robot/tip"]) > 5, file


RECORDING = """
import sys, trocar
ire = trocar.connect(sys.argv[1])
print(ire.record("trial", ["ProcessServer/robot"], directory=sys.argv[2]).start().component, flush=True)
sys.stdin.read()
"""


def test_a_python_that_is_killed_takes_its_recorder_with_it_and_leaves_a_whole_file(site, robot, tmp_path):
    ire, _ = robot
    package = str(pathlib.Path(trocar.__file__).parents[1])
    child = subprocess.Popen([sys.executable, "-c", RECORDING, site.address, str(tmp_path)], stdin=subprocess.PIPE,
                             stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": package})  # fmt: skip
    with child:
        component = child.stdout.readline().strip()
        eventually("it is seen", lambda: recorders(ire) == [component])
        reaches("messages are written", lambda: ire.call(f"{component}/ctl/status")["messages"], 51)
        child.kill()
        child.wait()
    eventually("its recorder is gone", lambda: recorders(ire) == [])
    file = trocar.read(tmp_path / "trial.mcap")
    assert file.complete and len(file["/ProcessServer/robot/tip"]) > 5, file


def test_a_session_that_ends_without_its_gcm_says_which_recorder_it_leaves_behind(site, robot):
    ire, said = robot
    rec = ire.record("trial", ["ProcessServer/robot"])
    gone(site, ire)
    ire.close()
    assert any(f"trocar rm --force {rec.component}" in s and "trial.mcap could not be ended" in s for s in said), said


def test_no_gcm_at_all_is_one_sentence_with_what_to_do():
    with pytest.raises(trocar.TrocarError) as e:
        trocar.connect("127.0.0.1:1", timeout=20)
    assert e.value.reason == "GCM_UNREACHABLE" and "127.0.0.1:1" in e.value.sentence and "trocar host" in e.value.sentence
