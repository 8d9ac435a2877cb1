"""What people see: answers, descriptions, log lines, the tree, and the graph as a picture for Jupyter.

Invariant: text that components or plugins made is escaped before it gets into HTML, and never runs a terminal's controls.
"""

from __future__ import annotations

import datetime
import html
from typing import Any

from . import _proto
from ._proxy import _documentation, _first, _shape_lines, _signature
from ._system_file import state_text


def clean(text: str) -> str:
    """Without characters that steer a terminal."""
    return "".join(c if c.isprintable() or c in "\n\t" else f"\\x{ord(c):02x}" for c in text)


class Answer:
    """What a change of the system did, or with ``dry_run`` would do: ``plan`` line by line, ``warnings``, ``revision`` after it."""

    def __init__(self, verb: str, message: Any, dry_run: bool) -> None:
        self.message, self.dry_run, self._verb = message, dry_run, verb
        self.plan: list[str] = [clean(line) for line in message.plan]
        self.warnings: list[str] = [clean(w) for w in message.warnings]
        self.revision: int = message.revision
        self.skipped: dict[str, str] = {s.path: s.why for s in message.skipped}
        self.failed: dict[str, str] = {s.path: s.why for s in getattr(message, "failed", ())}

    @property
    def path(self) -> str:
        """Path of the component that was made."""
        return getattr(self.message, "path", "")

    @property
    def id(self) -> int:
        """Number of the connection that was made."""
        return getattr(self.message, "id", 0)

    def __repr__(self) -> str:
        head = "would be done" if self.dry_run else f"revision {self.revision}"
        lines = self.plan or ["nothing to do"]
        lines = [*lines, *(f"left alone: {p}: {clean(w)}" for p, w in self.skipped.items())]
        lines += [f"failed: {p}: {clean(w)}" for p, w in self.failed.items()]
        lines += [f"warning: {w}" for w in self.warnings]
        return "\n".join([f"{self._verb}, {head}:", *(f"  {line}" for line in lines)])


class Lines(list):
    """Log lines; each has ``wall_ns``, ``level``, ``path``, ``target``, ``message``."""

    def __repr__(self) -> str:
        return "\n".join(map(line_text, self)) or "<no lines>"


def line_text(line: Any) -> str:
    """One log line as text, in local time."""
    when = datetime.datetime.fromtimestamp(line.wall_ns / 1e9).strftime("%H:%M:%S.%f")[:-3]
    return f"{when} {line.level:<5} {line.path}: {clean(line.message)}"


def _typed(kind: Any) -> str:
    which = kind.WhichOneof("kind")
    if which == "plain":
        return kind.plain.name
    return f"frames {kind.frame.format} ({kind.frame.header.name})" if which == "frame" else "any type"


class Description:
    """What something offers, as text; ``message`` is the answer itself, ``ports`` and ``component`` its parts."""

    def __init__(self, message: Any, asked: str) -> None:
        self.message, self._asked = message, asked
        self.ports = message.ports
        self.component = message.component

    def __repr__(self) -> str:
        m = self.message
        lines = []
        if m.HasField("component"):
            c = m.component
            fault = f", {clean(c.fault)}" if c.fault else ""
            lines.append(f"{c.path}  {getattr(c, 'class')}  {state_text(c)} {_proto.HEALTH.get(c.health, '')}{fault}")
        elif m.HasField("process"):
            p = m.process
            lines.append(f"{p.name}  {_proto.PROCESS_STATES.get(p.state, '?')}  pid {p.pid}  {p.guest}".rstrip())
        if m.HasField("class"):
            k = getattr(m, "class")
            lines.append(f"{k.plugin}/{k.name} {k.version}: {_first(clean(k.doc))}")
        for k in m.classes:
            lines.append(f"  {k.plugin}/{k.name}: {_first(clean(k.doc))}")
        ports = m.ports if m.HasField("ports") else getattr(m, "class").ports if m.HasField("class") else None
        if ports is not None:
            lines += _ports_text(ports)
        # A page about a port has its own connections and no settings, that of a member neither.
        names = self._asked.count("/")
        if m.HasField("class") and names < 2:
            schema = _proto_settings(getattr(m, "class").config_schema)
            lines += ["settings", *schema] if schema else []
        for c in m.connections:
            if names < 2 or (names == 2 and self._asked in (c.client, c.server)):
                lines.append(f"connection {c.id}: {c.client} ← {c.server}, {c.carrier}")
        return clean("\n".join(lines))


