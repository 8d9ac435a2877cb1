"""``connect()`` and the session it gives: everything a system offers, from a Python prompt or a script.

Invariant: a session never stalls a component: every call has a deadline, every queue is bounded and counts what it drops.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
import weakref
from collections.abc import Callable
from typing import Any

import grpc

from . import _ipython, _nodes, _proto
from ._changing import _PATIENCE, Changing, named
from ._errors import TrocarError, invalid
from ._graph import Graph
from ._looking import Looking
from ._paths import nearest, path_of
from ._place import Place
from ._proxy import Command, Interface
from ._show import Answer, Tree
from ._wire import Wire
from ._words import counted

DEFAULT_ADDRESS = "127.0.0.1:50551"
_sessions: weakref.WeakSet[Session] = weakref.WeakSet()


def connect(
    address: str | None = None,
    *,
    name: str = "ire",
    identity: str | os.PathLike[str] | None = None,
    credentials: grpc.ChannelCredentials | None = None,
    deadline: float = 1.0,
    timeout: float = 5.0,
    place: bool = True,
    say: Callable[[str], None] | None = None,
    options: list[tuple[str, Any]] | None = None,
) -> Session:
    """Connects to a GCM, or to a host with one of its own.

    ``address`` is ``host:port``, or those of several GCMs with commas between them, of which the one that leads is looked for, now
    and whenever another does; left out, it is ``TROCAR_GCM`` of the environment or 127.0.0.1:50551. ``name`` is that of the process
    under which the graph shows this session (the first free of ire, ire2, …); ``place=False`` stays unseen. For a GCM of another
    machine, ``https://host:port``, ``identity`` is the file that `trocar ca issue` made (``TROCAR_IDENTITY`` otherwise);
    ``credentials`` are grpc's channel credentials, for any other TLS. ``deadline`` is how long calls wait unless they say otherwise, s;
    ``timeout`` how long connecting may take, s. ``say`` hears of the GCM lost and found (stderr otherwise). ``options`` go to grpc's
    channel.
    """
    __tracebackhide__ = True
    where = _where(address)
    if not 0 < deadline <= 60:
        raise invalid(f"deadline is {deadline!r}; give seconds, above 0 and at most 60", field="deadline")
    session = Session(Wire(where, credentials, options, identity), name, deadline, say)
    try:
        session._wire.look(timeout)
        session._graph.open(timeout)
        if place:
            session._place.join(timeout)
            # The tree that is looked at next shows this process too.
            session._graph.wait(lambda: not session.process or session.process in session._graph.processes, 1.0)
            if session._place.refused is not None:
                why = "this GCM knows no guests" if session._place.refused.code == "UNIMPLEMENTED" else "you may not join this system"
                session._say(f"{why}: the session works, but the graph does not show it")
    except BaseException:
        session.close()
        raise
    _ipython.install()
    return session


def stop(*paths: Any, address: str | None = None, dry_run: bool = False) -> Answer:
    """Stops components without a session: ``trocar.stop("host/**")``. ``address`` is as in ``connect``.

    At a host of this user it goes by a socket that is for Stop alone, also while the port has no connection left for a session.
    """
    __tracebackhide__ = True
    request = _proto.message("StopRequest")(paths=named("Stop", paths), validate_only=dry_run)
    wire = Wire(_where(address))
    try:
        return Answer("Stop", wire.stop(request, _PATIENCE), dry_run)
    finally:
        wire.close()


def _where(address: str | None) -> str:
    __tracebackhide__ = True
    where = address or os.environ.get("TROCAR_GCM") or DEFAULT_ADDRESS
    if not isinstance(where, str):
        raise invalid(f'address is {where!r}; write "HOST:PORT"', field="address")
    return ",".join(one.strip().removeprefix("http://") for one in where.split(","))


class Session(Changing, Looking):
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
            f"<trocar session with {self.address}{lost}{seen}: {counted(len(g.processes), 'process')}, "
            f"{counted(len(g.components), 'component')}, {counted(len(g.connections), 'connection')}, revision {g.revision}>"
        )

    def _repr_html_(self) -> str:
        return self.tree._repr_html_()


@atexit.register
def _close_all() -> None:
    for session in list(_sessions):
        session.close()
