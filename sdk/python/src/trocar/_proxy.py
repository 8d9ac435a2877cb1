"""Dynamic proxies: a provided interface as a Python object, its commands as functions with signature and documentation.

Invariant: nothing is known of a class beforehand; all comes from the interface's own description, also names, units and ranges.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

from . import _proto, _values
from ._errors import invalid
from ._follow import DEPTH, Follower
from ._paths import nearest

_Invoke = _proto.message("InvokeRequest")
MARGIN = 1.0
"""Seconds the GCM has beyond a call's own deadline to answer that it passed."""


class TypeName(str):
    """The name of a type, shown in signatures without quotes: ``value: i32``."""

    def __repr__(self) -> str:
        return str(self)


class Sent:
    """A command that was sent and not waited for. ``executed`` is true where it ran at once."""

    def __init__(self, path: str, executed: bool) -> None:
        self.path, self.executed = path, executed

    def __repr__(self) -> str:
        return f"<{self.path}: {'executed' if self.executed else 'queued'}>"


class Command:
    # One command. Call it; ``deadline`` is how long to wait, s (the session's by default). ``.send(…)`` returns as soon as it is queued,
    # ``.aio(…)`` is awaited. A struct is given as one dict, record or numpy row, or field by field: ``servo_jp(position=[…])``.
    # No docstring of the class: ``r.Write?`` would show it below that of the command.
    __doc__: Any = None

    def __init__(self, session: Any, path: str, description: Any) -> None:
        self._session = session
        self._path = path
        self._about = description
        self.__name__ = self.__qualname__ = description.name
        self.__doc__ = _documentation(description)
        self._argument = description.arg if description.HasField("arg") else None
        self._type = description.ret if description.HasField("ret") else None
        self._fields = _fields(self._argument.type) if self._argument is not None else {}
        self.__signature__ = _signature(description)
        self.__dict__["__call__"] = _shown_call(self.__signature__)

    kind = property(lambda self: _proto.KINDS[self._about.kind].lower(), doc="What kind of command it is: write, read, …")
    unit = property(lambda self: self._about.ret_unit, doc="Unit of the result; empty = none or inside it.")

    @property
    def min(self) -> float | None:
        """Smallest argument accepted, in its unit."""
        a = self._argument
        return a.min if a is not None and a.HasField("min") else None

    @property
    def max(self) -> float | None:
        """Largest argument accepted, in its unit."""
        a = self._argument
        return a.max if a is not None and a.HasField("max") else None

    def _request(self, args: tuple[Any, ...], fields: dict[str, Any], deadline: float | None, send: bool) -> Any:
        seconds = self._session.deadline if deadline is None else deadline
        if not isinstance(seconds, (int, float)) or not 0 < seconds <= 60:
            raise invalid(f"deadline is {seconds!r}; give seconds, above 0 and at most 60", field="deadline")
        request = _Invoke(path=self._path, send=send)
        request.deadline.CopyFrom(_proto.duration(seconds))
        if self._argument is None:
            if args or fields:
                raise TypeError(f"{self._shown()} takes no argument")
            return request, seconds
        name = self._argument.name or "value"
        if args and not fields and len(args) == 1:
            value = args[0]
        elif not args and name in fields and len(fields) == 1 and name not in self._fields:
            value = fields[name]
        elif fields and self._fields:
            if args and not (len(args) == 1 and isinstance(args[0], Mapping)):
                raise TypeError(f"{self._shown()}: give one value, or its fields by name")
            unknown = [k for k in fields if k not in self._fields]
            if unknown:
                known = ", ".join(self._fields)
                raise TypeError(f"{self._shown()} has no field {unknown[0]!r}; it has {known}{nearest(unknown[0], self._fields)}")
            value = {**self._fields_left_out(fields), **(dict(args[0]) if args else {}), **fields}
        elif fields and not args:
            raise TypeError(f"{self._shown()} has no argument {next(iter(fields))!r}; its only one is {name!r}")
        else:
            raise TypeError(f"{self._shown()} takes one argument; {len(args) + len(fields)} were given")
        if isinstance(value, _values.Record):
            value = dict(value)
        _values._put(request.json, value, f"{self._path}: {name}", 0)
        return request, seconds

    def _fields_left_out(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """A stamp of 0 means now, and what is reserved is 0: nobody should have to write them."""
        out: dict[str, Any] = {}
        for name, ty in self._fields.items():
            if name in given:
                continue
            shape = _values.shape_of(ty)
            if shape == "primitive" and _proto.PRIMITIVES[ty.primitive] == "stamp":
                out[name] = 0
            elif shape == "list":
                out[name] = []
        return out

    def _shown(self) -> str:
        return f"{self._path}{self.__signature__}"

    def _answer(self, response: Any) -> Any:
        if self._type is None:
            return None
        if response.encoded or self._type.size == 0:
            return _values.to_value(self._type, response.encoded, response.unit)
        return _values.from_json(self._type, _values.plain(response.json), response.unit)

    def __call__(self, *args: Any, deadline: float | None = None, **fields: Any) -> Any:
        """Calls it and waits for the result."""
        __tracebackhide__ = True
        request, seconds = self._request(args, fields, deadline, False)
        return self._answer(self._session._wire.call("InteractService/Invoke", request, seconds + MARGIN))

    def send(self, *args: Any, **fields: Any) -> Sent:
        """Returns as soon as it is queued; what becomes of it is counted at the component."""
        __tracebackhide__ = True
        request, seconds = self._request(args, fields, None, True)
        response = self._session._wire.call("InteractService/Invoke", request, seconds + MARGIN)
        return Sent(self._path, response.executed)

    def aio(self, *args: Any, deadline: float | None = None, **fields: Any) -> Coroutine[Any, Any, Any]:
        """The call as a coroutine: ``await r.Read.aio()``, on asyncio's loop. Ready to be awaited, gathered and cancelled."""
        request, seconds = self._request(args, fields, deadline, False)
        return self._await(request, seconds)

    async def _await(self, request: Any, seconds: float) -> Any:
        return self._answer(await self._session._wire.acall("InteractService/Invoke", request, seconds + MARGIN))

    def __str__(self) -> str:
        return self._path

    def __repr__(self) -> str:
        return f"<{self._shown()}>"

    def __dir__(self) -> list[str]:
        return ["aio", "send", "kind", "unit", "min", "max"]


def _shown_call(signature: inspect.Signature) -> Callable[..., Any]:
    """What tools take for ``__call__`` of a command when they explain it; calling goes to the class's own."""

    def call(*_: Any, **__: Any) -> None: ...

    call.__signature__ = signature  # type: ignore[attr-defined]
    return call


class Event:
    """One event. Decorate a function with it, or call it with one; it then runs in a thread of its own for each event.

    The function takes the value, or the value and the item (its stamp, number, and ``skipped``), or nothing. At most ``depth``
    events wait for it (1024); when more come the oldest go, counted. What is handed back counts them: ``Follower``.
    """

    def __init__(self, session: Any, path: str, description: Any) -> None:
        self._session, self._path, self._about = session, path, description
        self.__name__ = self.__qualname__ = description.name
        payload = description.payload if description.HasField("payload") else None
        self._type, self._unit = payload, description.unit
        unit = f" ({description.unit})" if description.unit else ""
        carries = f"Its value: {payload.name}{unit}." if payload is not None else "It carries no value."
        self.__doc__ = f"{_sentence(description.doc)} {carries}\n\nDecorate a function that takes it: @r.on.{description.name}"

    def __call__(self, handler: Callable[..., Any] | None = None, *, depth: int = DEPTH) -> Any:
        """Follows the event with a function; without one, hands back a decorator with these settings."""
        __tracebackhide__ = True
        if handler is None:
            return lambda function: self(function, depth=depth)
        return self._session._followed(Follower(self._session, self._path, (self._type, self._unit), handler, depth))

    def follow(self, depth: int = DEPTH) -> Follower:
        """Follows it without a handler: ``next(timeout)`` and iteration give the items."""
        return self._session._followed(Follower(self._session, self._path, (self._type, self._unit), None, depth))

    def wait(self, deadline: float = 5.0, call: Any = None) -> Any:
        """Waits for it, ``deadline`` seconds at most, and answers its value; ``call`` is called once it is listened for."""
        return self._session.wait_for(self._path, deadline=deadline, call=call)

    def __str__(self) -> str:
        return self._path

    def __repr__(self) -> str:
        value = f"({self._type.name}{' ' + self._unit if self._unit else ''})" if self._type is not None else "()"
        return f"<event {self._path}{value}>"

    def __dir__(self) -> list[str]:
        return ["follow", "wait"]


class Events:
    """The events of an interface, by name."""

    _owner: str
    _events: dict[str, Event]

    def __init__(self, owner: str, events: dict[str, Event]) -> None:
        self.__dict__.update(_owner=owner, _events=events)

    def __getattr__(self, name: str) -> Event:
        if name in self._events:
            return self._events[name]
        raise AttributeError(_no_such(self._owner, "event", name, self._events))

    __getitem__ = __getattr__

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"events of {self._owner} cannot be set")

    def __dir__(self) -> list[str]:
        return list(self._events)

    def __repr__(self) -> str:
        return f"<events of {self._owner}: {', '.join(self._events) or 'none'}>"


