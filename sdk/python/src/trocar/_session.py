"""``connect()`` and the session it gives: everything a system offers, from a Python prompt or a script.

Invariant: a session never stalls a component: every call has a deadline, every queue is bounded and counts what it drops.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import grpc
import numpy as np

from . import _ipython, _nodes, _proto, _system_file, _values
from ._errors import TrocarError, invalid
from ._follow import DEPTH, Follower
from ._graph import Graph
from ._paths import nearest, path_of
from ._place import Place
from ._proxy import MARGIN, Command, Event, Interface
from ._show import Answer, Description, Lines, Tree
from ._wire import Wire

DEFAULT_ADDRESS = "127.0.0.1:50551"
_PATIENCE = 10.0
_sessions: weakref.WeakSet[Session] = weakref.WeakSet()


def connect(
    address: str | None = None,
    *,
    name: str = "ire",
    credentials: grpc.ChannelCredentials | None = None,
    deadline: float = 1.0,
    timeout: float = 5.0,
    place: bool = True,
    say: Callable[[str], None] | None = None,
    options: list[tuple[str, Any]] | None = None,
) -> Session:
    """Connects to a GCM, or to a host with one of its own.

    ``address`` is ``host:port``; left out, it is ``TROCAR_GCM`` of the environment or 127.0.0.1:50551. ``name`` is that of the process
    under which the graph shows this session (the first free of ire, ire2, …); ``place=False`` stays unseen. ``credentials`` are
    grpc's channel credentials, for a GCM behind TLS. ``deadline`` is how long calls wait unless they say otherwise, s; ``timeout``
    how long connecting may take, s. ``say`` hears of the GCM lost and found (stderr otherwise). ``options`` go to grpc's channel.
    """
    __tracebackhide__ = True
    where = address or os.environ.get("TROCAR_GCM") or DEFAULT_ADDRESS
    if not isinstance(where, str):
        raise invalid(f'address is {where!r}; write "HOST:PORT"', field="address")
    where = where[len("http://") :] if where.startswith("http://") else where
    if not 0 < deadline <= 60:
        raise invalid(f"deadline is {deadline!r}; give seconds, above 0 and at most 60", field="deadline")
    session = Session(Wire(where, credentials, options), name, deadline, say)
    try:
        session._graph.open(timeout)
        if place:
            session._place.join(timeout)
            # The tree that is looked at next shows this process too.
            session._graph.wait(lambda: not session.process or session.process in session._graph.processes, 1.0)
            if session._place.refused is not None:
                session._say("this GCM knows no guests: the session works, but the graph does not show it")
    except BaseException:
        session.close()
        raise
    _ipython.install()
    return session


class Session:
    """A system, seen and changed from here. Processes are attributes: ``ire.robot.eyerobot.arm.measured_js()``.

    Paths are texts (``"robot/eyerobot/arm"``), tuples (``("robot", "eyerobot", "arm")``) or such attributes. What changes the
    system takes ``dry_run=True`` and then only answers what would be done.
    """

    def __init__(self, wire: Wire, name: str, deadline: float, say: Callable[[str], None] | None) -> None:
        self._wire = wire
        self._saying = say
        self._closing = threading.Event()
        self._followers: set[Any] = set()
        self._plots: weakref.WeakSet[Any] = weakref.WeakSet()
        self._recordings: set[Any] = set()
        self._graph = Graph(wire, self._hear)
        self._place = Place(self, name)
        self.deadline = float(deadline)
        _sessions.add(self)

    # What it is.

    @property
    def address(self) -> str:
        """Where the GCM listens."""
        return self._wire.address

    @property
    def closed(self) -> bool:
        """True once ``close`` was called."""
        return self._closing.is_set()

    @property
    def connected(self) -> bool:
        """True while the GCM answers."""
        return self._graph.connected

    @property
    def process(self) -> str:
        """The process as which the graph shows this session; empty = it has no place there."""
        return self._place.process

    @property
    def component(self) -> str:
        """Path of this session's component; its required interfaces are made by ``AddInterfaceRequiredAndConnect``."""
        return self._place.component

    @property
    def revision(self) -> int:
        """Revision of the graph as it was told last."""
        return self._graph.revision

    @property
    def tree(self) -> Tree:
        """Processes, components, ports and connections, as text and in Jupyter as a picture."""
        return Tree(self)

    def _hear(self, kind: str, error: TrocarError | None) -> None:
        if kind == "gone":
            self._say(f"the GCM at {self.address} is gone; calls are refused until it is back")
        else:
            self._say(f"the GCM at {self.address} is back (term {self._graph.term})")

    def _say(self, text: str) -> None:
        if self._saying is not None:
            self._saying(text)
        else:
            sys.stderr.write(f"trocar: {text}\n")
            sys.stderr.flush()

    def _call(self, name: str, timeout: float = _PATIENCE, **fields: Any) -> Any:
        __tracebackhide__ = True
        return self._wire.call(name, _proto.METHODS[name].request(**fields), timeout)

    # Interfaces.

    def AddInterfaceRequiredAndConnect(self, provided: Any, required: str = "") -> Interface:
        """Adds a required interface to this process, connects it to a provided one, and hands back a proxy of that.

        ``provided`` is ``("process", "component", "interface")`` or its path; ``required`` is the name of the new interface, by
        default that of the provided one. The graph shows the connection; ``disconnect`` takes it away.
        """
        __tracebackhide__ = True
        path = path_of(provided, (3,), "a provided interface")
        if self.component:
            answer = self._place.require(path, required)
            interface = Interface(self, path, answer.provided, answer.client, answer.connection)
            self._place.keep(interface)
            self._seen(answer.revision)
            return interface
        return self._interface(path)

    def _interface(self, path: str) -> Interface:
        description = self._call("GcmService/Describe", path=path)
        for provided in description.ports.provided:
            return Interface(self, path, provided)
        raise TrocarError("INVALID_ARGUMENT", "WRONG_DIRECTION", f"{path} is no provided interface; {self._provided_at(path)}")

    def _provided_at(self, path: str) -> str:
        owner = path.rpartition("/")[0]
        names = [p.name for p in self._call("GcmService/Describe", path=owner).ports.provided]
        return f"{owner} provides {', '.join(names) or 'none'}"

    def call(self, path: Any, /, *args: Any, deadline: float | None = None, **fields: Any) -> Any:
        """Calls one command: ``ire.call("robot/eyerobot/arm/measured_js")``."""
        __tracebackhide__ = True
        return self._command(path_of(path, (4,), "a command"))(*args, deadline=deadline, **fields)

    def _command(self, path: str) -> Command:
        owner, _, name = path.rpartition("/")
        described = self._graph.describe("/".join(path.split("/")[:2]))
        port = owner.rpartition("/")[2]
        for provided in described.ports.provided:
            if provided.name == port:
                for command in provided.commands:
                    if command.name == name:
                        return Command(self, path, command)
        # Whoever is asked for what is not there gets the host's own words.
        found = self._call("GcmService/Describe", path=path).ports.provided
        for provided in found:
            for command in provided.commands:
                return Command(self, path, command)
        raise TrocarError("INVALID_ARGUMENT", "WRONG_KIND", f"{path} is no command", {"member": path})

    # Changing the system.

    def create(
        self,
        path: Any,
        class_: str,
        config: Mapping[str, Any] | None = None,
        execution: Mapping[str, Any] | None = None,
        *,
        isolation: str = "",
        dry_run: bool = False,
    ) -> Answer:
        """Makes a component: ``ire.create("host/robot", "eyerobot", {"seed": 7}, {"rate_hz": 1000})``."""
        __tracebackhide__ = True
        fields: dict[str, Any] = {"class": class_, "path": path_of(path, (2,)), "isolation": isolation}
        return self._change("Create", fields, config, execution, dry_run)

    def configure(
        self,
        path: Any,
        config: Mapping[str, Any] | None = None,
        execution: Mapping[str, Any] | None = None,
        *,
        dry_run: bool = False,
        **settings: Any,
    ) -> Answer:
        """Changes settings of a component: what is given is merged into what it has, ``None`` gives a key its default."""
        __tracebackhide__ = True
        merged = {**(config or {}), **settings} if config is not None or settings else None
        return self._change("Configure", {"path": path_of(path, (2,))}, merged, execution, dry_run)

    def start(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Starts components, servers before clients; globs like ``"host/**"`` too. From STOPPED this is a fresh start."""
        __tracebackhide__ = True
        return self._each("Start", paths, dry_run)

    def stop(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Stops components; their devices are made safe."""
        __tracebackhide__ = True
        return self._each("Stop", paths, dry_run)

    def resume(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Lets stopped components go on with the state they had."""
        __tracebackhide__ = True
        return self._each("Resume", paths, dry_run)

    def reset(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Makes components anew, from FAULT to READY."""
        __tracebackhide__ = True
        return self._each("Reset", paths, dry_run)

    def remove(self, path: Any, *, force: bool = False, dry_run: bool = False) -> Answer:
        """Destroys a component; ``force`` stops and disconnects it first."""
        __tracebackhide__ = True
        return self._change("Remove", {"path": path_of(path, (2,)), "force": force}, None, None, dry_run)

    def connect(self, client: Any, server: Any, *, dry_run: bool = False, **options: Any) -> Answer:
        """Connects a required interface or input to a provided interface or output.

        ``options`` as in a system file: ``queue={"fifo": 8}``, ``max_age_ms``, ``deadline_ms``, ``mailbox``, ``adapt``,
        ``carrier``, and ``replace=True``.
        """
        __tracebackhide__ = True
        fields: dict[str, Any] = {"client": path_of(client, (3,)), "server": path_of(server, (3,))}
        if options:
            fields["options"] = _system_file.connect_options(options, "connect")
        return self._change("Connect", fields, None, None, dry_run)

    def disconnect(self, client: Any, server: Any = None, *, dry_run: bool = False) -> Answer:
        """Takes a connection away: by its number, its two ends, one end where that is enough, or the proxy that uses it."""
        __tracebackhide__ = True
        fields: dict[str, Any] = {}
        if isinstance(client, bool) or (isinstance(client, int) and client <= 0):
            raise invalid(f"connection {client!r}: give a number of `tree`, or its ends", field="id")
        if isinstance(client, int):
            fields["id"] = client
        elif isinstance(client, Interface) and client._connection:
            fields["id"] = client._connection
        else:
            fields["client"] = path_of(client, (3,))
        if server is not None:
            fields["server"] = path_of(server, (3,))
        answer = self._change("Disconnect", fields, None, None, dry_run)
        if not dry_run and "id" in fields:
            self._place.forget(fields["id"])
        return answer

    def apply(self, system: Any, *, dry_run: bool = False, start: bool = True) -> Answer:
        """Makes the system of a file (or of a dict of its form), all or nothing; what is there already is only changed.

        Shows what it does as lines ``+ create …``, ``~ configure …``; with ``dry_run`` nothing is done.
        """
        __tracebackhide__ = True
        self._call("GcmService/List", brief=True)
        steps = _system_file.steps(_system_file.load(system), self._graph, start)
        request = _proto.message("ApplyRequest")(steps=steps, validate_only=dry_run)
        if not steps:
            return Answer("Apply", _proto.message("ApplyResponse")(revision=self.revision), dry_run)
        answer = self._wire.call("GcmService/Apply", request, 60.0)
        self._seen(0 if dry_run else answer.revision)
        return Answer("Apply", answer, dry_run)

    def _seen(self, revision: int) -> None:
        """Waits a moment until this session's own copy of the graph shows what was just done."""
        self._graph.wait(lambda: self._graph.revision >= revision or not self._graph.connected, 0.5)

    def _each(self, verb: str, paths: tuple[Any, ...], dry_run: bool) -> Answer:
        __tracebackhide__ = True
        if not paths:
            raise invalid(f'{verb}: name components, e.g. "host/robot" or "host/**"', field="paths")
        names = [p if isinstance(p, str) else path_of(p, (2,)) for p in paths]
        return self._change(verb, {"paths": names}, None, None, dry_run)

    def _change(self, verb: str, fields: dict[str, Any], config: Any, execution: Any, dry_run: bool) -> Answer:
        __tracebackhide__ = True
        request = _proto.message(f"{verb}Request")(**fields, validate_only=dry_run)
        if config is not None:
            request.config.CopyFrom(_values.to_wire_struct(config, "config"))
        if execution is not None:
            request.execution.CopyFrom(_system_file.execution(execution, "execution"))
        answer = self._wire.call(f"GcmService/{verb}", request, _PATIENCE)
        self._seen(0 if dry_run else answer.revision)
        return Answer(verb, answer, dry_run)

    # Looking.

    def describe(self, path: Any = "", *, class_: str = "") -> Description:
        """What a process, component, port, command or class offers, with types, units, ranges and documentation."""
        __tracebackhide__ = True
        fields: dict[str, Any] = {"class": class_} if class_ else {"path": path_of(path)}
        return Description(self._call("GcmService/Describe", **fields), str(path) or class_)

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

    # Data.

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
        out.units, out.path = _values.units_of(ports.state), path
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
            out.units = _values.units_of(ty)
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

        ``pre_trigger`` keeps so many seconds from before the beginning, s.
        """
        __tracebackhide__ = True
        from ._record import Recording

        return Recording(self, name, patterns, pre_trigger, **settings)

    def sleep(self, seconds: float) -> None:
        """Waits; ends early when the session is closed."""
        self._closing.wait(seconds)

    # Its own life.

    def close(self) -> None:
        """Leaves the graph and ends all that is followed. Nothing that runs in the system is stopped."""
        if self._closing.is_set():
            return
        for recording in list(self._recordings):
            try:
                recording.stop()
            except TrocarError as e:
                self._say(f"the recording {recording.file} could not be ended: {e}")
        self._closing.set()
        for plot in list(self._plots):
            plot.stop()
        for follower in list(self._followers):
            follower.close()
        self._place.leave()
        self._graph.close()
        self._wire.close()
        _sessions.discard(self)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        names = self._processes()
        found = _nodes.pick(names, name)
        if found is None:
            verbs = [v for v in dir(type(self)) if not v.startswith("_")]
            raise AttributeError(f"there is no process {name!r}; there are {', '.join(names) or 'none'}{nearest(name, [*names, *verbs])}")
        return _nodes.ProcessNode(self, found)

    def __getitem__(self, path: str) -> Any:
        """The part of the system a path names: ``ire["host.robot/robot/arm"]``."""
        names = path_of(path).split("/")
        if names[0] not in self._processes():
            raise KeyError(f"there is no process {names[0]!r}; there are {', '.join(self._processes()) or 'none'}")
        node: Any = _nodes.ProcessNode(self, names[0])
        for name in names[1:]:
            node = node[name]
        return node

    def _processes(self) -> list[str]:
        return sorted(self._graph.processes)

    def _ipython_key_completions_(self) -> list[str]:
        return [*self._processes(), *sorted(self._graph.components)]

    def __dir__(self) -> list[str]:
        own = [n for n in (*dir(type(self)), "deadline") if not n.startswith("_")]
        return [*own, *(_nodes.spelled(p) for p in self._processes())]

    def __repr__(self) -> str:
        if self.closed:
            return f"<trocar session with {self.address}, closed>"
        seen = f" as {self.component}" if self.component else ""
        lost = "" if self.connected else ", which is gone"
        g = self._graph
        return (
            f"<trocar session with {self.address}{lost}{seen}: {len(g.processes)} processes, {len(g.components)} components, "
            f"{len(g.connections)} connections, revision {g.revision}>"
        )

    def _repr_html_(self) -> str:
        return self.tree._repr_html_()


@atexit.register
def _close_all() -> None:
    for session in list(_sessions):
        session.close()
