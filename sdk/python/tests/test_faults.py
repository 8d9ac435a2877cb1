"""Promise: whatever a GCM answers or does not, the caller gets one sentence in time, and nothing hangs."""

import asyncio
import base64
import itertools
import pathlib
import shutil
import subprocess
import threading

import grpc
import pytest

import trocar
from trocar import _values

from .conftest import STANDSTILL_S, eventually, eventually_in_loop, reaches
from .fake import Fake, Refused, message, packed


@pytest.fixture
def fake():
    made = Fake()
    yield made
    made.end()


@pytest.fixture
def said():
    return []


@pytest.fixture
def ire(fake, said):
    with trocar.connect(fake.address, say=said.append) as session:
        yield session


@pytest.fixture
def r(ire):
    return ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))


def invoke(fake, function):
    fake.answers["InteractService/Invoke"] = function


def raises(error):
    def answer(request, context):
        raise error

    return answer


def test_a_refusal_has_code_reason_sentence_and_values(fake, r):
    invoke(fake, raises(packed(grpc.StatusCode.NOT_FOUND, "there is no such thing; there are a, b", "MEMBER_NOT_FOUND", known="a, b")))
    with pytest.raises(trocar.TrocarError) as e:
        r.Read()
    assert (e.value.code, e.value.reason, e.value.metadata) == ("NOT_FOUND", "MEMBER_NOT_FOUND", {"known": "a, b"})
    assert str(e.value) == "NOT_FOUND [MEMBER_NOT_FOUND] there is no such thing; there are a, b"


@pytest.mark.parametrize(
    "error, reason",
    [
        (Refused(grpc.StatusCode.INTERNAL, "no details at all"), "OTHER"),
        (Refused(grpc.StatusCode.INTERNAL, "details that are none", b"\xff\xff\xff\xff"), "OTHER"),
        (Refused(grpc.StatusCode.UNAVAILABLE, "proxy says no"), "GCM_UNREACHABLE"),
        (Refused(grpc.StatusCode.UNIMPLEMENTED, "what?"), "NOT_IMPLEMENTED"),
        (RuntimeError("the server raised"), "OTHER"),
    ],
)
def test_an_error_that_explains_nothing_is_an_error_all_the_same(fake, r, error, reason):
    invoke(fake, raises(error))
    with pytest.raises(trocar.TrocarError) as e:
        r.Read()
    assert e.value.reason == reason and e.value.sentence


def test_a_call_that_is_never_answered_ends_at_its_deadline(fake, r):
    def hang(request, context):
        fake.stay(context)
        return message("InvokeResponse")

    invoke(fake, hang)
    with pytest.raises(trocar.TrocarError) as e:
        r.Write(1, deadline=0.05)
    assert (e.value.code, e.value.reason) == ("DEADLINE_EXCEEDED", "DEADLINE") and "may still" in e.value.sentence


def hanging(fake):
    """Calls are never answered; which have come, and which the caller gave up."""
    came, given_up = [], []

    def hang(request, context):
        context.add_callback(lambda: given_up.append(request.path))
        came.append(request.path)
        fake.stay(context)
        return message("InvokeResponse")

    invoke(fake, hang)
    return came, given_up


def test_an_awaited_call_that_is_cancelled_ends_at_once_and_the_session_goes_on(fake, r):
    came, given_up = hanging(fake)

    async def cancelled(count):
        tasks = [asyncio.create_task(r.Read.aio(deadline=60)) for _ in range(count)]
        await eventually_in_loop("all have come", lambda: len(came) == count, progress=came.copy)
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
        assert [type(e) for e in ended] == [asyncio.CancelledError] * count and all(task.cancelled() for task in tasks)
        # The loop, and with it the rest of the program, waits for none of them.
        assert asyncio.all_tasks() == {asyncio.current_task()}
        # A call of the same loop is answered afterwards, beside others that are still asked.
        invoke(fake, lambda request, context: message("InvokeResponse", encoded=(30).to_bytes(4, "little"), unit="mm"))
        assert await asyncio.gather(*(r.Read.aio() for _ in range(3))) == [30] * 3

    asyncio.run(cancelled(5))
    reaches("the host hears of each that it is not waited for", lambda: len(given_up), 5)
    assert len(given_up) == 5
    assert r.Read() == 30, "and so is one without a loop"


