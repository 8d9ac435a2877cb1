"""System files from Python: the file of docs/ and ``trocar schema system`` as the steps of one Apply.

Invariant: what the file says beyond this format is refused with its place; nothing in it is ignored silently.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from . import _proto, _values
from ._errors import TrocarError, invalid
from ._paths import nearest, path_of

_SYSTEM = ("$schema", "version", "processes", "components", "connections", "scenarios")
_COMPONENT = ("class", "config", "execution", "start", "isolation", "resume")
_EXECUTION = (
    "model", "rate_hz", "period_us", "phase_us", "stream_of", "inside", "priority", "cpus", "catch_up", "threads",
    "max_step_ms", "history", "on_failure", "wake",
)  # fmt: skip
_CONNECTION = ("client", "server", "queue", "max_age_ms", "deadline_ms", "mailbox", "adapt", "delay", "carrier")
_LARGEST = 16 << 20


def _wrong(where: str, why: str) -> TrocarError:
    return invalid(f"{where}: {why}", "SYSTEM_FILE_INVALID", field=where)


def load(system: Any) -> tuple[str, Mapping[str, Any]]:
    """A file's name and content; duplicates of a key are refused, since one of them would be hidden."""
    if isinstance(system, Mapping):
        return "the system", system
    if not isinstance(system, (str, os.PathLike)):
        raise invalid(f"apply takes a file or a dict; {type(system).__name__} is neither")
    name = os.fspath(system)
    try:
        with open(name, "rb") as f:
            raw = f.read(_LARGEST + 1)
    except OSError as e:
        raise invalid(f"{name} cannot be read: {e.strerror}", "SYSTEM_FILE_INVALID", file=name) from None
    if len(raw) > _LARGEST:
        raise invalid(f"{name}: a system file has at most {_LARGEST >> 20} MiB", "SYSTEM_FILE_INVALID", file=name)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for key, value in pairs:
            if key in out and key != "//":
                raise invalid(f"{name}: the key {key!r} is twice in one object", "SYSTEM_FILE_INVALID", file=name)
            out[key] = value
        return out

    try:
        content = json.loads(raw.decode("utf-8"), object_pairs_hook=once)
    except UnicodeDecodeError as e:
        raise invalid(f"{name}: not UTF-8 text: byte {e.start} is not valid", "SYSTEM_FILE_INVALID", file=name) from None
    except json.JSONDecodeError as e:
        raise invalid(f"{name}:{e.lineno}:{e.colno}: {e.msg}", "SYSTEM_FILE_INVALID", file=name) from None
    except RecursionError:
        raise invalid(f"{name}: it is nested too deeply", "SYSTEM_FILE_INVALID", file=name) from None
    if not isinstance(content, dict):
        raise _wrong(name, 'a system file is an object: {"version": 1, …}')
    return name, content


