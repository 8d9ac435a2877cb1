"""``TrocarError``: a refusal as the host says it, with code, reason, sentence and values.

Invariant: whatever a call ends in, the caller gets one of these; nothing of grpc reaches the user.
"""

from __future__ import annotations

import os
import traceback
from typing import Any

import grpc

from . import _proto

_Status = _proto.message("trocar.status.Status")
_DETAILS = {
    "google.rpc.ErrorInfo": _proto.message("trocar.status.ErrorInfo"),
    "google.rpc.BadRequest": _proto.message("trocar.status.BadRequest"),
    "google.rpc.Help": _proto.message("trocar.status.Help"),
}


class TrocarError(Exception):
    """A request that was refused or failed.

    ``code`` is the gRPC code (``"INVALID_ARGUMENT"``), ``reason`` the row of docs/errors.md (``"ARGUMENT_INVALID"``),
    ``sentence`` what was asked, what is wrong and what exists, ``metadata`` the values in it, ``violations`` the fields
    to blame as ``(field, what)``, ``help`` what to do.
    """

    def __init__(
        self,
        code: str,
        reason: str,
        sentence: str,
        metadata: dict[str, str] | None = None,
        violations: list[tuple[str, str]] | None = None,
        help: str = "",
    ) -> None:
        super().__init__(code, reason, sentence)
        self.code = code
        self.reason = reason
        self.sentence = sentence
        self.metadata = metadata or {}
        self.violations = violations or []
        self.help = help

    def __str__(self) -> str:
        return f"{self.code} [{self.reason}] {self.sentence}"

    def _render_traceback_(self) -> list[str]:
        """What IPython shows: the caller's own lines, not those of this package; for a line typed at the prompt the refusal alone."""
        package = os.path.dirname(os.path.abspath(__file__))
        frames = [f for f in traceback.extract_tb(self.__traceback__) if not os.path.abspath(f.filename).startswith(package)]
        own = [f for f in frames if f"{os.sep}IPython{os.sep}" not in f.filename]
        shown = [] if len(own) == 1 and own[0].lineno == 1 else traceback.format_list(own)
        said = [f"TrocarError: {self}", *([f"  {self.help}"] if self.help else [])]
        return [*"".join(shown).splitlines(), *said]

    def __reduce__(self) -> Any:
        return (type(self), (self.code, self.reason, self.sentence, self.metadata, self.violations, self.help))


def invalid(sentence: str, reason: str = "ARGUMENT_INVALID", **metadata: str) -> TrocarError:
    """A refusal that needs no question to the host."""
    return TrocarError("INVALID_ARGUMENT", reason, sentence, metadata)


def from_rpc(error: Any, what: str, address: str) -> TrocarError:
    """What a failed call says. ``what`` was asked, e.g. ``"InteractService/Invoke"``."""
    code = error.code() if hasattr(error, "code") else grpc.StatusCode.UNKNOWN
    name = code.name if code is not None else "UNKNOWN"
    sentence = (error.details() if hasattr(error, "details") else "") or str(error)
    packed = _details(error)
    if packed is not None:
        found: dict[str, list[Any]] = {kind: [] for kind in _DETAILS}
        for detail in packed.details:
            kind = detail.type_url.rpartition("/")[2]
            if kind in _DETAILS:
                found[kind].append(_DETAILS[kind].FromString(detail.value))
        infos = found["google.rpc.ErrorInfo"]
        if infos:
            violations = [(v.field, v.description) for b in found["google.rpc.BadRequest"] for v in b.field_violations]
            links = [link.description or link.url for h in found["google.rpc.Help"] for link in h.links]
            return TrocarError(
                name,
                infos[0].reason,
                packed.message or sentence,
                dict(infos[0].metadata),
                violations,
                "; ".join(links),
            )
    if name == "UNAVAILABLE":
        hint = 'start one (`trocar demo`, `trocar run FILE`, `trocar host`), or name its address: trocar.connect("HOST:PORT") or TROCAR_GCM'
        return TrocarError(name, "GCM_UNREACHABLE", f"no GCM answers at {address}: {hint} ({sentence})")
    if name == "UNIMPLEMENTED":
        return TrocarError(name, "NOT_IMPLEMENTED", f"the GCM at {address} does not know {what} ({sentence})")
    if name == "DEADLINE_EXCEEDED":
        return TrocarError(name, "DEADLINE", f"{what}: no answer in time from {address}; it may still be carried out")
    if name == "CANCELLED":
        return TrocarError(name, "CANCELLED", f"{what} was broken off: the session is closed")
    return TrocarError(name, "OTHER", f"{what}: {sentence}")


def _details(error: Any) -> Any:
    for item in (error.trailing_metadata() or ()) if hasattr(error, "trailing_metadata") else ():
        if item[0] == "grpc-status-details-bin":
            try:
                return _Status.FromString(item[1])
            except Exception:  # What cannot be read is told without its details.
                return None
    return None
