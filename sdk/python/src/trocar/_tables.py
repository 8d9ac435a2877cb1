"""A topic as a table: a structured array of numpy, or a DataFrame of pandas.

Invariant: rows are in the order of the file, and whatever is odd in them or missing is told.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ._arrays import structured
from ._columns import TIME, Column, Columns
from ._errors import invalid
from ._notes import chosen, pandas, said
from ._paths import nearest

_STAMPS = {"log_time": 0, "publish_time": 1}


class Tables:
    """The part of a topic that makes tables."""

    def _columns(self, wanted: list[str] | None, start: float | None, end: float | None, time: str) -> tuple[np.ndarray, Columns]:
        """Stamps of acquisition or recording as ns (and the order numbers) of what lies in that time, and its columns."""
        begin = self._recording.begin_ns
        low = None if start is None else begin + round(start * 1e9)
        high = None if end is None else begin + round(end * 1e9)
        out, stamps, at = Columns(wanted), [], _STAMPS[time]
        # A part of the file tells when it was recorded: the clock of a source may be ahead of the recorder's.
        early = low is not None and at == 0
        before = self.unreadable
        for m, value in self._read(max(low or 0, 0) if early else 0):
            stamp = (m.log_time, m.publish_time)[at]
            if (low is None or stamp >= low) and (high is None or stamp <= high):
                out.add(value)
                stamps.append((m.log_time, m.publish_time, m.sequence))
        if none := not stamps:
            # Nothing lies in that time: the columns are those of the first message.
            for _, value in self._read():
                out.add(value)
                break
        out.end()
        if unmet := out.unmet() if out.rows else []:
            there = list(flattened(self))
            raise invalid(
                f"{self.name} has no column {unmet[0]!r}; it has {', '.join(there[:40])}{' and more' if len(there) > 40 else ''}"
                f"{nearest(unmet[0], there)}",
                "FIELD_NOT_FOUND",
                field=unmet[0],
            )
        if none:
            out.emptied()
        self.unreadable = max(before, self.unreadable)
        return np.array(stamps, "u8").reshape(-1, 3), out

    def _notes(self, stamps: np.ndarray, out: Columns, time: str) -> list[str]:
        """Sentences about what is odd or missing in these columns."""
        chosen = stamps[:, _STAMPS[time]]
        back, same = int((chosen[1:] < chosen[:-1]).sum()), int((chosen[1:] == chosen[:-1]).sum())
        notes = [f"{back} of {len(chosen)} stamps are earlier than the one before them: rows are in the order of the file"] if back else []
        notes += [f"{same} of {len(chosen)} stamps are equal to the one before them: all are kept"] if same else []
        notes += [f"{self.unreadable} messages could not be read and are left out"] if self.unreadable else []
        notes += [f"{out.left_out} values have no column (maps, and what is beyond 4096 in one message)"] if out.left_out else []
        notes += [f"values of {', '.join(sorted(out.changed))} are not of one kind: they are objects"] if out.changed else []
        notes += [f"its type changed: {', then '.join(self.types)}"] if len(self.types) > 1 else []
        encodings = {self._recording._file.summary.channels[c].message_encoding for c in self._channels} - {"json", "protobuf"}
        notes += [f"messages in {', '.join(sorted(encodings))} are not decoded: `data` has their lengths"] if encodings else []
        return [f"{self.name}: {note}" for note in notes]

    def unit_of(self, column: str) -> str:
        """The unit of a column; empty where it has none."""
        units, bare = self.units, "".join(part.partition("]")[2] if n else part for n, part in enumerate(column.split("[")))
        if bare in units:
            return units[bare]
        # Stamps of trocar are whole numbers; of other files only the type tells.
        ours = self._recording.profile == "trocar" and bare.rpartition(".")[2] in ("stamp", "timestamp")
        if ours or self._is_time(bare):
            return "ns"
        while bare := bare.rpartition(".")[0]:
            if bare in units:
                return units[bare]
        return "B" if column == "data" and self._is_frames() else ""

    def _is_time(self, bare: str) -> bool:
        """Whether the type at this path is protobuf's own for a time, of which columns have the ns."""
        for channel in self._channels:
            try:
                inner = self._decoder(channel)(b"").DESCRIPTOR
            except Exception:  # Only protobuf has types that tell.
                continue
            for part in bare.split("."):
                field = inner.fields_by_name.get(part) if inner is not None else None
                inner = field.message_type if field is not None else None
            if inner is not None and inner.full_name == TIME:
                return True
        return False

    def to_numpy(self, columns: Any = None, start: float | None = None, end: float | None = None) -> np.ndarray:
        """A structured array with ``log_time``, ``publish_time`` and ``sequence`` in front, of the columns that ``to_pandas`` has: enums as
        their numbers, whole numbers exact. Where values are missing they are NaN, or masked where there is no such number.
        """
        stamps, out = self._columns(_listed(columns), start, end, "publish_time")
        told = {"log_time": stamps[:, 0], "publish_time": stamps[:, 1], "sequence": stamps[:, 2]}
        said(self._notes(stamps, out, "publish_time"))
        return structured({**told, **{name: c.numpy() for name, c in out.all.items() if name not in told}})

    def to_pandas(
        self,
        columns: Any = None,
        start: float | None = None,
        end: float | None = None,
        *,
        time: str = "publish_time",
        clock: str = "recording",
    ) -> Any:
        """A ``DataFrame``, a row for each message.

        ``columns`` are names as ``trocar export --csv`` writes them, or what they begin with (``"pose.position"``). ``start`` and ``end``
        bound it, s since the recording began. The index is ``time``: ``"publish_time"``, when it was acquired, or ``"log_time"``, when it
        was recorded; as ``clock`` says in seconds since the recording began (``"recording"``), ns of the recorder's clock (``"ns"``), or
        date and time, UTC (``"wall"``). Enums are categories; ``attrs`` has ``units`` and ``notes``.
        """
        pd = pandas()
        chosen(time, "time", ("publish_time", "log_time"))
        chosen(clock, "clock", ("recording", "ns", "wall"))
        stamps, out = self._columns(_listed(columns), start, end, time)
        index = self._recording._index(pd, stamps[:, _STAMPS[time]], clock)
        table = pd.DataFrame({name: c.pandas(pd) for name, c in out.all.items()}, index=index, copy=False)
        table.attrs["units"] = {name: unit for name in out.all if (unit := self.unit_of(name))}
        table.attrs["notes"] = self._notes(stamps, out, time)
        said(table.attrs["notes"])
        return table


def flattened(topic: Any) -> dict[str, Column]:
    """The columns of a topic's first message."""
    out = Columns()
    for _, value in topic._read():
        out.add(value)
        break
    return out.end()


def _listed(columns: Any) -> list[str] | None:
    if columns is None:
        return None
    listed = [columns] if isinstance(columns, str) else list(columns)
    if not listed or not all(isinstance(c, str) and c for c in listed):
        raise invalid(f'columns are names such as "pose.position[0]"; {columns!r} is not', field="columns")
    return listed
