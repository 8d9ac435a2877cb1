"""What a session looks at: descriptions, states, log lines, rows, samples and frames, followed or asked for once.

Invariant: nothing here changes the system, and whatever waits has a deadline.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import grpc
import numpy as np

from . import _proto, _system_file, _values
from ._errors import TrocarError, invalid
from ._follow import DEPTH, Follower
from ._graph import Graph
from ._paths import nearest, path_of
from ._proxy import MARGIN, Event
from ._show import Description, Lines
from ._wire import Wire


class Looking:
    """The verbs of ``Session`` that look."""

    _wire: Wire
    _graph: Graph
    _followers: set[Any]
    _plots: weakref.WeakSet[Any]
    _call: Callable[..., Any]
    _command: Callable[[str], Any]
    call: Callable[..., Any]

    def describe(self, path: Any = "", *, class_: str = "") -> Description:
        """What a process, component, port, command or class offers, with types, units, ranges and documentation."""
        __tracebackhide__ = True
        fields: dict[str, Any] = {"class": class_} if class_ else {"path": path_of(path)}
        return Description(self._call("GcmService/Describe", **fields), fields.get("path") or class_)

    def classes(self, pattern: str = "") -> list[str]:
        """The classes there are, ``plugin/class``, of all processes."""
        names = {c for p in self._graph.processes.values() for c in p.classes}
        return sorted(n for n in names if pattern in n)

    def state(self, path: Any) -> str:
        """State of a component: ``"ACTIVE"``, ``"STOPPED{requested}"``, …"""
        __tracebackhide__ = True
        c = self._call("GcmService/GetState", path=path_of(path, (2,))).component
        return _system_file.state_text(c)

    def wait_for(self, path: Any, states: str | Iterable[str] = "ACTIVE", *, deadline: float = 5.0, call: Any = None) -> Any:
        """Waits until a component is in a state, or until an event is sent (and answers its value), ``deadline`` seconds at most.

        ``call`` is a command's path (or a tuple of it and its argument) that is called once the event is listened for.
        """
        __tracebackhide__ = True
        where = path_of(path, (2, 4))
        if not isinstance(deadline, (int, float)) or not 0 < deadline <= 60:
            raise invalid(f"deadline is {deadline!r}; give seconds, above 0 and at most 60", field="deadline")
        request = _proto.message("WaitForRequest")(path=where, deadline=_proto.duration(deadline))
        if where.count("/") == 1:
            numbers = {word: n for n, word in _proto.STATES.items()}
            for state in [states] if isinstance(states, str) else states:
                if state not in numbers or state == "UNSPECIFIED":
                    known = [w for w in numbers if w != "UNSPECIFIED"]
                    raise invalid(
                        f"{state!r} is no state; there are {', '.join(known)}{nearest(str(state), known)}",
                        field="states",
                    )
                request.states.append(numbers[state])
            answer = self._wire.call("GcmService/WaitFor", request, deadline + MARGIN)
            return _system_file.state_text(answer.component)
        if call is not None:
            command, *args = call if isinstance(call, tuple) and not isinstance(call[0], tuple) and "/" in str(call[0]) else (call,)
            asked, _ = self._command(path_of(command, (4,)))._request(tuple(args), {}, min(deadline, 60), False)
            request.call.CopyFrom(asked)
        answer = self._wire.call("GcmService/WaitFor", request, deadline + MARGIN)
        event = self._event(where)
        return _values.from_json(event._type, _values.plain(answer.json), event._unit)

    def _event(self, path: str) -> Event:
        owner, port, name = path.rpartition("/")[0].rpartition("/")[0], path.split("/")[2], path.split("/")[3]
        for provided in self._graph.describe(owner).ports.provided:
            if provided.name == port:
                for event in provided.events:
                    if event.name == name:
                        return Event(self, path, event)
        raise TrocarError("NOT_FOUND", "MEMBER_NOT_FOUND", f"{path}: there is no such event", {"member": path})

    def logs(self, path: Any = "", *, level: str = "info", last: int = 50) -> Lines:
        """What components and hosts logged: the newest ``last`` lines, of a process, component or glob, down to ``level``."""
        __tracebackhide__ = True
        return Lines(list(self._logs(path, level, last, False)))

    def follow_logs(self, path: Any = "", *, level: str = "info") -> Iterator[Any]:
        """Log lines as they come."""
        return self._logs(path, level, 0, True)

    def _logs(self, path: Any, level: str, last: int, follow: bool) -> Iterator[Any]:
        text = path if isinstance(path, str) else path_of(path)
        request = _proto.message("LogsRequest")(path=text, level=level, last=last, follow=follow)
        try:
            for answer in self._wire.stream("InteractService/Logs", request):
                yield answer.line
        except grpc.RpcError as e:
            error = self._wire.error(e, "InteractService/Logs")
        else:
            return
        raise error

    def latest(self, path: Any, rows: int | None = None) -> Any:
        """The newest data of a path, as numpy arrays.

        Of a component its state row, a structured array (``rows=n``: the newest n rows); of an output its newest sample, or frame as
        an array of its pixels or lines; of a read command its result.
        """
        __tracebackhide__ = True
        where = path_of(path, (2, 3, 4))
        parts = where.count("/") + 1
        if parts == 4:
            return self.call(where)
        owner = "/".join(where.split("/")[:2])
        if parts == 2:
            return self._rows(where, self._graph.describe(owner).ports, rows)
        if rows is not None:
            raise invalid(f"{where}: an output keeps no rows; leave rows out, or follow it", field="rows")
        return self._sample(where, owner)

    def _rows(self, path: str, ports: Any, rows: int | None) -> Any:
        if not ports.HasField("state") or ports.state.size == 0:
            raise TrocarError("FAILED_PRECONDITION", "NO_SAMPLE", f"{path} has no state table; its outputs and reads may tell more")
        if rows is not None and (isinstance(rows, bool) or not isinstance(rows, int) or not 1 <= rows <= 65536):
            raise invalid(f"rows is {rows!r}; give a whole number from 1 to 65536", field="rows")
        got = [self._call("InteractService/Read", path=path)]
        if not got[0].encoded:
            raise TrocarError("DEADLINE_EXCEEDED", "NO_SAMPLE", f"{path} has published no row yet; start it")
        newest = got[0].seq
        wanted = range(newest - (rows or 1) + 1, newest)
        got = [*self._read_ticks(path, [t for t in wanted if t >= 0]), got[0]]
        out = _values.to_rows(ports.state, [g.encoded for g in got]).view(_values.Rows)
        out.units, out.path = _values.units_in(ports.state), path
        out.seq = np.array([g.seq for g in got], "u8")
        out.stamp_ns = np.array([g.stamp_ns for g in got], "u8")
        out.age_s = got[-1].age_ns / 1e9
        if rows is None:
            out.seq, out.stamp_ns = int(got[-1].seq), int(got[-1].stamp_ns)
            return out.reshape(())
        return out

    def _read_ticks(self, path: str, ticks: list[int]) -> list[Any]:
        """Rows by their ticks, many questions at a time; a tick that has no row (left out after an overrun, overwritten) is left out."""
        out, request = [], _proto.message("ReadRequest")
        for at in range(0, len(ticks), 64):
            asked = [self._wire.begin("InteractService/Read", request(path=path, tick=t), 5.0) for t in ticks[at : at + 64]]
            for one in asked:
                try:
                    out.append(one.result())
                except grpc.RpcError as e:
                    error = self._wire.error(e, "InteractService/Read")
                    if error.metadata.get("field") not in ("tick", None) or error.code != "INVALID_ARGUMENT":
                        raise error from None
        return out

    def _sample(self, path: str, owner: str) -> Any:
        kind = self._output_type(path, owner)
        request = _proto.METHODS["InteractService/Read"].request(path=path)
        framed = kind is not None and kind.WhichOneof("kind") == "frame"
        if framed and "frame" in request.DESCRIPTOR.fields_by_name:
            request.frame = True
        got = self._wire.call("InteractService/Read", request, 2.0 + MARGIN)
        if framed:
            data = getattr(got, "frame", b"")
            if got.frame_bytes and not data:
                raise TrocarError(
                    "UNIMPLEMENTED",
                    "NOT_IMPLEMENTED",
                    f"{path}: this host hands out headers of frames, not their {got.frame_bytes} bytes",
                )
            out: Any = _values.to_frame(kind.frame, got.encoded, data)
        elif kind is not None and kind.WhichOneof("kind") == "plain":
            ty = kind.plain
            if _values.shape_of(ty) not in ("structure", "array", "list"):
                return _values.to_value(ty, got.encoded)
            out = _values.to_rows(ty, [got.encoded]).view(_values.Rows)
            out = out.reshape(out.shape[1:])
            out.units = _values.units_in(ty)
        else:
            return _values.plain(got.json)
        out.seq, out.stamp_ns, out.age_s, out.path = got.seq, got.stamp_ns, got.age_ns / 1e9, path
        return out

    def _output_type(self, path: str, owner: str) -> Any:
        name = path.rpartition("/")[2]
        for output in self._graph.describe(owner).ports.outputs:
            if output.name == name:
                return output.type
        return None

    def follow(
        self,
        path: Any,
        handler: Callable[..., Any] | None = None,
        *,
        max_rate_hz: float = 30.0,
        depth: int = DEPTH,
        thumbnail_width: int = 0,
    ) -> Follower:
        """Follows an output, an event, or how a component stands.

        ``handler`` gets each value (or value and item) in a thread of its own; without one, iterate over the result, or ask it for
        ``next(timeout)``. At most ``max_rate_hz`` items of an output come, Hz; ``thumbnail_width`` asks for frames that are
        images as JPEG, px.
        """
        __tracebackhide__ = True
        where = path_of(path, (2, 3, 4))
        if not isinstance(max_rate_hz, (int, float)) or not 0 < max_rate_hz <= 1000:
            raise invalid(f"max_rate_hz is {max_rate_hz!r}; give a rate above 0 and at most 1000 Hz", field="max_rate_hz")
        parts = where.split("/")
        kind: tuple[Any, str] = (None, "")
        if len(parts) == 4:
            event = self._event(where)
            kind = (event._type, event._unit)
        elif len(parts) == 3:
            ty = self._output_type(where, "/".join(parts[:2]))
            if ty is not None:
                kind = (ty.plain if ty.WhichOneof("kind") == "plain" else ty.frame.header, "")
        return self._followed(Follower(self, where, kind, handler, depth, max_rate_hz, thumbnail_width))

    def _followed(self, follower: Follower) -> Follower:
        self._followers.add(follower)
        return follower

    def plot(self, *signals: Any, seconds: float = 10.0, rate_hz: float = 50.0, title: str = "") -> Any:
        """Plots signals live: ``ire.plot("robot/eyerobot/arm/measured_js.position[0]", seconds=10)``.

        A signal is a read command, an output or a component's state, and a field in it. ``seconds`` is the width of the window, ``rate_hz``
        how often each is looked at. Without a screen it samples all the same, and ``.save("file.png")`` draws it.
        """
        __tracebackhide__ = True
        from ._plot import Plot

        plot = Plot(self, signals, seconds, rate_hz, title)
        self._plots.add(plot)
        return plot

    def record(self, name: str, patterns: Iterable[str], *, pre_trigger: float = 0.0, **settings: Any) -> Any:
        """Records what the patterns name while the ``with`` block lasts: ``with ire.record("trial7", ["robot/**"]): …``.

        ``pre_trigger`` keeps so many seconds from before the beginning, s. Of the ``settings``, ``process`` says which one records (the
        one with most of it) and ``directory`` where; ``video`` is ``"raw"``, ``"qoi"`` or ``"jpeg"``; ``max_rate_hz`` is the most
        samples of each output, Hz, or a mapping of patterns to that; ``cpus`` are the processors the recorder's threads may run on;
        ``config`` is what else the recorder is to be configured with.
        """
        __tracebackhide__ = True
        from ._record import LiveRecording

        return LiveRecording(self, name, patterns, pre_trigger, **settings)

    def sleep(self, seconds: float) -> None:
        """Waits; ends early when the session is closed."""
        self._closing.wait(seconds)
