"""Packages that only some need, choices, and what is said of values that were taken out of a recording."""

from __future__ import annotations

import warnings
from typing import Any

from ._errors import TrocarError, invalid
from ._paths import nearest


class RecordingNote(UserWarning):
    """A warning about values that were taken out of a recording: some are missing, or out of order."""


def said(notes: list[str], deep: int = 3) -> None:
    """Warns of each, once for a line of the caller."""
    for note in notes:
        warnings.warn(note, RecordingNote, stacklevel=deep)


def pandas() -> Any:
    """The package, or how to get it."""
    try:
        import pandas as pd
    except ImportError:
        raise TrocarError("FAILED_PRECONDITION", "NOT_INSTALLED", "tables need pandas: pip install pandas") from None
    return pd


def chosen(value: Any, what: str, of: tuple[str, ...]) -> None:
    """Refuses what is none of these words."""
    if value not in of:
        raise invalid(f"{what} is {value!r}; it is one of {', '.join(map(repr, of))}{nearest(str(value), of)}", field=what)