def _proto_settings(schema: Any) -> list[str]:
    from ._values import plain_struct

    settings = plain_struct(schema).get("properties", {})
    lines = []
    for name, about in settings.items() if isinstance(settings, dict) else ():
        about = about if isinstance(about, dict) else {}
        parts = [about.get("type", ""), about.get("unit", "")]
        low, high = about.get("minimum"), about.get("maximum")
        parts += [f"{low}..{high}"] if low is not None and high is not None else []
        parts += [f"default {about['default']}"] if "default" in about else []
        shown = ", ".join(str(p) for p in parts if p != "")
        lines.append(f"  {name} ({shown}): {about.get('description', about.get('title', ''))}".rstrip(": "))
    return lines


def _ports_text(ports: Any) -> list[str]:
    lines = []
    for p in ports.provided:
        lines.append(f"provides {p.name}: {_first(p.doc)}")
        for c in p.commands:
            lines.append(f"  {c.name}{_signature(c)}  {_first(_documentation(c))}")
        for e in p.events:
            payload = f"({e.payload.name}{' ' + e.unit if e.unit else ''})" if e.HasField("payload") else "()"
            lines.append(f"  on.{e.name}{payload}  {_first(e.doc)}")
    for r in ports.required:
        needs = ", ".join(f.name for f in r.functions)
        lines.append(f"requires {r.name}{' (optional)' if r.optional else ''}: {needs}")
    # What every component gives besides, for recorders, is one line.
    taps = [o.name for o in ports.outputs if getattr(o, "tap", False)]
    lines += [f"output {o.name}: {_typed(o.type)}  {_first(o.doc)}" for o in ports.outputs if o.name not in taps]
    lines += [f"taps {', '.join(taps)}"] if taps else []
    lines += [f"input {i.name}: {_typed(i.type)}{' (optional)' if i.optional else ''}  {_first(i.doc)}" for i in ports.inputs]
    if ports.HasField("state") and ports.state.size:
        lines += ["state", *_shape_lines(ports.state, "  ")]
    return lines


class Tree:
    """The system as it was when this was made: as text, and in Jupyter as a picture."""

    def __init__(self, session: Any) -> None:
        g = session._graph
        self.address, self.me = session.address, session.component
        self.revision, self.term = g.revision, g.term
        self.processes = dict(sorted(g.processes.items()))
        self.components = dict(sorted(g.components.items()))
        self.connections = dict(sorted(g.connections.items()))

    def _of(self, process: str) -> dict[str, Any]:
        return {p: c for p, c in self.components.items() if p.partition("/")[0] == process}

    def __repr__(self) -> str:
        lines = [f"{self.address}, revision {self.revision}"]
        wide = max((len(p.partition("/")[2]) for p in self.components), default=0)
        kinds = max((len(getattr(c, "class")) for c in self.components.values()), default=0)
        for i, (name, process) in enumerate(self.processes.items()):
            last = i == len(self.processes) - 1
            guest = f", {clean(process.guest)}" if process.guest else ""
            me = "  ← you" if self.me.partition("/")[0] == name else ""
            state = _proto.PROCESS_STATES.get(process.state, "?")
            lines.append(f"{'└─' if last else '├─'} {name}  {state}{guest}{me}")
            inside = self._of(name)
            for j, (path, c) in enumerate(inside.items()):
                bar = "   " if last else "│  "
                turn = "└─" if j == len(inside) - 1 else "├─"
                health = _proto.HEALTH.get(c.health, "")
                health = f" {health}" if health not in ("", "UNSPECIFIED", "OK") else ""
                fault = f": {clean(c.fault)}" if c.fault else ""
                short = path.partition("/")[2]
                lines.append(f"{bar}{turn} {short:<{wide}}  {getattr(c, 'class'):<{kinds}}  {state_text(c)}{health}{fault}")
        lines += [f"{c.server} → {c.client}" for c in self.connections.values()]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return self.svg()

    def svg(self) -> str:
        """The graph as SVG: process boxes, components with their connected ports, connections from server to client."""
        return _Picture(self).draw()

    def save(self, file: str) -> None:
        """Writes the picture as an SVG file."""
        with open(file, "w", encoding="utf-8") as f:
            f.write(self.svg())