def test_an_answer_that_comes_when_the_loop_is_closed_disturbs_nobody(fake, r, caplog):
    came, release, answered = threading.Event(), threading.Event(), threading.Event()

    def late(request, context):
        context.add_callback(answered.set)
        came.set()
        release.wait(STANDSTILL_S)
        return message("InvokeResponse", encoded=(30).to_bytes(4, "little"), unit="mm")

    invoke(fake, late)
    loop = asyncio.new_event_loop()
    call = r.Read.aio(deadline=60)
    waits = loop.create_task(call)
    loop.run_until_complete(eventually_in_loop("it is asked", came.is_set))
    # As a program ends that forgets what it asked; the answer comes afterwards.
    loop.close()
    release.set()
    eventually("it is answered", answered.is_set)
    assert r.Read() == 30
    # grpc tells of callbacks that raise in the log.
    assert not [record for record in caplog.records if "callback" in record.getMessage()], caplog.text
    waits._log_destroy_pending = False
    call.close()


def test_what_a_call_says_of_its_deadline_reaches_the_host(fake, r):
    seen = []

    def answer(request, context):
        seen.append((request.path, request.deadline.seconds + request.deadline.nanos / 1e9, request.json.number_value, request.send))
        return message("InvokeResponse", executed=True)

    invoke(fake, answer)
    r.Write(30)
    r.Write(31, deadline=2.5)
    r.Write.send(32)
    path = "ProcessServer/Server/Provided/Write"
    assert seen == [(path, 1.0, 30, False), (path, 2.5, 31, False), (path, 1.0, 32, True)]


def test_bytes_that_do_not_fit_their_type_are_refused(fake, r):
    invoke(fake, lambda request, context: message("InvokeResponse", encoded=b"\x01\x02"))
    with pytest.raises(trocar.TrocarError, match="2 bytes came for 1 of i32, which has 4"):
        r.Read()


def test_a_gcm_without_guests_is_used_all_the_same_and_that_is_said(fake, said):
    del fake.answers["GuestService/Join"]
    with trocar.connect(fake.address, say=said.append) as ire:
        assert said == ["this GCM knows no guests: the session works, but the graph does not show it"]
        r = ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))
        invoke(fake, lambda request, context: message("InvokeResponse", encoded=(30).to_bytes(4, "little"), unit="mm"))
        assert repr(r.Read()) == "30 mm" and ire.component == ""


def test_a_gcm_that_never_answers_the_first_question_is_told_of(fake):
    def silent(request, context):
        fake.stay(context)
        yield from ()

    fake.answers["GcmService/Watch"] = silent
    with pytest.raises(trocar.TrocarError) as e:
        trocar.connect(fake.address, timeout=0.2)
    assert e.value.code == "DEADLINE_EXCEEDED" and "0.2 s" in e.value.sentence


def test_a_name_that_is_taken_is_the_servers_to_change(fake, ire):
    def join(request, context):
        yield message("JoinResponse", process="ire7", component="ire7/shell", term=7)
        fake.stay(context)

    fake.answers["GuestService/Join"] = join
    with trocar.connect(fake.address) as other:
        assert (other.process, other.component) == ("ire7", "ire7/shell")


def items(fake, values, skipped=0):
    """Subscribe sends the state, these events, and stays."""

    def subscribe(request, context):
        event = request.selections[0].path
        yield message("SubscribeResponse", path="ProcessServer/Server", kind=1)
        for n, value in enumerate(values):
            yield message("SubscribeResponse", path=event, kind=2, json=_values.to_wire(value), stamp_ns=n + 1, seq=n + 1, skipped=skipped)
        fake.stay(context)

    fake.answers["InteractService/Subscribe"] = subscribe