def _fields(value: Any, known: tuple[str, ...], where: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise _wrong(where, f"an object is wanted, {type(value).__name__} is there")
    out = {k: v for k, v in value.items() if k != "//"}
    for key in out:
        if key not in known:
            raise _wrong(where, f"there is no key {key!r}; known are {', '.join(known)}{nearest(str(key), known)}")
    return out


def _uncommented(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _uncommented(v) for k, v in value.items() if k != "//"}
    return [_uncommented(v) for v in value] if isinstance(value, (list, tuple)) else value


def execution(value: Any, where: str) -> Any:
    """The part ``execution`` of a component."""
    f = _fields(value, _EXECUTION, where)
    for one, other in (("rate_hz", "period_us"), ("stream_of", "inside")):
        if one in f and other in f:
            raise _wrong(where, f"give {one} or {other}, not both")
    out = _proto.message("Execution")()

    def number(key: str) -> float:
        v = f[key]
        if isinstance(v, bool) or not isinstance(v, (int, float)) or not 0 <= v < 1e15:
            raise _wrong(f"{where}/{key}", f"{v!r} is not a number from 0 up")
        return float(v)

    for key in ("model", "stream_of", "inside", "on_failure", "wake"):
        if key in f:
            if not isinstance(f[key], str):
                raise _wrong(f"{where}/{key}", f"a text is wanted, {f[key]!r} is there")
            setattr(out, key, f[key])
    if "rate_hz" in f:
        out.rate_hz = number("rate_hz")
    for key, target, scale in (
        ("period_us", "period", 1e-6),
        ("phase_us", "phase", 1e-6),
        ("max_step_ms", "max_step", 1e-3),
    ):
        if key in f:
            getattr(out, target).CopyFrom(_proto.duration(number(key) * scale))
    for key in ("priority", "catch_up", "threads", "history"):
        if key in f:
            n = number(key)
            if n != int(n) or n >= 2**32:
                raise _wrong(f"{where}/{key}", f"{f[key]!r} is not a whole number")
            setattr(out, key, int(n))
    cpus = f.get("cpus", [])
    if not isinstance(cpus, (list, tuple)) or not all(type(c) is int and 0 <= c < 4096 for c in cpus):
        raise _wrong(f"{where}/cpus", f"a list of processor numbers is wanted, {cpus!r} is there")
    out.cpus.extend(cpus)
    return out


def connect_options(value: Mapping[str, Any], where: str) -> Any:
    """The options of a connection."""
    known = (*_CONNECTION[2:], "replace")
    f = _fields(value, known, where)
    out = _proto.message("ConnectOptions")()
    for key in ("adapt", "delay", "replace"):
        if key in f:
            if not isinstance(f[key], bool):
                raise _wrong(f"{where}/{key}", f"true or false is wanted, {f[key]!r} is there")
            setattr(out, key, f[key])
    for key, target in (("max_age_ms", "max_age"), ("deadline_ms", "deadline")):
        if key in f:
            v = f[key]
            if isinstance(v, bool) or not isinstance(v, (int, float)) or not 0 < v < 1e12:
                raise _wrong(f"{where}/{key}", f"{v!r} is not a time above 0, ms")
            getattr(out, target).CopyFrom(_proto.duration(v / 1e3))
    if "mailbox" in f:
        if type(f["mailbox"]) is not int or not 1 <= f["mailbox"] <= 65536:
            raise _wrong(f"{where}/mailbox", f"{f['mailbox']!r} is not a depth from 1 to 65536")
        out.mailbox = f["mailbox"]
    if "carrier" in f:
        if not isinstance(f["carrier"], str):
            raise _wrong(f"{where}/carrier", f"a text is wanted, {f['carrier']!r} is there")
        out.carrier = f["carrier"]
    if "queue" in f and f["queue"] == "latest":
        out.queue.fifo = 0
    elif "queue" in f:
        q = _fields(f["queue"], ("fifo", "drop_oldest"), f"{where}/queue")
        if type(q.get("fifo")) is not int or not 1 <= q["fifo"] <= 65536:
            raise _wrong(f"{where}/queue/fifo", "a depth from 1 to 65536 samples is wanted")
        out.queue.fifo, out.queue.drop_oldest = q["fifo"], bool(q.get("drop_oldest", False))
    return out


def steps(loaded: tuple[str, Mapping[str, Any]], graph: Any, start: bool) -> list[Any]:
    """The steps that make the system of a file out of the one that is there."""
    name, content = loaded
    top = _fields(content, _SYSTEM, name)
    if top.get("version") != 1:
        raise _wrong(f"{name}/version", f"it is {top.get('version')!r}, this reads version 1")
    if _uncommented(top.get("scenarios", {})):
        raise _wrong(f"{name}/scenarios", "scenarios are not part of this version; leave them empty")
    components = top.get("components", {})
    if not isinstance(components, Mapping):
        raise _wrong(f"{name}/components", "an object of components by path is wanted")
    listed = top.get("processes")
    lives: dict[str, str] = {}
    parsed: dict[str, dict[str, Any]] = {}
    for path, value in components.items():
        if path == "//":
            continue
        where = f"{name}/components/{path}"
        names = path_of(path, (2,)).split("/")
        if isinstance(listed, Mapping) and names[0] not in listed:
            raise _wrong(where, f'process {names[0]!r} is not in "processes"{nearest(names[0], listed)}')
        f = _fields(value, _COMPONENT, where)
        if not isinstance(f.get("class"), str):
            raise _wrong(where, '"class" is missing: the name of its class')
        if f.get("isolation", "none") not in ("none", "process"):
            raise _wrong(f"{where}/isolation", f'{f["isolation"]!r} is neither "none" nor "process"')
        parsed[path] = f
        lives[path] = f"{names[0]}.{names[1]}/{names[1]}" if f.get("isolation") == "process" else path
        if names[0] not in graph.processes:
            known = sorted(graph.processes)
            raise TrocarError(
                "NOT_FOUND",
                "PROCESS_NOT_FOUND",
                f"{where}: process {names[0]!r} does not run; there are {', '.join(known) or 'none'}{nearest(names[0], known)}. "
                "apply changes what runs; `trocar up` starts processes",
                {"process": names[0], "known": ", ".join(known)},
            )
    out = [s for path in _in_thread_order(parsed) for s in _component(name, path, lives[path], parsed[path], graph)]
    out += _connections(name, top.get("connections", []), lives, graph)
    if start:
        Step, Start = _proto.message("Step"), _proto.message("StartRequest")
        wanted = []
        for path, f in parsed.items():
            if not isinstance(f.get("start", True), bool):
                raise _wrong(f"{name}/components/{path}/start", f"true or false is wanted, {f['start']!r} is there")
            now = graph.components.get(lives[path])
            if f.get("start", True) and (now is None or _proto.STATES[now.state] in ("CREATED", "READY")):
                wanted.append(lives[path])
        if wanted:
            out.append(Step(start=Start(paths=wanted)))
    return out


def _in_thread_order(components: dict[str, dict[str, Any]]) -> list[str]:
    """The file's order, but whoever runs in another's thread after that one."""
    left, done = list(components), []
    while left:

        def waits(path: str) -> bool:
            e = components[path].get("execution") or {}
            owners = [e.get("stream_of"), e.get("inside")] if isinstance(e, Mapping) else []
            return any(o in left and o != path for o in owners)  # noqa: B023

        now = [p for p in left if not waits(p)] or list(left)
        done += now
        left = [p for p in left if p not in now]
    return done


def _component(name: str, path: str, lives: str, f: dict[str, Any], graph: Any) -> list[Any]:
    where = f"{name}/components/{path}"
    Step = _proto.message("Step")
    config = _uncommented(f["config"]) if "config" in f else None
    wanted = execution(f["execution"], f"{where}/execution") if "execution" in f else None
    now = graph.components.get(lives)
    if now is None:
        create = _proto.message("CreateRequest")(**{"class": f["class"]}, path=path, isolation=_isolation(f))
        if config is not None:
            create.config.CopyFrom(_values.to_wire_struct(config, f"{where}/config"))
        if wanted is not None:
            create.execution.CopyFrom(wanted)
        return [Step(create=create)]
    if f["class"] not in (now.__getattribute__("class"), now.__getattribute__("class").rpartition("/")[2]):
        raise TrocarError(
            "ALREADY_EXISTS",
            "COMPONENT_EXISTS",
            f"{where}: {lives} is there and of class {now.__getattribute__('class')}, not {f['class']}; remove it first",
            {"component": lives},
        )
    configure = _proto.message("ConfigureRequest")(path=lives)
    present = _values.plain_struct(now.config)
    new = {k: v for k, v in (config or {}).items() if not _same(present.get(k), v)}
    if new:
        configure.config.CopyFrom(_values.to_wire_struct(new, f"{where}/config"))
    if wanted is not None and not _has(now.execution, wanted):
        configure.execution.CopyFrom(wanted)
    return [Step(configure=configure)] if new or configure.HasField("execution") else []


def _isolation(f: dict[str, Any]) -> str:
    return "process" if f.get("isolation") == "process" else ""


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return all(_same(a.get(k), v) for k, v in b.items())
    return a == b and isinstance(a, bool) == isinstance(b, bool)


def _has(now: Any, wanted: Any) -> bool:
    """Whether every setting that is wanted is so already; a rate and its period are the same."""
    for field, value in wanted.ListFields():
        if field.name in ("rate_hz", "period"):
            a, b = _period(now), _period(wanted)
            if a is None or b is None or abs(a - b) > 1e-9:
                return False
        elif getattr(now, field.name) != value:
            return False
    return True


def _period(e: Any) -> float | None:
    if e.HasField("period"):
        return e.period.seconds + e.period.nanos * 1e-9
    return 1 / e.rate_hz if e.HasField("rate_hz") and e.rate_hz > 0 else None


def _connections(name: str, value: Any, lives: dict[str, str], graph: Any) -> list[Any]:
    if not isinstance(value, (list, tuple)):
        raise _wrong(f"{name}/connections", "a list of connections is wanted")
    Step, Connect = _proto.message("Step"), _proto.message("ConnectRequest")
    there = {(c.client, c.server) for c in graph.connections.values()}
    out, seen = [], set()
    for i, item in enumerate(value):
        where = f"{name}/connections/{i}"
        f = _fields(item, _CONNECTION, where)
        ends = []
        for key in ("client", "server"):
            if key not in f:
                raise _wrong(where, f'"{key}" is missing')
            port = path_of(f[key], (3,))
            owner = port.rpartition("/")[0]
            if owner not in lives:
                raise _wrong(f"{where}/{key}", f"component {owner} is not in this file{nearest(owner, lives)}")
            ends.append(f"{lives[owner]}/{port.rpartition('/')[2]}")
        pair = (ends[0], ends[1])
        if pair in seen:
            raise _wrong(where, f"{pair[0]} → {pair[1]} is listed twice")
        seen.add(pair)
        if pair in there:
            continue
        options = {k: v for k, v in f.items() if k not in ("client", "server")}
        connect = Connect(client=pair[0], server=pair[1])
        if options:
            connect.options.CopyFrom(connect_options(options, where))
        out.append(Step(connect=connect))
    return out


def state_text(component: Any) -> str:
    """State of a component in one word, with the reason where it is STOPPED."""
    word = _proto.STATES.get(component.state, "?")
    reason = _proto.STOP_REASONS.get(component.stop_reason, "")
    return f"{word}{{{reason.lower()}}}" if word == "STOPPED" and reason not in ("", "UNSPECIFIED") else word
