"""Completion in IPython: names of the live system after a dot, and paths inside of quotes.

Invariant: nothing is evaluated but names, attributes and keys of trocar's own objects, so completing never calls or changes anything.
"""

from __future__ import annotations

import re
from typing import Any

_DOTTED = re.compile(r"([A-Za-z_]\w*(?:\.\w+|\[(?:\"[^\"]*\"|'[^']*')\])*)\.(\w*)\Z")
_QUOTED = re.compile(r"([A-Za-z_]\w*)(?:\.\w+|\[)[^\"']*(?:\(|,|\[)?\s*[\"']([A-Za-z0-9_./\-]*)\Z")
_STEP = re.compile(r"\.(\w+)|\[(?:\"([^\"]*)\"|'([^']*)')\]")


def complete(namespace: dict[str, Any], text: str) -> list[str]:
    """What may follow the text: whole words that replace its last part."""
    dotted = _DOTTED.search(text)
    if dotted:
        found = _resolve(namespace, dotted.group(1))
        if found is None:
            return []
        return [f"{dotted.group(1)}.{n}" for n in sorted(dir(found)) if n.startswith(dotted.group(2)) and not n.startswith("_")]
    quoted = _QUOTED.search(text)
    if quoted:
        session = _session(namespace.get(quoted.group(1)))
        return _paths(session, quoted.group(2)) if session is not None else []
    return []


def _ours(thing: Any) -> bool:
    return type(thing).__module__.partition(".")[0] == "trocar"


def _session(thing: Any) -> Any:
    if not _ours(thing):
        return None
    return thing if hasattr(type(thing), "AddInterfaceRequiredAndConnect") else thing.__dict__.get("_session")


def _resolve(namespace: dict[str, Any], text: str) -> Any:
    first = re.match(r"\w+", text)
    thing: Any = namespace.get(first.group(0)) if first else None
    if first is None or not _ours(thing):
        return None
    for step in _STEP.finditer(text, first.end()):
        name, key = step.group(1), step.group(2) or step.group(3)
        if not _ours(thing):
            return None
        try:
            # A property of the session may ask the system; only the parts of the graph are gone through.
            thing = thing[key] if key else getattr(thing, name) if name not in ("tree",) else None
        except Exception:  # What cannot be found completes to nothing.
            return None
    return thing if _ours(thing) else None


def _paths(session: Any, begun: str) -> list[str]:
    graph, parts = session._graph, begun.split("/")
    known: set[str] = set()
    if len(parts) == 1:
        known = set(graph.processes)
    elif len(parts) == 2:
        known = set(graph.components)
    else:
        owner = "/".join(parts[:2])
        if owner in graph.components:
            try:
                ports = graph.describe(owner).ports
            except Exception:  # Gone meanwhile.
                return []
            if len(parts) == 3:
                known = {f"{owner}/{p.name}" for g in (ports.provided, ports.required, ports.inputs, ports.outputs) for p in g}
            else:
                port = parts[2]
                known = {f"{owner}/{port}/{m.name}" for p in ports.provided if p.name == port for m in (*p.commands, *p.events)}
    return sorted(k for k in known if k.startswith(begun))


def install(shell: Any = None) -> bool:
    """Adds the completion to the IPython that runs, once; false where none does."""
    if shell is None:
        import sys

        getter = getattr(sys.modules.get("IPython"), "get_ipython", None)
        shell = getter() if getter is not None else None
    completer = getattr(shell, "Completer", None)
    if completer is None or getattr(completer, "_trocar", False):
        return completer is not None
    completer._trocar = True

    def matcher(_: str) -> list[str]:
        return complete(shell.user_ns, completer.text_until_cursor)

    completer.custom_matchers.append(matcher)
    return True