def test_a_full_queue_drops_the_oldest_and_the_next_item_tells_how_many(fake, r):
    items(fake, range(1000))
    entered, release, got = threading.Event(), threading.Event(), []

    def slow(v, item):
        entered.set()
        release.wait(STANDSTILL_S)
        got.append((int(v), item.skipped))

    f = r.on.SetPointReached(slow, depth=10)
    eventually("the handler has begun", entered.is_set)
    reaches("all have come", lambda: f.received, 1000)
    release.set()
    reaches("those that were kept were handled", lambda: len(got), 1000 - f.skipped)
    assert got[-10:] == [(990, got[-10][1]), *((n, 0) for n in range(991, 1000))], got
    assert sum(skipped for _, skipped in got) == f.skipped == 1000 - len(got)
    assert all(b[0] == a[0] + 1 + b[1] for a, b in zip(got, got[1:])), "each gap is told where it is"


def test_a_handler_that_raises_each_time_shows_why_once_and_counts(fake, r, capfd):
    items(fake, range(200))
    f = r.on.SetPointReached(lambda v: 1 / 0)
    reaches("each was handled", lambda: f.errors, 200)
    shown = capfd.readouterr().err
    assert shown.count("ZeroDivisionError") == 1 and "SetPointReached raised:" in shown, shown
    with pytest.raises(TypeError, match="a handler is a function; 5 is not"):
        r._session.follow(str(r.on.SetPointReached), 5)


def test_what_the_host_left_out_is_counted_too(fake, r):
    items(fake, range(5), skipped=3)
    with r.on.SetPointReached.follow() as f:
        assert [f.next(STANDSTILL_S).skipped for _ in range(5)] == [3] * 5
        assert f.skipped == 15 and f.received == 5


def test_a_stream_that_breaks_is_taken_up_again(fake, r):
    times = []

    def subscribe(request, context):
        times.append(1)
        yield message("SubscribeResponse", path="ProcessServer/Server", kind=1)
        yield message("SubscribeResponse", path=request.selections[0].path, kind=2, json=_values.to_wire(len(times)), seq=1)
        if len(times) < 3:
            raise Refused(grpc.StatusCode.UNAVAILABLE, "connection reset")
        fake.stay(context)

    fake.answers["InteractService/Subscribe"] = subscribe
    with r.on.SetPointReached.follow() as f:
        assert [int(f.next(STANDSTILL_S).value) for _ in range(3)] == [1, 2, 3]
        assert f.breaks == 2


def test_a_stream_of_another_type_ends_with_a_sentence(fake, r):
    items(fake, [1, "one", 2])
    with r.on.SetPointReached.follow() as f:
        assert int(f.next(STANDSTILL_S).value) == 1
        with pytest.raises(trocar.TrocarError, match="sends something else than when it was followed") as e:
            f.next(STANDSTILL_S)
        assert e.value.reason == "TYPE_MISMATCH" and f.ended is e.value


def test_following_what_is_refused_raises_at_once(fake, r):
    def refused(request, context):
        raise packed(grpc.StatusCode.NOT_FOUND, "no such event", "MEMBER_NOT_FOUND")
        yield

    fake.answers["InteractService/Subscribe"] = refused
    with pytest.raises(trocar.TrocarError, match="MEMBER_NOT_FOUND"):
        r.on.SetPointReached(print)


def test_a_place_that_ends_is_taken_again_with_what_was_required(fake, said):
    left = []

    def join(request, context):
        n = len(left) + 1
        left.append(n)
        yield message("JoinResponse", process=request.process, component=f"{request.process}/shell", term=n)
        if n == 1:
            release.wait(STANDSTILL_S)
            return
        fake.stay(context)

    release, required = threading.Event(), []
    fake.answers["GuestService/Join"] = join
    require = fake.answers["GuestService/Require"]

    def required_once_more(request, context):
        required.append((request.component, request.name))
        return require(request, context)

    fake.answers["GuestService/Require"] = required_once_more
    with trocar.connect(fake.address, say=said.append) as ire:
        ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"), "mine")
        release.set()
        joined = "joined again as ire/shell, 1 of 1 connected again"
        eventually("it is said", lambda: any(joined in s for s in said), progress=said.copy)
        assert required == [("ire/shell", "mine"), ("ire/shell", "Provided")], "the name it was given is asked for"


