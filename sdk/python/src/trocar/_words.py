"""Words for numbers of things."""

from __future__ import annotations


def counted(n: int, one: str) -> str:
    """``1 topic``, ``2 topics``, ``3 processes``."""
    more = "es" if one.endswith("s") else "s"
    return f"{n} {one}{'' if n == 1 else more}"