_COLOURS = {"ACTIVE": "#2e9d58", "READY": "#3b7dd8", "CREATED": "#9aa0a6", "STOPPED": "#d08700", "FAULT": "#c5221f"}
_WIDE, _ROW, _HEAD, _GAP, _ASIDE = 240, 16, 38, 18, 80
_PAGE = 1700


class _Picture:
    """Processes as boxes, in them components in columns from servers to clients; servers' ports right and clients' left."""

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.left: dict[str, list[str]] = {}
        self.right: dict[str, list[str]] = {}
        self.before: dict[str, list[str]] = {}
        for c in tree.connections.values():
            for end, side in ((c.client, self.left), (c.server, self.right)):
                owner, _, port = end.rpartition("/")
                ports = side.setdefault(owner, [])
                if port not in ports:
                    ports.append(port)
            client, server = c.client.rpartition("/")[0], c.server.rpartition("/")[0]
            if client != server and client.partition("/")[0] == server.partition("/")[0]:
                self.before.setdefault(client, []).append(server)
        self.ends: dict[tuple[str, str], tuple[float, float]] = {}
        self.out: list[str] = []

    def draw(self) -> str:
        x, y, tallest, widest = 20.0, 20.0, 20.0, 240.0
        for name, process in self.tree.processes.items():
            columns = self._columns(list(self.tree._of(name)))
            wide = len(columns) * (_WIDE + _ASIDE) - _ASIDE + 24
            if x > 20 and x + wide > _PAGE:
                x, y = 20.0, tallest + 30
            tallest = max(tallest, self._process(x, y, wide, name, process, columns))
            widest, x = max(widest, x + wide + 20), x + wide + _ASIDE
        edges = [self._edge(c) for c in self.tree.connections.values()]
        tall = tallest + 20
        style = (
            "text{font:12px sans-serif;fill:#202124}.s{font-size:11px;fill:#5f6368}.p{fill:#f1f3f4;stroke:#bdc1c6}"
            ".c{fill:#fff;stroke:#5f6368}.e{fill:none;stroke:#3b7dd8;stroke-width:1.5;opacity:.8}"
        )
        title = html.escape(f"{self.tree.address}, revision {self.tree.revision}")
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {widest:.0f} {tall:.0f}" width="{widest:.0f}" '
            f'height="{tall:.0f}" style="max-width:100%;height:auto;background:#fff" role="img"><title>{title}</title>'
            f"<style>{style}</style>{''.join(self.out)}{''.join(edges)}</svg>"
        )

    def _columns(self, paths: list[str]) -> list[list[str]]:
        """Whoever is served stands right of its servers; a circle is cut where it is met."""
        rank: dict[str, int] = {}

        def place(path: str, above: tuple[str, ...]) -> int:
            if path not in rank:
                servers = [s for s in self.before.get(path, ()) if s in paths and s not in above and s != path]
                rank[path] = max((place(s, (*above, path)) + 1 for s in servers), default=0)
            return rank[path]

        # The busiest servers first: circles are then cut behind them.
        for path in sorted(paths, key=lambda p: (len(self.left.get(p, ())), -len(self.right.get(p, ())), p)):
            place(path, ())
        columns: list[list[str]] = [[] for _ in range(max(rank.values(), default=0) + 1)]
        row: dict[str, float] = {}
        for number, column in enumerate(columns):
            column += [p for p in paths if rank[p] == number]
            at = {p: [row[s] for s in self.before.get(p, ()) if s in row] for p in column}
            column.sort(key=lambda p: (sum(at[p]) / len(at[p]) if at[p] else 1e9, p))
            row.update((p, i) for i, p in enumerate(column))
        return columns

    def _process(self, x: float, y: float, wide: float, name: str, process: Any, columns: list[list[str]]) -> float:
        boxes, bottom = [], y + 54
        for number, column in enumerate(columns):
            at = y + 34
            for path in column:
                box, at = self._component(x + 12 + number * (_WIDE + _ASIDE), at, path, self.tree.components[path])
                boxes.append(box)
            bottom = max(bottom, at)
        state = _proto.PROCESS_STATES.get(process.state, "?")
        note = html.escape(clean(process.guest)) or state.lower()
        self.out.append(
            f'<rect class="p" x="{x:.0f}" y="{y:.0f}" width="{wide:.0f}" height="{bottom - y:.0f}" rx="8"/>'
            f'<text x="{x + 12:.0f}" y="{y + 20:.0f}" font-weight="bold">{html.escape(name)} '
            f'<tspan class="s" font-weight="normal">{note}</tspan></text>{"".join(boxes)}'
        )
        return bottom

    def _component(self, x: float, y: float, path: str, c: Any) -> tuple[str, float]:
        left, right = self.left.get(path, []), self.right.get(path, [])
        tall = _HEAD + _ROW * max(len(left), len(right)) + 6
        state = state_text(c)
        colour = _COLOURS.get(state.partition("{")[0], "#9aa0a6")
        short = html.escape(path.partition("/")[2])
        kind = html.escape(getattr(c, "class"))
        out = [
            f'<rect class="c" x="{x}" y="{y}" width="{_WIDE}" height="{tall}" rx="5"/>'
            f'<circle cx="{x + 12}" cy="{y + 13}" r="5" fill="{colour}"><title>{html.escape(state)}</title></circle>'
            f'<text x="{x + 23}" y="{y + 17}">{short}</text><text class="s" x="{x + 23}" y="{y + 31}">{kind} · {state.lower()}</text>'
        ]
        for i, port in enumerate(left):
            at = y + _HEAD + _ROW * i + 8
            self.ends[(f"{path}/{port}", "client")] = (x, at)
            out.append(
                f'<circle cx="{x}" cy="{at}" r="3.5" fill="#5f6368"/><text class="s" x="{x + 7}" y="{at + 4}">{html.escape(port)}</text>'
            )
        for i, port in enumerate(right):
            at = y + _HEAD + _ROW * i + 8
            self.ends[(f"{path}/{port}", "server")] = (x + _WIDE, at)
            out.append(
                f'<circle cx="{x + _WIDE}" cy="{at}" r="3.5" fill="#3b7dd8"/>'
                f'<text class="s" x="{x + _WIDE - 7}" y="{at + 4}" text-anchor="end">{html.escape(port)}</text>'
            )
        return "".join(out), y + tall + _GAP

    def _edge(self, c: Any) -> str:
        a, b = self.ends.get((c.server, "server")), self.ends.get((c.client, "client"))
        if a is None or b is None:
            return ""
        bend = max(50.0, abs(b[0] - a[0]) / 3)
        title = html.escape(f"{c.server} → {c.client} ({c.carrier or 'not linked'})")
        return (
            f'<path class="e" d="M{a[0]:.0f},{a[1]:.0f} C{a[0] + bend:.0f},{a[1]:.0f} {b[0] - bend:.0f},{b[1]:.0f} {b[0]:.0f},{b[1]:.0f}">'
            f"<title>{title}</title></path>"
        )
