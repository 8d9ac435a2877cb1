"""Paths: ``process/component/port/member``, the same text everywhere, parsed once.

Invariant: one spelling; a tuple, a text and an object of the graph that mean the same give the same path.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Any

from ._errors import TrocarError, invalid

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*\Z")


def path_of(what: Any, parts: tuple[int, ...] = (), meant: str = "a path") -> str:
    """The path of a text, a tuple of names or an object of the graph; refused unless it has one of so many ``parts``."""
    own = getattr(what, "_path", None)
    if isinstance(own, str):
        names = own.split("/")
    elif isinstance(what, str):
        names = what.split("/")
    elif isinstance(what, (tuple, list)) and what and all(isinstance(n, str) for n in what):
        names = [part for n in what for part in n.split("/")]
    else:
        raise _bad(repr(what), f"{meant} is text or a tuple of names", parts)
    text = "/".join(names)
    for name in names:
        if not _NAME.match(name):
            raise _bad(text, f"{name!r} is not a name", parts)
    if parts and len(names) not in parts:
        raise _bad(text, f"it has {len(names)} names", parts)
    return text


_SHAPES = ("process", "process/component", "process/component/port", "process/component/port/member")


def _bad(text: str, why: str, parts: tuple[int, ...]) -> TrocarError:
    wanted = " or ".join(_SHAPES[n - 1] for n in parts) if parts else "process/component/port/member"
    return invalid(f"{text} is no path here: {why}; write {wanted}", "BAD_PATH", text=text)


def nearest(name: str, known: Iterable[str]) -> str:
    """`` Did you mean …?`` or nothing."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else ""


def globbed(pattern: str) -> re.Pattern[str]:
    """``host/**`` and ``host/*/arm`` as a regular expression: ``*`` stays within one name, ``**`` goes on."""
    out = ""
    i = 0
    while i < len(pattern):
        if pattern.startswith("**", i):
            out, i = out + ".*", i + 2
        elif pattern[i] == "*":
            out, i = out + "[^/]*", i + 1
        elif pattern[i] == "?":
            out, i = out + "[^/]", i + 1
        else:
            out, i = out + re.escape(pattern[i]), i + 1
    return re.compile(out + r"\Z")