class Interface:
    """A provided interface: its commands as methods, its events under ``on``. ``r["name"]`` reaches a name that Python cannot spell.

    Made by ``AddInterfaceRequiredAndConnect`` it stands in the graph as a connection of this process.
    """

    on: Events
    _session: Any
    _path: str
    _client: str
    _connection: int
    _commands: dict[str, Command]

    def __init__(self, session: Any, path: str, provided: Any, client: str = "", connection: int = 0) -> None:
        self.__dict__.update(_session=session, _path=path, _client=client, _connection=connection)
        self._adopt(provided)

    def _adopt(self, provided: Any) -> None:
        """Takes the commands and events as they are now; what somebody holds of the former ones goes on."""
        session, path = self._session, self._path
        self.__dict__.update(
            _doc=provided.doc,
            _commands={c.name: Command(session, f"{path}/{c.name}", c) for c in provided.commands},
            on=Events(path, {e.name: Event(session, f"{path}/{e.name}", e) for e in provided.events}),
        )
        self.__dict__["__doc__"] = f"{_sentence(provided.doc)} ({path})"

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("__") and name in self._commands:
            return self._commands[name]
        raise AttributeError(_no_such(self._path, "command", name, self._commands))

    def __getitem__(self, name: str) -> Any:
        if name in self._commands:
            return self._commands[name]
        if name in self.on._events:
            return self.on._events[name]
        raise KeyError(_no_such(self._path, "command or event", name, {**self._commands, **self.on._events}))

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{self._path}: values are set by commands, not by assignment")

    def __dir__(self) -> list[str]:
        return [*self._commands, "on"]

    def _ipython_key_completions_(self) -> list[str]:
        return [*self._commands, *self.on._events]

    def __str__(self) -> str:
        return self._path

    def __repr__(self) -> str:
        by = f", connected as {self._client}" if self._client else ""
        lines = [f"<{self._path}{by}>"]
        wide = max((len(f"{n}{c.__signature__}") for n, c in self._commands.items()), default=0)
        lines += [f"  {f'{n}{c.__signature__}':<{min(wide, 60)}}  {_first(c.__doc__)}" for n, c in self._commands.items()]
        lines += [f"  on.{n}  {_first(e.__doc__)}" for n, e in self.on._events.items()]
        return "\n".join(lines)


