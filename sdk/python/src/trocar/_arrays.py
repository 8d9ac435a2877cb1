"""Messages of a recording decoded, and values of their fields as numpy arrays.

Invariant: an array holds what was sent; values that have no common type stay objects.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from ._errors import TrocarError

_EXACT = 1 << 53


def decoder(encoding: str, schema: Any) -> Any:
    """A function that makes a message of bytes; it leaves bytes of an unknown encoding as they are."""
    if encoding == "json":
        return json.loads
    if encoding == "protobuf" and schema is not None:
        try:
            from mcap_protobuf.decoder import DecoderFactory
        except ImportError:
            raise TrocarError(
                "FAILED_PRECONDITION", "NOT_INSTALLED", "this recording needs mcap-protobuf-support: pip install mcap-protobuf-support"
            ) from None
        found = DecoderFactory().decoder_for(encoding, schema)
        if found is not None:
            return found
    return bytes


def within(message: Any, name: str) -> Any:
    """A field of a message by its path."""
    for part in name.split("."):
        message = message[part] if isinstance(message, Mapping) else getattr(message, part)
    return message


def structured(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Columns of one length as a structured array; masked where one of them is."""
    masked = any(isinstance(c, np.ma.MaskedArray) for c in columns.values())
    rows = len(next(iter(columns.values())))
    out = np.empty(rows, np.dtype([(n, c.dtype, c.shape[1:]) for n, c in columns.items()]))
    out = np.ma.MaskedArray(out, np.zeros(rows, np.ma.make_mask_descr(out.dtype))) if masked else out
    for name, column in columns.items():
        out[name] = column
    return out


def array(values: list[Any]) -> np.ndarray:
    """Values of a field as one array where they have one shape, else as objects."""
    kinds = {type(v) for p in values for v in (p if isinstance(p, list) else (p,))}
    sizes = {len(p) if isinstance(p, list) else -1 for p in values}
    # Beside a fraction numpy makes floats of whole numbers, which do not hold them from here on.
    rounded = {int, float} <= kinds and any(
        type(v) is int and abs(v) > _EXACT for p in values for v in (p if isinstance(p, list) else (p,))
    )
    if not rounded and len(sizes) == 1 and kinds and (kinds <= {int, float, bool} or (kinds == {str} and sizes == {-1})):
        out = np.array(values)
        # Whole numbers that no type of numpy holds would become floats.
        if out.dtype.kind != "f" or float in kinds:
            return out
    out = np.empty(len(values), object)
    for i, value in enumerate(values):
        out[i] = value
    return out


def plain(value: Any) -> Any:
    """A value without protobuf's own types, times as ns."""
    if isinstance(value, (int, float, bool, str, bytes, Mapping)) or value is None:
        return value
    if hasattr(value, "DESCRIPTOR"):
        if value.DESCRIPTOR.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
            return value.seconds * 1_000_000_000 + value.nanos
        return value
    # Repeated fields are sequences without being lists; anything else stays as it is.
    return [plain(v) for v in value] if hasattr(value, "__len__") else value