def test_closing_ends_calls_streams_and_threads(fake, r, ire):
    items(fake, range(3))
    f = r.on.SetPointReached(lambda v: None)
    ire.close()
    ire.close()

    def threads():
        return [t.name for t in threading.enumerate() if t.name.startswith("trocar-") and t.is_alive()]

    eventually("no thread of the session is left", lambda: not threads(), progress=threads)
    assert "closed" in repr(ire) and "closed" in repr(f)
    for late in (r.Read, lambda: ire.start("a/b"), lambda: r.on.SetPointReached(print)):
        with pytest.raises(trocar.TrocarError, match="CLOSED"):
            late()


def test_channel_credentials_are_taken_and_needed(tmp_path):
    if shutil.which("openssl") is None:
        pytest.skip("openssl is missing, which makes the certificate")
    key, cert = tmp_path / "key.pem", tmp_path / "cert.pem"
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", key, "-out", cert, "-days", "2", "-subj",
                    "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"], check=True, capture_output=True)  # fmt: skip
    fake = Fake(grpc.ssl_server_credentials([(key.read_bytes(), cert.read_bytes())]))
    try:
        credentials = grpc.ssl_channel_credentials(pathlib.Path(cert).read_bytes())
        with trocar.connect(fake.address, credentials=credentials, timeout=30) as ire:
            assert ire.process == "ire"
        with pytest.raises(trocar.TrocarError):
            trocar.connect(fake.address, timeout=1)
        with pytest.raises(trocar.TrocarError):
            trocar.connect(fake.address, credentials=grpc.ssl_channel_credentials(), timeout=1)
    finally:
        fake.end()


def test_a_token_of_the_environment_goes_with_each_request_and_none_does_without(monkeypatch):
    fake, sent = Fake(), {}

    def noting(name, answer):
        def noted(request, context):
            sent[name] = dict(context.invocation_metadata()).get("authorization")
            return answer(request, context)

        return noted

    fake.answers = {name: noting(name, answer) for name, answer in fake.answers.items()}
    try:
        for token, header in (("", None), ("0123", "Bearer 0123")):
            monkeypatch.setenv("TROCAR_TOKEN", token)
            sent.clear()
            with trocar.connect(fake.address) as ire:
                assert ire.ProcessServer.Server.Provided.Write
            assert {"GcmService/Watch", "GuestService/Join", "GcmService/Describe"} <= sent.keys() and set(sent.values()) == {header}, sent
    finally:
        fake.end()


def test_an_address_that_is_none_is_refused():
    with pytest.raises(trocar.TrocarError, match="HOST:PORT"):
        trocar.connect(42)
    with pytest.raises(trocar.TrocarError) as e:
        trocar.connect("nobody.invalid:1", timeout=1)
    assert e.value.code in ("UNAVAILABLE", "DEADLINE_EXCEEDED"), e.value


def measured(fake, numbers):
    """Read answers these numbers one after the other, each 10 ms later, then refuses."""
    left = list(enumerate(numbers, 1))

    def answer(request, context):
        if not left:
            raise packed(grpc.StatusCode.FAILED_PRECONDITION, "it is not ACTIVE", "NOT_ACTIVE")
        n, value = left.pop(0)
        return message("InvokeResponse", encoded=value.to_bytes(4, "little"), unit="mm", stamp_ns=n * 10_000_000)

    invoke(fake, answer)


def test_a_plot_with_a_window_draws_itself_and_shows_a_gap_where_nothing_was_read(fake, ire, monkeypatch):
    import matplotlib
    import matplotlib.pyplot as plt

    # The canvas is one without a screen; everything else is as with one.
    matplotlib.use("Agg")
    monkeypatch.setattr(matplotlib, "get_backend", lambda: "QtAgg")
    monkeypatch.setattr(plt, "show", lambda block: None)
    measured(fake, [5, 7, 9])
    plot = ire.plot("ProcessServer/Server/Provided/Read", seconds=60, rate_hz=200)
    reaches("reads are refused", lambda: plot.signals[0].missed, 4)
    for callback, args, kwargs in plot._timer.callbacks:
        callback(*args, **kwargs)
    (axes,) = plot._figure.axes
    assert axes.get_ylabel() == "mm" and axes.get_xlabel() == "time, s"
    y = axes.lines[0].get_ydata()
    assert [float(v) for v in y if v == v] == [5, 7, 9] and (y != y).any(), "a gap, and no old value"
    assert "it is not ACTIVE" in repr(plot)
    assert plot._repr_png_().startswith(b"\x89PNG")
    plot._figure.canvas.callbacks.process("close_event", None)
    assert plot._ended.is_set(), "closing the window ends it"
    plt.close(plot._figure)


