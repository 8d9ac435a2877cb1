"""Values: exact bytes and JSON of a described type as Python numbers, records and numpy arrays, each with its unit.

Invariant: what a type description says decides; bytes that do not fit it are refused with both sizes, never guessed.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from . import _proto
from ._errors import TrocarError, invalid

_FORMATS = {
    "bool": "?", "u8": "<u1", "i8": "<i1", "u16": "<u2", "i16": "<i2", "u32": "<u4", "i32": "<i4",
    "u64": "<u8", "i64": "<i8", "f32": "<f4", "f64": "<f8", "stamp": "<u8",
}  # fmt: skip
_STRUCTS = {
    "bool": "<?", "u8": "<B", "i8": "<b", "u16": "<H", "i16": "<h", "u32": "<I", "i32": "<i",
    "u64": "<Q", "i64": "<q", "f32": "<f", "f64": "<d", "stamp": "<Q",
}  # fmt: skip
_DEEPEST = 60
_EXACT = 2**53


class Int(int):
    """A whole number with a unit; calculates like any other (the unit then is no longer known)."""

    unit: str = ""

    def __new__(cls, value: Any, unit: str = "") -> Int:
        self = super().__new__(cls, value)
        self.unit = unit
        return self

    def __repr__(self) -> str:
        return f"{int(self)} {self.unit}" if self.unit else int.__repr__(self)

    def __getnewargs__(self) -> Any:
        return (int(self), self.unit)


class Float(float):
    """A number with a unit; calculates like any other (the unit then is no longer known)."""

    unit: str = ""

    def __new__(cls, value: Any, unit: str = "") -> Float:
        self = super().__new__(cls, value)
        self.unit = unit
        return self

    def __repr__(self) -> str:
        return f"{float(self)!r} {self.unit}" if self.unit else float.__repr__(self)

    def __getnewargs__(self) -> Any:
        return (float(self), self.unit)


class Record(Mapping):
    """A struct of a component: fields as attributes and keys, shown with their units.

    Numbers are ``Int`` and ``Float``, arrays and lists numpy arrays, structs records. ``units`` has the unit of each field,
    ``docs`` what it means.
    """

    def __init__(self, name: str, values: dict[str, Any], units: dict[str, str], docs: dict[str, str]) -> None:
        self.__dict__.update(_name=name, _values=values, _units=units, _docs=docs)

    @property
    def units(self) -> dict[str, str]:
        """The unit of each field; empty = none, or inside the field."""
        return dict(self._units)

    @property
    def docs(self) -> dict[str, str]:
        """What each field means."""
        return dict(self._docs)

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __getattr__(self, name: str) -> Any:
        if name in self._values:
            return self._values[name]
        raise AttributeError(f"{self._name} has no field {name!r}; it has {', '.join(self._values)}")

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a {self._name} that was read cannot be changed; send a dict: {{**value, {name!r}: …}}")

    def __dir__(self) -> list[str]:
        return [*self._values, "units", "docs"]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._values)

    def __repr__(self) -> str:
        # `reserved` only fills a payload up to its alignment.
        fields = {key: value for key, value in self._values.items() if key != "reserved"}
        wide = max((len(k) for k in fields), default=0)
        lines = [f"{self._name}:"]
        for key, value in fields.items():
            unit = self._units.get(key, "")
            shown = (
                np.array2string(value, threshold=20, prefix=" " * (wide + 4))
                if isinstance(value, np.ndarray)
                else str(value)
                if isinstance(value, str)
                else repr(value)
            )
            if unit and not isinstance(value, (Int, Float)):
                shown = f"{shown} {unit}"
            shown = shown.replace("\n", "\n" + " " * (wide + 4)) if isinstance(value, Record) else shown
            lines.append(f"  {key:<{wide}}  {shown}")
        return "\n".join(lines)


class Rows(np.ndarray):
    """Rows of a state table, or a sample, as a structured numpy array.

    ``units`` has the unit of each field, also of one inside of another (``"pose.position"``), ``seq`` the number of each row (its tick)
    or sample, ``stamp_ns`` when it was published (ns of the host's monotonic clock), ``age_s`` how old the newest was when it was
    read, s.
    """

    units: dict[str, str]
    seq: Any
    stamp_ns: Any
    age_s: float
    path: str

    def __array_finalize__(self, obj: Any) -> None:
        for name, default in (("units", {}), ("seq", None), ("stamp_ns", None), ("age_s", math.nan), ("path", "")):
            self.__dict__.setdefault(name, getattr(obj, name, default))


class Frame(np.ndarray):
    """One frame as a numpy array; ``header`` is what came with it, ``units`` that of its fields.

    An image is ``(height, width)`` or ``(height, width, colours)``, a stereo pair the same with a leading 2 (left, right), lines of an
    OCT ``(lines, samples)``; anything else its bytes. ``format`` is that of the port, ``pixels`` that of the values (``"RGB8"``).
    """

    header: Record
    format: str
    pixels: str
    seq: int
    stamp_ns: int
    age_s: float
    path: str

    def __array_finalize__(self, obj: Any) -> None:
        for name, default in (
            ("header", None), ("format", ""), ("pixels", ""), ("seq", 0), ("stamp_ns", 0), ("age_s", math.nan), ("path", ""),
        ):  # fmt: skip
            self.__dict__.setdefault(name, getattr(obj, name, default))


def shape_of(ty: Any) -> str:
    """Which of its shapes a type has: ``primitive``, ``array``, ``list``, ``text``, ``enumeration``, ``structure``."""
    return ty.WhichOneof("shape") or "primitive"


def raw_dtype(ty: Any) -> np.dtype:
    """The memory of a type as numpy sees it, offsets as they are."""
    kind = shape_of(ty)
    if kind == "primitive":
        return np.dtype(_FORMATS[_proto.PRIMITIVES[ty.primitive]])
    if kind == "enumeration":
        return np.dtype(_FORMATS[_proto.PRIMITIVES[ty.enumeration.repr]])
    if kind == "array":
        return np.dtype((raw_dtype(ty.array.item), (ty.array.n,)))
    if kind == "list":
        items = np.dtype((raw_dtype(ty.list.item), (ty.list.n,)))
        return np.dtype({"names": ["n", "items"], "formats": ["<u8", items], "offsets": [0, 8], "itemsize": ty.size})
    if kind == "text":
        room = np.dtype(("u1", (ty.text,)))
        return np.dtype({"names": ["n", "bytes"], "formats": ["<u8", room], "offsets": [0, 8], "itemsize": ty.size})
    fields = ty.structure.fields
    return np.dtype(
        {
            "names": [f.name for f in fields],
            "formats": [raw_dtype(f.type) for f in fields],
            "offsets": [f.offset for f in fields],
            "itemsize": ty.size,
        }
    )


def _tidy(ty: Any, raw: np.ndarray) -> np.ndarray:
    """``raw`` (k values of ``ty``) for people: lists as long as the longest, words for enumerations, text as text."""
    kind = shape_of(ty)
    if kind == "primitive":
        return raw
    if kind == "enumeration":
        names = {v.number: v.name for v in ty.enumeration.values}
        words = [names.get(int(v), str(int(v))) for v in raw.reshape(-1)]
        return np.array(words, dtype=np.str_).reshape(raw.shape)
    if kind == "array":
        return _items(ty.array.item, raw)
    if kind == "list":
        lengths = np.minimum(raw["n"].astype(np.int64), ty.list.n)
        longest = int(lengths.max()) if lengths.size else 0
        items = _items(ty.list.item, raw["items"][:, :longest])
        if items.dtype.kind == "f" and (lengths < longest).any():
            items = np.where(np.arange(longest)[None, :] < lengths[:, None], items, np.nan)
        return items
    if kind == "text":
        lengths = np.minimum(raw["n"].astype(np.int64), ty.text)
        texts = [bytes(b[:n]).decode("utf-8", "replace") for b, n in zip(raw["bytes"], lengths)]
        return np.array(texts, dtype=np.str_)
    columns = {f.name: _tidy(f.type, raw[f.name]) for f in ty.structure.fields}
    dtype = np.dtype([(name, c.dtype, c.shape[1:]) for name, c in columns.items()])
    out = np.empty(len(raw), dtype)
    for name, column in columns.items():
        out[name] = column
    return out


def _items(ty: Any, raw: np.ndarray) -> np.ndarray:
    count, each = raw.shape[0], raw.shape[1]
    flat = _tidy(ty, np.ascontiguousarray(raw).reshape((count * each, *raw.shape[2:])))
    return flat.reshape((count, each, *flat.shape[1:]))


def _raw(ty: Any, encoded: bytes, rows: int = 1) -> np.ndarray:
    if len(encoded) != ty.size * rows:
        raise TrocarError("INTERNAL", "TYPE_MISMATCH", f"{len(encoded)} bytes came for {rows} of {ty.name}, which has {ty.size} each")
    dtype = raw_dtype(ty)
    if dtype.subdtype is not None:
        base, shape = dtype.subdtype
        return np.frombuffer(encoded, base).reshape((rows, *shape))
    return np.frombuffer(encoded, dtype, count=rows)


def to_rows(ty: Any, encoded: list[bytes]) -> np.ndarray:
    """So many values as one array: structured for structs, with one more axis for arrays and lists."""
    return _tidy(ty, _raw(ty, b"".join(encoded), len(encoded)))


def units_of(ty: Any) -> dict[str, str]:
    """The unit of each field of a struct."""
    return {f.name: f.unit for f in ty.structure.fields} if shape_of(ty) == "structure" else {}


def units_in(ty: Any) -> dict[str, str]:
    """The same, also of fields inside of fields: ``"pose.position"``."""
    out = units_of(ty)
    for field in ty.structure.fields if out else ():
        inner = field.type
        while shape_of(inner) in ("array", "list"):
            inner = inner.array.item if shape_of(inner) == "array" else inner.list.item
        out.update({f"{field.name}.{name}": unit for name, unit in units_in(inner).items()})
    return out


def to_value(ty: Any, encoded: bytes, unit: str = "") -> Any:
    """One value as Python has it."""
    if shape_of(ty) == "primitive" and len(encoded) == ty.size:
        return _number(struct.unpack(_STRUCTS[_proto.PRIMITIVES[ty.primitive]], encoded)[0], unit)
    return _value(ty, _tidy(ty, _raw(ty, encoded))[0], unit)


def _number(value: Any, unit: str) -> Any:
    if isinstance(value, bool):
        return value
    return Float(value, unit) if isinstance(value, float) else Int(value, unit)


def _value(ty: Any, item: Any, unit: str) -> Any:
    kind = shape_of(ty)
    if kind == "primitive":
        return _number(item.item() if hasattr(item, "item") else item, unit)
    if kind in ("enumeration", "text"):
        return str(item)
    if kind == "structure":
        fields = ty.structure.fields
        return Record(
            ty.structure.name or ty.name,
            {f.name: _value(f.type, item[f.name], _unit_of(f)) for f in fields},
            units_of(ty),
            {f.name: f.doc for f in fields},
        )
    inner = ty.array.item if kind == "array" else ty.list.item
    if shape_of(inner) == "structure":
        return [_value(inner, i, "") for i in item]
    return np.array(item)


def _unit_of(field: Any) -> str:
    return "ns" if shape_of(field.type) == "primitive" and _proto.PRIMITIVES[field.type.primitive] == "stamp" else field.unit


def from_json(ty: Any, value: Any, unit: str = "") -> Any:
    """A value that came as JSON (events, samples that are followed), by its type."""
    if ty is None:
        return None
    kind = shape_of(ty)
    if value is None or (kind == "structure") != isinstance(value, dict):
        return value
    if kind == "primitive":
        word = _proto.PRIMITIVES[ty.primitive]
        if word == "bool":
            return bool(value)
        return Float(value, unit) if word in ("f32", "f64") else Int(value, unit)
    if kind == "structure":
        fields = ty.structure.fields
        values = {f.name: from_json(f.type, value.get(f.name), _unit_of(f)) for f in fields}
        return Record(ty.structure.name or ty.name, values, units_of(ty), {f.name: f.doc for f in fields})
    if kind in ("array", "list"):
        inner = ty.array.item if kind == "array" else ty.list.item
        if shape_of(inner) == "structure":
            return [from_json(inner, v) for v in value]
        if shape_of(inner) == "primitive":
            return np.array([from_json(inner, v) for v in value], _FORMATS[_proto.PRIMITIVES[inner.primitive]])
        return np.array(value)
    return value


def plain(wire: Any) -> Any:
    """A ``google.protobuf.Value`` as Python's own types."""
    kind = wire.WhichOneof("kind")
    if kind == "number_value":
        n = wire.number_value
        return int(n) if n.is_integer() and abs(n) < _EXACT else n
    if kind == "struct_value":
        return plain_struct(wire.struct_value)
    if kind == "list_value":
        return [plain(v) for v in wire.list_value.values]
    return getattr(wire, kind) if kind not in (None, "null_value") else None


def plain_struct(wire: Any) -> dict[str, Any]:
    """A ``google.protobuf.Struct`` as a dict."""
    return {k: plain(v) for k, v in wire.fields.items()}


def to_wire(value: Any, what: str = "the argument", deep: int = 0) -> Any:
    """A value of Python or numpy as ``google.protobuf.Value``; refused when JSON has no such thing."""
    wire = _proto.Value()
    _put(wire, value, what, deep)
    return wire


def to_wire_struct(value: Any, what: str) -> Any:
    """A dict as ``google.protobuf.Struct``."""
    if not isinstance(value, Mapping):
        raise invalid(f'{what} is an object, e.g. {{"key": 1}}; {_brief(value)} is not', field=what)
    return to_wire(value, what).struct_value


def _put(wire: Any, value: Any, what: str, deep: int) -> None:
    if deep > _DEEPEST:
        raise invalid(f"{what} is nested deeper than {_DEEPEST}", field=what)
    if isinstance(value, enum.Enum):
        value = value.name
    if value is None:
        wire.null_value = 0
    elif isinstance(value, (bool, np.bool_)):
        wire.bool_value = bool(value)
    elif isinstance(value, (int, np.integer)):
        n = int(value)
        if abs(n) < _EXACT:
            wire.number_value = n
        else:
            wire.string_value = str(n)
    elif isinstance(value, (float, np.floating)):
        f = float(value)
        if math.isfinite(f):
            wire.number_value = f
        else:
            wire.string_value = "NaN" if math.isnan(f) else "Infinity" if f > 0 else "-Infinity"
    elif isinstance(value, str):
        try:
            wire.string_value = value
        except UnicodeError:
            raise invalid(f"{what}: {_brief(value)} is not valid Unicode", field=what) from None
    elif isinstance(value, Mapping):
        wire.struct_value.SetInParent()
        for key, inner in value.items():
            if not isinstance(key, str):
                raise invalid(f"{what}: the key {_brief(key)} is not a text", field=what)
            _put(wire.struct_value.fields[key], inner, what, deep + 1)
    elif isinstance(value, (list, tuple, np.ndarray)):
        if isinstance(value, np.ndarray):
            value = _listed(value)
            if not isinstance(value, list):
                return _put(wire, value, what, deep)
        wire.list_value.SetInParent()
        for inner in value:
            _put(wire.list_value.values.add(), inner, what, deep + 1)
    elif isinstance(value, np.void) and value.dtype.names:
        _put(wire, {name: value[name] for name in value.dtype.names}, what, deep)
    else:
        kinds = "numbers, texts, lists, dicts and numpy arrays"
        raise invalid(f"{what}: {_brief(value)} cannot be sent; {kinds} can", field=what)
    return None


def _listed(value: np.ndarray) -> Any:
    if value.dtype.names:
        return {n: value[n] for n in value.dtype.names} if value.ndim == 0 else list(value)
    return value.tolist()


def _brief(value: Any) -> str:
    shown = repr(value)
    shown = shown if len(shown) <= 60 else shown[:57] + "…"
    return f"{shown} ({type(value).__name__})" if not isinstance(value, (str, int, float)) else shown


_PIXELS = {
    "GRAY8": ("u1", 1), "RGB8": ("u1", 3), "BGR8": ("u1", 3), "RGBA8": ("u1", 4), "GRAY16": ("<u2", 1), "BAYER_RG8": ("u1", 1),
    "YUYV": ("u1", 2), "DISPARITY16": ("<i2", 1), "DEPTH32F": ("<f4", 1),
}  # fmt: skip
_SAMPLES = {"U16": "<u2", "F32": "<f4", "U8": "u1"}


def to_frame(ty: Any, header: bytes, data: bytes) -> Frame:
    """A frame by its header: ``ty`` is the port's ``FrameType``. A header that does not fit the bytes is refused."""
    head = to_value(ty.header, header)
    pixels = str(head["format"]) if "format" in head else ""
    kind = ty.format.partition("/")[0]
    if kind in ("image", "stereo") and pixels in _PIXELS and {"width", "height", "stride"} <= set(head):
        out = _image(head, data, pixels, stereo=kind == "stereo")
    elif pixels in _SAMPLES and {"lines", "samples"} <= set(head):
        item = np.dtype(_SAMPLES[pixels])
        _fits(head["lines"] * head["samples"] * item.itemsize, len(data), head)
        out = np.frombuffer(data, item, count=head["lines"] * head["samples"]).reshape(head["lines"], head["samples"])
    else:
        out = np.frombuffer(data, "u1")
    frame = out.view(Frame)
    frame.header, frame.format, frame.pixels = head, ty.format, pixels
    return frame


def _image(head: Record, data: bytes, pixels: str, stereo: bool) -> np.ndarray:
    item, colours = np.dtype(_PIXELS[pixels][0]), _PIXELS[pixels][1]
    width, height, stride = int(head["width"]), int(head["height"]), int(head["stride"])
    row = width * colours * item.itemsize
    _fits(row, stride, head)
    starts = [0, int(head["right_offset"])] if stereo else [0]
    _fits(max(starts) + stride * max(height - 1, 0) + (row if height else 0), len(data), head)
    shape, steps = (height, width, colours), (stride, colours * item.itemsize, item.itemsize)
    images = [np.ndarray(shape, item, data, start, steps) for start in starts]
    images = [i[:, :, 0] if colours == 1 else i for i in images]
    return np.stack(images) if stereo else np.ascontiguousarray(images[0])


def _fits(needed: int, there: int, head: Record) -> None:
    if needed > there:
        raise TrocarError("INTERNAL", "FORMAT_MISMATCH", f"a frame's header speaks of {needed} bytes where {there} are: {head!r}")


def title(ty: Any) -> str:
    """The short name of a type, as the host gives it: ``i32``, ``f64[5]``, ``JointState``."""
    return ty.name
