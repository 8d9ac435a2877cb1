"""Promise: among several GCMs a session finds the one that leads, and goes to another when that leads."""

import grpc
import pytest

import trocar

from .conftest import eventually
from .fake import Fake, message, packed


class Manager(Fake):
    """A GCM among several; ``leader`` is the address of the one that leads, None where nobody knows."""

    def __init__(self):
        super().__init__()
        self.leader = self.address
        self.stopped = []
        self.answers["AttachService/Tell"] = self.led(lambda r, c: message("TellResponse", term=1))
        self.answers["GcmService/Stop"] = self.led(self.stop)
        self.answers["GcmService/Watch"] = self.led_stream(self.answers["GcmService/Watch"])
        self.answers["GcmService/Compare"] = self.led(lambda r, c: message("CompareResponse", notes=[self.address]))

    def refused(self):
        return packed(grpc.StatusCode.UNAVAILABLE, "it does not lead", "NOT_LEADER", leader=self.leader or "")

    def led(self, answer):
        def answered(request, context):
            if self.leader != self.address:
                raise self.refused()
            return answer(request, context)

        return answered

    def led_stream(self, answer):
        def answered(request, context):
            if self.leader != self.address:
                raise self.refused()
            yield from answer(request, context)

        return answered

    def stop(self, request, context):
        self.stopped.append(list(request.paths))
        return message("StopResponse", revision=1)

    def stay(self, context):
        while context.is_active() and not self.ending.is_set() and self.leader == self.address:
            self.ending.wait(0.01)


@pytest.fixture
def managers():
    made = [Manager() for _ in range(3)]
    yield made
    for manager in made:
        manager.end()


def leads(managers, leader):
    for manager in managers:
        manager.leader = leader.address


def addresses(managers):
    return ",".join(manager.address for manager in managers)


def test_a_session_is_with_the_gcm_that_leads_whichever_is_named_first(managers):
    leads(managers, managers[1])
    for order in (managers, managers[::-1]):
        with trocar.connect(addresses(order), place=False) as ire:
            assert ire.address == managers[1].address


def test_one_that_is_not_there_is_passed_by(managers):
    leads(managers, managers[2])
    managers[0].end()
    with trocar.connect(addresses(managers), place=False) as ire:
        assert ire.address == managers[2].address


def test_a_session_goes_to_the_gcm_that_leads_then(managers):
    leads(managers, managers[0])
    with trocar.connect(addresses(managers), place=False, say=lambda text: None) as ire:
        for leader in (managers[1], managers[2]):
            leads(managers, leader)
            eventually("it is with the one that leads", lambda leader=leader: ire.connected and ire.address == leader.address)


def test_a_call_that_was_not_led_is_asked_once_more_where_it_is(managers):
    leads(managers, managers[0])
    with trocar.connect(addresses(managers), place=False, say=lambda text: None) as ire:
        leads(managers, managers[1])
        answer = ire._wire.call("GcmService/Compare", message("CompareRequest"), 5.0)
        assert list(answer.notes) == [managers[1].address]


def test_nobody_who_leads_is_told(managers):
    for manager in managers:
        manager.leader = None
    with pytest.raises(trocar.TrocarError) as refused:
        trocar.connect(addresses(managers), timeout=0.5)
    assert refused.value.reason == "NOT_LEADER"


def doubts(manager):
    """It stops all the same, and says so."""

    def stop(request, context):
        manager.stopped.append(list(request.paths))
        return message("StopResponse", revision=7, doubted=True)

    manager.answers["GcmService/Stop"] = stop


def test_a_stop_is_asked_of_one_that_doubts_its_lead_when_none_leads(managers):
    for manager in managers:
        manager.leader = None
    doubts(managers[2])
    trocar.stop("host/**", address=addresses(managers))
    assert [manager.stopped for manager in managers] == [[], [], [["host/**"]]]


def test_the_answer_of_the_one_that_leads_counts_though_another_one_doubts(managers):
    leads(managers, managers[1])
    doubts(managers[0])

    def refuse(request, context):
        managers[1].stopped.append(list(request.paths))
        raise packed(grpc.StatusCode.DEADLINE_EXCEEDED, "it does not answer", "STOP_NOT_TOLD")

    managers[1].answers["GcmService/Stop"] = refuse
    with pytest.raises(trocar.TrocarError) as refused:
        trocar.stop("host/**", address=addresses(managers))
    assert refused.value.reason == "STOP_NOT_TOLD"
    assert [manager.stopped for manager in managers] == [[["host/**"]], [["host/**"]], []]