async def run_cell(shell, cell):
    done = await shell.run_cell_async(cell, transformed_cell=shell.transform_cell(cell))
    done.raise_error()
    return done.result


@pytest.fixture
def notebook():
    """IPython's shell as a kernel has it, with what it shows in a list."""
    from IPython.core.displaypub import CapturingDisplayPublisher
    from IPython.core.interactiveshell import InteractiveShell

    shell = InteractiveShell.instance()
    shell.display_pub = CapturingDisplayPublisher(parent=shell)
    # The one thing a kernel's shell has that this one has not.
    shell.kernel = object()
    yield shell
    shell.restore_sys_module_state()
    InteractiveShell.clear_instance()


def test_a_plot_in_a_notebook_is_a_picture_that_is_renewed_until_it_is_stopped(fake, ire, notebook):
    refused, count = threading.Event(), itertools.count(1)

    def answer(request, context):
        if refused.is_set():
            raise packed(grpc.StatusCode.FAILED_PRECONDITION, "it is not ACTIVE", "NOT_ACTIVE")
        n = next(count)
        return message("InvokeResponse", encoded=(n % 7).to_bytes(4, "little"), unit="mm", stamp_ns=n * 10_000_000)

    invoke(fake, answer)
    shown = notebook.display_pub.outputs
    notebook.user_ns["ire"] = ire

    async def renewed():
        # The kernel's loop goes round between cells, and what is to be drawn is drawn by it.
        asked = len(shown)
        await eventually_in_loop("it is drawn anew", lambda: len(shown) > asked)

    async def cells():
        plot = await run_cell(notebook, "p = ire.plot('ProcessServer/Server/Provided/Read', seconds=60, rate_hz=200); p")
        assert not shown[0]["update"]
        ((signal, _),) = plot.data().items()
        await eventually_in_loop("samples come", lambda: len(plot.data()[signal][0]) > 3, progress=lambda: len(plot.data()[signal][0]))
        await renewed()
        refused.set()
        await eventually_in_loop("a read is refused", lambda: plot.signals[0].missed > 0)
        await renewed()
        # Shown a second time it is the same picture: both are renewed.
        assert await run_cell(notebook, "p") is plot
        plot.stop()
        await renewed()
        # Nothing is left for the loop to do: the last one was the last.
        assert not [h for h in asyncio.get_running_loop()._scheduled if not h.cancelled()]

    asyncio.run(cells())
    updates = [s["update"] for s in shown]
    # It is renewed as time goes by, so at least as often as was waited for.
    again = updates.index(False, 1)
    assert not updates[0] and updates.count(False) == 2 and again >= 3 and len(updates) > again + 1, updates
    assert len({s["transient"]["display_id"] for s in shown}) == 1
    pictures = [base64.b64decode(s["data"]["image/png"]) for s in shown]
    assert all(p.startswith(b"\x89PNG") for p in pictures) and set(pictures) != {pictures[0]}, "it shows what has come"
    told = [s["data"]["text/plain"] for s in shown]
    assert "missed" not in told[0] and "it is not ACTIVE" in told[-1], told


def test_a_plot_in_a_terminal_is_told_in_words(fake, ire, notebook, capsys):
    del notebook.kernel
    measured(fake, range(5, 15))
    notebook.user_ns["ire"] = ire

    async def cells():
        await run_cell(notebook, "ire.plot('ProcessServer/Server/Provided/Read')")

    asyncio.run(cells())
    assert not notebook.display_pub.outputs and "<plot of ProcessServer/Server/Provided/Read" in capsys.readouterr().out
