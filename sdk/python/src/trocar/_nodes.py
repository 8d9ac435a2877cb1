"""The graph by attribute: ``ire.robot.eyerobot.arm.measured_js()``, completed from what is there now.

Invariant: a node is only its path; what it has is looked up when it is asked for, so nothing here can be out of date.
"""

from __future__ import annotations

from typing import Any

from . import _proto
from ._paths import nearest
from ._proxy import Command, Event, Interface


def spelled(name: str) -> str:
    """A name as an attribute: ``host.robot`` and ``force-sensor`` with underscores; ``node["host.robot"]`` takes it as it is."""
    return name.replace("-", "_").replace(".", "_")


def pick(names: list[str], name: str) -> str | None:
    """The one name that is meant by an attribute."""
    if name in names:
        return name
    fits = [n for n in names if spelled(n) == name]
    return fits[0] if len(fits) == 1 else None


class Node:
    """A process or component; its parts are attributes."""

    def __init__(self, session: Any, path: str) -> None:
        self.__dict__.update(_session=session, _path=path)

    def _names(self) -> list[str]:
        raise NotImplementedError

    def _child(self, name: str) -> Any:
        raise NotImplementedError

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        names = self._names()
        found = pick(names, name)
        if found is None:
            raise AttributeError(f"{self._path} has no {name!r}; it has {', '.join(names) or 'nothing'}{nearest(name, names)}")
        return self._child(found)

    def __getitem__(self, name: str) -> Any:
        if name not in self._all():
            raise KeyError(f"{self._path} has no {name!r}; it has {', '.join(self._names()) or 'nothing'}")
        return self._child(name)

    def _all(self) -> list[str]:
        """Also what is reached by its name alone."""
        return self._names()

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{self._path}: settings are changed by configure, values by commands")

    def __dir__(self) -> list[str]:
        return [spelled(n) for n in self._names()]

    def _ipython_key_completions_(self) -> list[str]:
        return self._names()

    def __str__(self) -> str:
        return self._path

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Node) and other._path == self._path and other._session is self._session

    def __hash__(self) -> int:
        return hash(self._path)


class ProcessNode(Node):
    """A process: ``ire.robot``."""

    def _names(self) -> list[str]:
        start = self._path + "/"
        return [p[len(start) :] for p in sorted(self._session._graph.components) if p.startswith(start)]

    def _child(self, name: str) -> Any:
        return ComponentNode(self._session, f"{self._path}/{name}")

    def __repr__(self) -> str:
        process = self._session._graph.processes.get(self._path)
        state = _proto.PROCESS_STATES.get(process.state, "?") if process is not None else "gone"
        return f"<process {self._path}, {state}: {', '.join(self._names()) or 'no components'}>"


class ComponentNode(Node):
    """A component: ``ire.robot.eyerobot``; its ports are attributes."""

    def _ports(self) -> Any:
        return self._session._graph.describe(self._path).ports

    def _names(self) -> list[str]:
        p = self._ports()
        # What every component has beside its own is reached by name, and not shown with it.
        outputs = [o for o in p.outputs if not getattr(o, "tap", False)]
        return [x.name for group in (p.provided, outputs, p.inputs, p.required) for x in group]

    def _all(self) -> list[str]:
        return [*self._names(), *(o.name for o in self._ports().outputs)]

    def _child(self, name: str) -> Any:
        p, path = self._ports(), f"{self._path}/{name}"
        for provided in p.provided:
            if provided.name == name:
                return Interface(self._session, path, provided)
        for output in p.outputs:
            if output.name == name:
                return OutputNode(self._session, path, output)
        for what, ports in (("input", p.inputs), ("required interface", p.required)):
            for port in ports:
                if port.name == name:
                    return PortNode(self._session, path, what, port.doc)
        raise AttributeError(f"{self._path} has no {name!r} any more")

    def __repr__(self) -> str:
        return repr(self._session.describe(self._path))


class PortNode(Node):
    """An input or required interface: an end for ``connect``."""

    def __init__(self, session: Any, path: str, what: str, doc: str) -> None:
        super().__init__(session, path)
        self.__dict__.update(_what=what, __doc__=doc)

    def _names(self) -> list[str]:
        return []

    def __repr__(self) -> str:
        return f"<{self._what} {self._path}>"


class OutputNode(PortNode):
    """An output: ``latest()`` is its newest sample or frame, ``follow`` gets all of them."""

    def __init__(self, session: Any, path: str, about: Any) -> None:
        super().__init__(session, path, "output", about.doc)

    def latest(self) -> Any:
        """Its newest sample, or frame as a numpy array."""
        return self._session.latest(self._path)

    def follow(self, handler: Any = None, **settings: Any) -> Any:
        """Follows it; see ``Session.follow``."""
        return self._session.follow(self._path, handler, **settings)

    def plot(self, *args: Any, **settings: Any) -> Any:
        """Plots it; see ``Session.plot``."""
        return self._session.plot(self._path, *args, **settings)

    def __dir__(self) -> list[str]:
        return ["follow", "latest", "plot"]


__all__ = [
    "Command",
    "ComponentNode",
    "Event",
    "Interface",
    "Node",
    "OutputNode",
    "PortNode",
    "ProcessNode",
    "pick",
    "spelled",
]
