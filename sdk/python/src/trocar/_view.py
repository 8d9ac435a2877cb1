"""A recording as people see it: its topics as a table of text, or of HTML in a notebook.

Invariant: names that a file made are escaped before they get into HTML, and never run a terminal's controls.
"""

from __future__ import annotations

import html
from typing import Any

from ._show import clean
from ._words import counted

_HEADS = ("topic", "messages", "rate", "first", "last", "lost", "type")


def as_text(rec: Any) -> str:
    """The text that ``repr`` gives."""
    lines = [clean(_head(rec))]
    rows = [_HEADS, *_rows(rec)]
    wide = [max(len(row[n]) for row in rows) for n in range(len(_HEADS))]
    for row in rows if len(rows) > 1 else ():
        lines.append("  " + "  ".join(cell.ljust(w) for cell, w in zip(row, wide)).rstrip())
    return "\n".join(lines)


def as_html(rec: Any) -> str:
    """The table that a notebook shows."""
    heads = "".join(f"<th style='text-align:left'>{h}</th>" for h in _HEADS)
    rows = "".join("<tr>" + "".join(f"<td style='text-align:left'>{html.escape(c)}</td>" for c in row) + "</tr>" for row in _rows(rec))
    return f"<div><p>{html.escape(clean(_head(rec)))}</p><table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"


def _head(rec: Any) -> str:
    begin = rec.begin
    parts = [counted(len(rec), "topic"), f"{rec.duration_s:.3f} s"]
    parts += [begin.strftime("%Y-%m-%d %H:%M:%S UTC")] if begin is not None else []
    if rec.losses.told:
        parts.append(f"{rec.losses.lost} lost" + (f", {rec.losses.interrupted} interruptions" if rec.losses.interrupted else ""))
    else:
        parts.append("losses are not told in it")
    empty = len(rec) - len(_shown(rec))
    parts += [f"{empty} topic{'s' * (empty > 1)} without messages {'are' if empty > 1 else 'is'} not shown"] if empty else []
    return f"{rec.file}: {', '.join(parts)}" + ("" if rec.complete else f", not complete: {rec.why}")


def _rows(rec: Any) -> list[tuple[str, ...]]:
    return [
        (
            clean(t.name),
            str(len(t)),
            f"{t.rate_hz:.4g} Hz" if t.rate_hz is not None else "-",
            f"{t.first:.3f} s" if t.first is not None else "-",
            f"{t.last:.3f} s" if t.last is not None else "-",
            ("-" if t.lost is None else str(t.lost)) + (" (gave nothing)" if t.silent else ""),
            clean(" then ".join(t.types)),
        )
        for t in _shown(rec)
    ]


def _shown(rec: Any) -> list[Any]:
    """Topics that have something, or should have."""
    return [t for t in rec.topics.values() if len(t) or t.silent]
