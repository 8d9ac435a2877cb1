"""System files from Python: the text of one, and the parts that calls take in the same words (``execution``, options of a connection).

Invariant: what a file means is the GCM's to say, so there is one meaning; a part of another form is refused here with its place.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from . import _proto
from ._errors import TrocarError, invalid
from ._paths import nearest

_EXECUTION = (
    "model", "rate_hz", "period_us", "phase_us", "stream_of", "inside", "priority", "cpus", "catch_up", "threads",
    "max_step_ms", "history", "on_failure", "wake",
)  # fmt: skip
_CONNECTION = ("client", "server", "queue", "max_age_ms", "deadline_ms", "mailbox", "adapt", "delay", "carrier")
_LARGEST = 16 << 20


def _wrong(where: str, why: str) -> TrocarError:
    return invalid(f"{where}: {why}", "SYSTEM_FILE_INVALID", field=where)


def text_of(system: Any, verb: str) -> tuple[str, str]:
    """A file's name and text; of a dict the text that says it."""
    if isinstance(system, Mapping):
        try:
            return "the system", json.dumps(system, default=_plain)
        except (TypeError, ValueError) as e:
            raise _wrong("the system", f"JSON cannot carry it: {e}") from None
    if not isinstance(system, (str, os.PathLike)):
        raise invalid(f"{verb} takes a file or a dict; {type(system).__name__} is neither")
    name = os.fspath(system)
    try:
        with open(name, "rb") as f:
            raw = f.read(_LARGEST + 1)
    except OSError as e:
        raise invalid(f"{name} cannot be read: {e.strerror}", "SYSTEM_FILE_INVALID", file=name) from None
    if len(raw) > _LARGEST:
        raise invalid(f"{name}: a system file has at most {_LARGEST >> 20} MiB", "SYSTEM_FILE_INVALID", file=name)
    try:
        return name, raw.decode("utf-8")
    except UnicodeDecodeError as e:
        raise invalid(f"{name}: not UTF-8 text: byte {e.start} is not valid", "SYSTEM_FILE_INVALID", file=name) from None


def _plain(value: Any) -> Any:
    """A number, array or row of numpy as JSON says it."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} of type {type(value).__name__}")


def placed(error: TrocarError, name: str) -> TrocarError:
    """A refusal of a text, with the name of its file: the GCM was given none."""
    if error.reason != "ARGUMENT_INVALID" or not error.sentence.startswith("system:"):
        return error
    sentence = name + error.sentence[len("system") :]
    return TrocarError(error.code, "SYSTEM_FILE_INVALID", sentence, {**error.metadata, "file": name}, error.violations, error.help)


def _fields(value: Any, known: tuple[str, ...], where: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise _wrong(where, f"an object is wanted, {type(value).__name__} is there")
    out = {k: v for k, v in value.items() if k != "//"}
    for key in out:
        if key not in known:
            raise _wrong(where, f"there is no key {key!r}; known are {', '.join(known)}{nearest(str(key), known)}")
    return out


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


def state_text(component: Any) -> str:
    """State of a component in one word, with the reason where it is STOPPED."""
    word = _proto.STATES.get(component.state, "?")
    reason = _proto.STOP_REASONS.get(component.stop_reason, "")
    return f"{word}{{{reason.lower()}}}" if word == "STOPPED" and reason not in ("", "UNSPECIFIED") else word