def _no_such(path: str, what: str, name: str, known: Mapping[str, Any]) -> str:
    return f"{path} has no {what} {name!r}; it has {', '.join(known) or 'none'}{nearest(name, known)}"


def _first(doc: str | None) -> str:
    return (doc or "").split("\n", 1)[0]


def _sentence(doc: str) -> str:
    doc = " ".join(doc.split())
    return doc if not doc or doc[-1] in ".!?" else doc + "."


def _range(argument: Any) -> str:
    low = f"{argument.min:g}" if argument.HasField("min") else ""
    high = f"{argument.max:g}" if argument.HasField("max") else ""
    if low and high:
        return f"{low}..{high}"
    return f"at least {low}" if low else f"at most {high}" if high else ""


def _documentation(c: Any) -> str:
    """``Sets the set point (mm), 0..100`` and below it what the argument, its fields and the result are."""
    doc = " ".join(c.doc.split()).rstrip(".")
    argument = c.arg if c.HasField("arg") else None
    unit = (argument.unit if argument is not None else "") or (c.ret_unit if c.HasField("ret") else "")
    head = doc + (f" ({unit})" if unit else "")
    if argument is not None and _range(argument):
        head += f", {_range(argument)}"
    lines = []
    if argument is not None:
        unit = f", {argument.unit}" if argument.unit else ""
        bounds = f", {_range(argument)}" if _range(argument) else ""
        lines.append(f"{argument.name or 'value'} ({argument.type.name}{unit}{bounds}): {_sentence(argument.doc)}".rstrip(": "))
        lines += _shape_lines(argument.type)
    if c.HasField("ret"):
        unit = f", {c.ret_unit}" if c.ret_unit else ""
        lines += [f"Returns {c.ret.name}{unit}.", *_shape_lines(c.ret)]
    lines.append(f"A {_proto.KINDS[c.kind].lower().replace('_', '-')} command.")
    return head + "\n\n" + "\n".join(lines)


def _shape_lines(ty: Any, indent: str = "    ", deep: int = 0) -> list[str]:
    """The fields of a struct, one a line, with type, unit and meaning; the words of an enumeration."""
    kind = _values.shape_of(ty)
    if deep > 3:
        return []
    if kind == "enumeration":
        return [f"{indent}one of {', '.join(v.name for v in ty.enumeration.values)}"]
    if kind in ("array", "list"):
        return _shape_lines(ty.array.item if kind == "array" else ty.list.item, indent, deep + 1)
    if kind != "structure":
        return []
    lines = []
    for f in ty.structure.fields:
        unit = f", {f.unit}" if f.unit else ""
        lines.append(f"{indent}{f.name} ({f.type.name}{unit}): {_sentence(f.doc)}".rstrip(": "))
        lines += _shape_lines(f.type, indent + "    ", deep + 1)
    return lines


def _fields(ty: Any) -> dict[str, Any]:
    return {f.name: f.type for f in ty.structure.fields} if _values.shape_of(ty) == "structure" else {}


def _signature(c: Any) -> inspect.Signature:
    parameters = []
    if c.HasField("arg"):
        name = c.arg.name if (c.arg.name or "").isidentifier() else "value"
        parameters = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=TypeName(c.arg.type.name))]
    returns = TypeName(c.ret.name) if c.HasField("ret") else None
    return inspect.Signature(parameters, return_annotation=returns)
