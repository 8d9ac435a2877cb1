"""Promise: a Stop goes by the socket that a host of this user has for it alone, and by the port where there is none."""

import os

import grpc
import pytest

import trocar

from .fake import Fake, message, packed


class Host(Fake):
    """One that notes what it is asked to stop."""

    def __init__(self, **settings):
        super().__init__(**settings)
        self.stopped = []
        self.answers["GcmService/Stop"] = self.stop

    def stop(self, request, context):
        self.stopped.append(list(request.paths))
        return message("StopResponse", revision=1)


@pytest.fixture
def port():
    made = Host()
    yield made
    made.end()


@pytest.fixture
def directory(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    made = tmp_path / "trocar/run"
    made.mkdir(parents=True, mode=0o700)
    return made


def door_of(port, directory):
    network = os.stat("/proc/self/ns/net").st_ino
    return directory / f"at-{port.address}.{network:x}.stop"


@pytest.fixture
def door(port, directory):
    made = Host(door=door_of(port, directory))
    yield made
    made.end()


def test_a_stop_goes_by_the_socket_beside_the_port_with_and_without_a_session(port, door):
    with trocar.connect(port.address) as ire:
        ire.stop("host/**")
        ire.stop("a/b", "c/d", dry_run=True)
    trocar.stop("a/b", address=port.address)
    assert door.stopped == [["host/**"], ["a/b", "c/d"], ["a/b"]] and port.stopped == []


def test_without_a_socket_or_with_one_that_a_killed_host_left_it_goes_by_the_port(port, directory):
    trocar.stop("a/b", address=port.address)
    # A file on which nobody listens.
    door_of(port, directory).touch()
    with trocar.connect(port.address) as ire:
        ire.stop("c/d")
    assert port.stopped == [["a/b"], ["c/d"]]


def test_a_socket_that_another_user_can_have_put_there_is_not_taken(port, door, directory):
    directory.chmod(0o770)
    trocar.stop("a/b", address=port.address)
    assert (door.stopped, port.stopped) == ([], [["a/b"]])


def test_a_refusal_of_the_socket_is_the_answer(port, door):
    def refuse(request, context):
        raise packed(grpc.StatusCode.NOT_FOUND, "there is no a/b", "COMPONENT_NOT_FOUND")

    door.answers["GcmService/Stop"] = refuse
    with pytest.raises(trocar.TrocarError, match="there is no a/b"):
        trocar.stop("a/b", address=port.address)
    with pytest.raises(trocar.TrocarError, match="name components"):
        trocar.stop(address=port.address)
    assert port.stopped == []
