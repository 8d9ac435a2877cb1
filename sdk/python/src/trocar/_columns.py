"""Messages as columns of numbers, words and texts, named as ``trocar export --csv`` names them: ``pose.position[0]``.

Invariant: a value is in its column as it was sent, or it is missing and told; whole numbers of 64 bit never pass through a float.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np

# Values of one message at most, and types inside each other, as `trocar export` has them.
_MOST, _DEEP, _EXACT = 4096, 32, 1 << 53
_STORED = {"float": "d", "int": "q", "uint": "Q", "bool": "b", "enum": "q", "bytes": "q"}
_LIMITS = {"int": (-(1 << 63), (1 << 63) - 1), "uint": (0, (1 << 64) - 1)}
TIME = "google.protobuf.Timestamp"
# Types of fields in descriptors of protobuf.
_KINDS = {
    1: "float", 2: "float", 3: "int", 4: "uint", 5: "int", 6: "uint", 7: "int", 8: "bool", 9: "text", 12: "bytes", 13: "int", 14: "enum",
    15: "int", 16: "int", 17: "int", 18: "int",
}  # fmt: skip


class Column:
    """One column: ``kind`` of its values, and the rows that have none. A ``bytes`` column has how many there are."""

    __slots__ = ("gaps", "kind", "names", "rows", "values")

    def __init__(self, kind: str, names: dict[int, str] | None = None) -> None:
        self.kind, self.names, self.rows = kind, names or {}, 0
        self.gaps = array("q")
        self.values: Any = array(_STORED[kind]) if kind in _STORED else []

    def put(self, row: int, value: Any) -> None:
        """The value of a row; rows before it that have none are missing."""
        self.pad(row)
        self.values.append(value)
        self.rows = row + 1

    def pad(self, rows: int) -> None:
        """Has no value up to here."""
        while self.rows < rows:
            self.gaps.append(self.rows)
            self.values.append(None if isinstance(self.values, list) else 0)
            self.rows += 1

    def mixed(self) -> None:
        """Takes any values from now on."""
        gaps = set(self.gaps)
        if self.kind == "enum":
            self.values = [self.names.get(v, str(v)) for v in self.values]
        self.values = [None if n in gaps else v for n, v in enumerate(self.values)]
        self.kind = "object"

    def agrees(self, names: dict[int, str], value: int) -> bool:
        """Whether an enum of other names, of which this value is, leaves each number with the word that it was sent with."""
        new = names.keys() - self.names.keys()
        same = all(self.names.get(n, word) == word for n, word in names.items())
        return same and (value in names or value not in self.names) and (not new or new.isdisjoint(self.values))

    def missing(self) -> np.ndarray:
        """Which rows have no value."""
        mask = np.zeros(self.rows, bool)
        mask[np.array(self.gaps, "i8")] = True
        return mask

    def numpy(self) -> np.ndarray:
        """The values; a number of an enum, NaN for a missing float. Where others are missing, a masked array."""
        if self.kind in _STORED:
            out = np.array(self.values, {"d": "f8", "q": "i8", "Q": "u8", "b": "?"}[_STORED[self.kind]])
        elif self.kind == "text" and not self.gaps:
            return np.array(self.values, np.str_)
        else:
            out = np.empty(self.rows, object)
            out[:] = self.values
            return out
        if not self.gaps:
            return out
        if self.kind == "float":
            out[self.missing()] = np.nan
            return out
        return np.ma.MaskedArray(out, self.missing())

    def pandas(self, pd: Any) -> Any:
        """The values as a column of pandas: categories for an enum, a type with room for what is missing where something is."""
        if self.kind == "enum":
            numbers, codes = np.unique(np.array(self.values, "i8"), return_inverse=True)
            known = sorted({*self.names, *(int(n) for n in numbers)} if len(numbers) else self.names)
            # Two numbers may have one name, where the type of a topic changed: they are one category.
            words: dict[str, int] = {}
            code_of = {n: words.setdefault(self.names.get(n, str(n)), len(words)) for n in known}
            codes = np.array([code_of[int(n)] for n in numbers], "i8")[codes] if len(numbers) else codes
            codes[self.missing()] = -1
            return pd.Categorical.from_codes(codes, list(words))
        if self.kind in ("text", "object"):
            return pd.Series(self.values, dtype=object).array
        out = self.numpy()
        if not isinstance(out, np.ma.MaskedArray):
            return out
        kind = {"i": pd.arrays.IntegerArray, "u": pd.arrays.IntegerArray, "b": pd.arrays.BooleanArray}[out.dtype.kind]
        return kind(out.data, self.missing())


class Columns:
    """Takes messages one by one. With ``wanted`` only columns of these names, or below them."""

    def __init__(self, wanted: list[str] | None = None) -> None:
        self.all: dict[str, Column] = {}
        self.rows = 0
        self.left_out = 0
        self.changed: set[str] = set()
        self._wanted = wanted
        self._roots = {w.partition(".")[0].partition("[")[0] for w in wanted} if wanted is not None else None
        self._fits: dict[str, bool] = {}
        # Values of the message that is added, and messages in it that were looked at: types may mean ill.
        self._many = self._steps = 0
        self._nodes: dict[str, _Node] = {}

    def add(self, message: Any) -> None:
        """The next row."""
        self._many = self._steps = 0
        if isinstance(message, Mapping):
            for name, value in message.items():
                self._json(str(name), value)
        elif hasattr(message, "DESCRIPTOR"):
            descriptor = message.DESCRIPTOR
            node = self._nodes.get(descriptor.full_name)
            if node is None or node.descriptor is not descriptor:
                node = self._nodes[descriptor.full_name] = _Node(descriptor)
            self._flatten(message, node, self._roots)
        elif isinstance(message, bytes):
            self._put("data", "bytes", len(message))
        else:
            self._json("json", message)
        self.rows += 1

    def end(self) -> dict[str, Column]:
        """All columns, each with a row for each message."""
        for column in self.all.values():
            column.pad(self.rows)
        return self.all

    def emptied(self) -> None:
        """Forgets all rows; the columns stay."""
        self.all = {name: Column(column.kind, column.names) for name, column in self.all.items()}
        self.rows = 0

    def unmet(self) -> list[str]:
        """Wanted names that no column has."""
        return [w for w in self._wanted or () if not any(_names(w, name) for name in self.all)]

    def _put(self, name: str, kind: str, value: Any, names: dict[int, str] | None = None) -> None:
        if self._wanted is not None:
            if name not in self._fits:
                self._fits[name] = any(_names(w, name) for w in self._wanted)
            if not self._fits[name]:
                return
        self._many += 1
        column = self.all.get(name)
        if self._many > _MOST:
            self.left_out += 1
            return
        if column is None:
            column = self.all[name] = Column(kind, names)
        if names and column.kind == kind and column.names is not names:
            if column.names == names:
                column.names = names
            elif column.agrees(names, value):
                column.names = {**names, **column.names}
            else:
                # A number has another name than before, or one where it had none: words are what was sent.
                column.mixed()
                self.changed.add(name)
        low, high = _LIMITS.get(column.kind, (None, None))
        if column.kind != kind or (low is not None and not low <= value <= high):
            value = self._other(name, column, kind, value, names)
        column.put(self.rows, value)

    def _other(self, name: str, column: Column, kind: str, value: Any, names: dict[int, str] | None) -> Any:
        """A value of another kind than the column had: the column widens where nothing is lost by it, else it takes anything."""
        if {column.kind, kind} == {"int", "float"} and (kind == "float" or abs(value) <= _EXACT):
            if column.kind == "float":
                return float(value)
            if all(abs(v) <= _EXACT for v in column.values):
                column.kind, column.values = "float", array("d", column.values)
                return value
        if column.kind != "object":
            column.mixed()
            self.changed.add(name)
        return names.get(value, str(value)) if names else value

    def _json(self, name: str, value: Any) -> None:
        kind = {bool: "bool", int: "int", float: "float", str: "text"}.get(type(value))
        if value is not None:
            self._put(name, kind or "text", value if kind else json.dumps(value, ensure_ascii=False))

    def _flatten(self, message: Any, node: _Node, roots: set[str] | None = None) -> None:
        for field in node.fields:
            if roots is not None and field.name not in roots:
                continue
            if field.kind is None:
                self.left_out += len(getattr(message, field.name))
            elif field.many:
                names = field.numbered
                for n, item in enumerate(getattr(message, field.name)):
                    if n == len(names):
                        names.append(field.item(n))
                    self._value(names[n], field, item)
            elif field.kind == "message":
                # One that is not there has the columns of its type, unless that is within itself.
                if field.columns or message.HasField(field.name):
                    self._value(field.at, field, getattr(message, field.name))
            elif not field.may_miss or message.HasField(field.name):
                self._value(field.at, field, getattr(message, field.name))

    def _value(self, at: Any, field: _Field, value: Any) -> None:
        kind = field.kind
        if kind == "message":
            if field.is_time:
                self._put(at, "int", value.seconds * 1_000_000_000 + value.nanos)
            elif field.deep < _DEEP and self._steps < 4 * _MOST:
                self._steps += 1
                self._flatten(value, at.node(field) if isinstance(at, _Place) else field.node())
            else:
                self.left_out += 1
            return
        column = self.all.get(at)
        # The way of nearly all: as the last one was. What a field of protobuf may hold fits into its column.
        if (
            column is not None
            and column.kind == kind
            and column.rows == self.rows
            and self._many < _MOST
            and kind != "bytes"
            and (field.names is None or column.names is field.names)
        ):
            column.values.append(value)
            column.rows += 1
            self._many += 1
        else:
            self._put(at, kind, len(value) if kind == "bytes" else value, field.names)


class _Place(str):
    """The name of one of many messages, and what is in it."""

    _node: Any = None

    def node(self, field: _Field) -> _Node:
        """The fields of the message at this place."""
        if self._node is None:
            self._node = _Node(field.inner, str(self), field.around)
        return self._node


class _Field:
    """A field at its place in a message: its column's name, and what it takes to read it."""

    def __init__(self, f: Any, path: str, around: tuple[str, ...]) -> None:
        self.name, self.inner, self.around = f.name, f.message_type, around
        self.at = f"{path}.{f.name}" if path else f.name
        self.names = {v.number: v.name for v in reversed(f.enum_type.values)} if f.enum_type is not None else None
        self.kind: Any = "message" if self.inner is not None else _KINDS.get(f.type)
        self.is_time = self.inner is not None and self.inner.full_name == TIME
        # The keys of a map are no columns.
        if self.inner is not None and self.inner.GetOptions().map_entry:
            self.kind = None
        self.many = f.is_repeated if hasattr(f, "is_repeated") else f.label == 3
        self.may_miss = f.has_presence and self.inner is None
        self.deep = len(around)
        self.columns = self.inner is not None and self.deep < _DEEP and self.inner.full_name not in around
        self.numbered: list[str] = []
        self._node: _Node | None = None

    def item(self, n: int) -> str:
        """The name of one of many."""
        name = f"{self.at}[{n}]"
        return _Place(name) if self.kind == "message" else name

    def node(self) -> _Node:
        """The fields of the message in it."""
        if self._node is None:
            self._node = _Node(self.inner, self.at, self.around)
        return self._node


class _Node:
    """The fields of a message at a path."""

    def __init__(self, descriptor: Any, path: str = "", around: tuple[str, ...] = ()) -> None:
        self.descriptor = descriptor
        around = (*around, descriptor.full_name)
        self.fields = [_Field(f, path, around) for f in descriptor.fields]


def _names(wanted: str, name: str) -> bool:
    return name == wanted or name.startswith((f"{wanted}.", f"{wanted}["))
