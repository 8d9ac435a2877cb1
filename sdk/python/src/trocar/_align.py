"""Columns of several topics in one table: each value is that of the message that belongs to the row's time.

Invariant: a value that is further away than the tolerance is missing, and how many are is told; nothing is taken from beyond the first
or the last message of its topic but within the tolerance.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ._errors import invalid
from ._notes import chosen, pandas, said
from ._paths import nearest as suggested

_MOST_ROWS = 100_000_000
# Further away than any message is; stamps from here on are refused, so that no distance is so large.
_FAR = 1 << 62


def aligned(rec: Any, fields: Any, on: Any, rate_hz: Any, how: str, tolerance: Any, start: Any, end: Any, time: str, clock: str) -> Any:
    """See ``Recording.table``."""
    pd = pandas()
    chosen(how, "how", ("nearest", "previous", "linear"))
    chosen(time, "time", ("publish_time", "log_time"))
    chosen(clock, "clock", ("recording", "ns", "wall"))
    _positive(rate_hz, "rate_hz", "a rate in Hz")
    _positive(tolerance, "tolerance", "s")
    if on is not None and rate_hz is not None:
        raise invalid("table: `on` and `rate_hz` both say when rows are; give one of them", field="rate_hz")
    if (start is not None or end is not None) and rec.begin_ns >= _FAR:
        raise invalid(f"{rec.file} begins at {rec.begin_ns} ns, which is no time: leave out `start` and `end`", "OUT_OF_RANGE")
    wanted = _wanted(rec, fields)
    base = _topic(rec, on)[0] if on is not None else next(iter(wanted))
    notes: list[str] = []
    tables = {}
    for name, columns in wanted.items():
        # All of it: a value from before the time that is asked for may belong to its first row.
        tables[name] = _Sorted(rec.topics[name], columns, time, notes)
    if rate_hz is not None:
        rows = _grid(rec, tables, rate_hz, start, end)
    else:
        rows = tables[base].stamps if base in tables else _Sorted(rec.topics[base], None, time, notes, values=False).stamps
        if base not in tables and not len(rows):
            notes.append(f"{base} has no messages: there are no rows")
        low, high = (None if edge is None else rec.begin_ns + round(edge * 1e9) for edge in (start, end))
        rows = rows[(rows >= (low if low is not None else -(1 << 62))) & (rows <= (high if high is not None else 1 << 62))]
    out = pd.DataFrame(index=rec._index(pd, rows if len(rows) and rows.min() < 0 else rows.astype("u8"), clock))
    out.attrs.update(units={}, beyond={}, tolerance_s={}, notes=notes)
    series: dict[str, Any] = {}
    missing = dict.fromkeys(tables, 0)
    unmeasured: list[str] = []
    for name, table in tables.items():
        within, measured = table.tolerance(tolerance)
        unmeasured += [] if measured else [name]
        stepped: list[str] = []
        out.attrs["tolerance_s"][name] = None if within is None else within / 1e9
        for column, values in table.columns(pd).items():
            label = f"{name.lstrip('/')}.{column}"
            # Names with points in them may come to the same.
            label = f"{name.lstrip('/')}: {column}" if label in series else label
            linear = how == "linear" and table.kinds[column] == "float"
            if how == "linear" and not linear:
                stepped.append(column)
            series[label], far = table.at(pd, rows, values, "linear" if linear else "previous" if how == "linear" else how, within)
            out.attrs["beyond"][label] = far
            missing[name] = max(missing[name], far)
            if unit := rec.topics[name].unit_of(column):
                out.attrs["units"][label] = unit
        if not len(table.stamps):
            # Only its messages tell what else it would have.
            for column in wanted[name] or ():
                series[label := f"{name.lstrip('/')}.{column}"] = np.full(len(rows), np.nan)
                out.attrs["beyond"][label] = len(rows)
            notes.append(f"{name} has no messages: its values are missing")
        if stepped:
            notes.append(f"{name}: {', '.join(stepped)} are no floats: their values are those of the previous message")
    for name in tables:
        far = missing[name]
        if far:
            limit = out.attrs["tolerance_s"][name]
            what = f"further than {limit:.6g} s from a message of {name}: their values are missing"
            why = "; its messages have no distance to take a tolerance from: give one" if name in unmeasured else ""
            notes.append(f"{far} of {len(rows)} rows are {what}{why}")
    attrs = out.attrs
    out = pd.DataFrame(series, index=out.index)
    out.attrs = attrs
    said(notes, 4)
    return out


def _positive(value: Any, what: str, unit: str) -> None:
    if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e12):
        raise invalid(f"table: {what} is {value!r}; give {unit}, above 0", field=what)


def _topic(rec: Any, text: str) -> tuple[str, str]:
    """The topic of ``robot/arm/tip.pose.position`` and what is behind it: the longest name of one that fits."""
    name = text if text.startswith("/") else f"/{text}"
    topics = rec.topics
    fits = [t for t in topics if name == t or name.startswith(f"{t}.")]
    if not fits:
        asked = name.rpartition("/")[0] + "/" + name.rpartition("/")[2].partition(".")[0]
        near = suggested(asked, topics)
        raise invalid(f"table: {text!r} is of no topic; there are {', '.join(topics)}{near}", "TOPIC_NOT_FOUND", topic=text)
    topic = max(fits, key=len)
    return topic, name[len(topic) + 1 :]


def _wanted(rec: Any, fields: Any) -> dict[str, list[str] | None]:
    listed = [fields] if isinstance(fields, str) or hasattr(fields, "to_pandas") else list(fields)
    if not listed:
        raise invalid('table: name topics or columns, such as "robot/arm/tip.pose.position"', field="fields")
    found: dict[str, list[str] | None] = {}
    for field in listed:
        topic, column = _topic(rec, getattr(field, "name", field))
        if not column or found.get(topic, ()) is None:
            found[topic] = None
        else:
            found[topic] = [*(found.get(topic) or []), column]
    return found


def _grid(rec: Any, tables: dict[str, Any], rate_hz: float, start: Any, end: Any) -> np.ndarray:
    """Times so often, from the begin, or the first message, to the last one."""
    stamps = [t.stamps for t in tables.values() if len(t.stamps)]
    first = min((int(s[0]) for s in stamps), default=rec.begin_ns) if start is None else rec.begin_ns + round(start * 1e9)
    last = max((int(s[-1]) for s in stamps), default=first) if end is None else rec.begin_ns + round(end * 1e9)
    count = int((last - first) * rate_hz / 1e9) + 1
    if count > _MOST_ROWS:
        raise invalid(f"table: {count} rows are over the limit of {_MOST_ROWS}; take a lower rate, or a shorter time", field="rate_hz")
    # Each from the begin: steps that are added up would drift.
    return first + np.round(np.arange(max(count, 0)) * (1e9 / rate_hz)).astype("i8")


class _Sorted:
    """The columns of one topic in the order of their stamps; of equal stamps the last one counts."""

    def __init__(self, topic: Any, columns: list[str] | None, time: str, notes: list[str], values: bool = True) -> None:
        at = {"publish_time": 1, "log_time": 0}[time]
        if values:
            stamps, self._taken = topic._columns(columns, None, None, time)
            notes += topic._notes(stamps, self._taken, time)
            stamps = stamps[:, at]
        else:
            stamps, self._taken = topic.log_time if at == 0 else topic.publish_time, None
        if len(stamps) and int(stamps.max()) >= _FAR:
            raise invalid(f"{topic.name} has stamps that are no times: {int(stamps.max())} ns", "OUT_OF_RANGE", topic=topic.name)
        stamps = stamps.astype("i8")
        self.order = np.argsort(stamps, kind="stable")
        self.stamps = stamps[self.order]
        self.kinds = {n: c.kind for n, c in self._taken.all.items()} if self._taken is not None else {}

    def columns(self, pd: Any) -> dict[str, Any]:
        """Its columns in that order."""
        return {n: pd.Series(c.pandas(pd)).take(self.order).reset_index(drop=True) for n, c in self._taken.all.items()}

    def tolerance(self, given: float | None) -> tuple[int | None, bool]:
        """The distance that a message may have, ns, and whether there is a measure for it: without one it is 0, without messages None."""
        if given is not None:
            return min(round(given * 1e9), _FAR - 1), True
        steps = np.diff(self.stamps)
        steps = steps[steps > 0]
        if len(steps):
            return min(int(2 * np.median(steps)), _FAR - 1), True
        return (0, False) if len(self.stamps) else (None, True)

    def at(self, pd: Any, rows: np.ndarray, values: Any, how: str, within: int) -> tuple[Any, int]:
        """Values at these times, and how many are missing as none is near enough."""
        before = np.searchsorted(self.stamps, rows, side="right") - 1
        to_before, to_after = np.full(len(rows), _FAR), np.full(len(rows), _FAR)
        has = before >= 0
        to_before[has] = rows[has] - self.stamps[before[has]]
        exact = to_before == 0
        after = np.where(exact, before, before + 1)
        has = after < len(self.stamps)
        # The last one of equal stamps counts on this side as well.
        after[has] = np.searchsorted(self.stamps, self.stamps[after[has]], side="right") - 1
        to_after[has] = self.stamps[after[has]] - rows[has]
        if how == "linear":
            good = (to_before <= within) & (to_after <= within)
            part = to_before[good] / np.maximum(to_before[good] + to_after[good], 1)
            numbers = values.to_numpy()
            out = np.full(len(rows), np.nan)
            low, high = numbers[before[good]], numbers[after[good]]
            # A message at this very time is its value, whatever its neighbour is.
            with np.errstate(invalid="ignore"):
                out[good] = np.where(exact[good], low, low + (high - low) * part)
            return out, int((~good).sum())
        # Both have the same distance: the earlier one counts, which was known by then.
        later = (to_after < to_before) if how == "nearest" else np.zeros(len(rows), bool)
        chosen_rows, distance = np.where(later, after, before), np.where(later, to_after, to_before)
        good = distance <= within
        return _taken(pd, values.array, np.where(good, chosen_rows, -1)), int((~good).sum())


def _taken(pd: Any, values: Any, rows: np.ndarray) -> Any:
    """Values of these rows; missing where the row is -1. Whole numbers stay whole numbers."""
    if (rows < 0).any():
        kind = getattr(values.dtype, "kind", "O")
        if kind == "b":
            values = pd.array(np.asarray(values), dtype="boolean")
        elif kind in "iu":
            values = pd.array(np.asarray(values), dtype="Int64" if kind == "i" else "UInt64")
    if not len(values):
        return pd.Series([None] * len(rows), dtype=object if values.dtype == object else values.dtype, copy=False).array
    return values.take(rows, allow_fill=True)
