"""Promise: a GCM that goes and comes back is told of, found again, and the session is in the graph with all it had."""

import signal

import pytest

import trocar

from ..conftest import eventually
from .conftest import Program, linked


@pytest.fixture
def site(tmp_path):
    """A GCM by itself and a host: the one may go while the other runs."""
    plugins, _ = linked(tmp_path, "example")
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
    made.first = made.gcm()
    running.append(Program(tmp_path, "host", "host", "--name", "ProcessServer", "--gcm", made.address, "--plugins", plugins,
                           "--listen", "127.0.0.1:0", "--state", tmp_path / "host-state"))  # fmt: skip
    yield made
    for program in reversed(running):
        program.end()


def test_a_gcm_that_goes_and_comes_back_finds_the_session_as_it_was(site):
    said, got = [], []
    ire = trocar.connect(site.address, say=said.append)
    eventually("the host has attached", lambda: "example/Server" in ire.classes())
    ire.create("ProcessServer/Server", "Server")
    ire.start("ProcessServer/Server")
    r = ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))
    hears = r.on.SetPointReached(got.append)
    r.Write(30)
    eventually("the event came", lambda: got == [30])
    term = ire._graph.term

    site.first.end(signal.SIGKILL)
    eventually("its loss is said", lambda: any("is gone" in s for s in said))
    with pytest.raises(trocar.TrocarError) as e:
        r.Read()
    assert e.value.code == "UNAVAILABLE" and e.value.reason == "GCM_UNREACHABLE" and site.address in e.value.sentence, e.value
    assert "which is gone" in repr(ire) and not ire.connected

    site.gcm()
    eventually("its return is said", lambda: any("is back (term" in s for s in said))
    assert ire._graph.term != term
    eventually("the session has its place again", lambda: any("joined again as ire/shell, 1 of 1 connected again" in s for s in said))
    eventually("calls are answered", lambda: _read(r) == 30)
    eventually(
        "the graph shows its connection",
        lambda: any(c.client == "ire/shell/Provided" and c.server == r._path for c in ire._graph.connections.values()),
    )
    # What is followed is followed again.
    eventually("the event is followed again", lambda: hears.breaks >= 1)
    r.Write(31)
    eventually("an event comes", lambda: 31 in got)
    ire.close()


def _read(r):
    try:
        return r.Read()
    except trocar.TrocarError as e:
        return e


def test_no_gcm_at_all_is_one_sentence_with_what_to_do():
    with pytest.raises(trocar.TrocarError) as e:
        trocar.connect("127.0.0.1:1", timeout=20)
    assert e.value.reason == "GCM_UNREACHABLE" and "127.0.0.1:1" in e.value.sentence and "trocar host" in e.value.sentence
