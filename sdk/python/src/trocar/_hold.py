"""A component that ends with this process, whatever ends the process.

Invariant: it is held before it is created; a GCM that comes back is told of it again.
"""

from __future__ import annotations

import threading
from typing import Any

import grpc

from . import _proto
from ._errors import TrocarError

_Request = _proto.message("HoldRequest")
_AGAIN_S = 0.2


class Hold:
    """Ties ``component``, which is created after this, to the life of this process. A GCM that knows no Hold leaves it without."""

    def __init__(self, session: Any, component: str, patience: float = 5.0) -> None:
        self._session, self.component = session, component
        self._over = threading.Event()
        self._call: Any = None
        try:
            call = self._ask(patience)
        except TrocarError as e:
            if e.code != "UNIMPLEMENTED":
                raise
            return
        threading.Thread(target=self._stay, args=(call,), name="trocar-hold", daemon=True).start()

    def _ask(self, patience: float) -> Any:
        self._call = call = self._session._wire.stream("GuestService/Hold", _Request(component=self.component))
        timer = threading.Timer(patience, call.cancel)
        timer.daemon = True
        timer.start()
        try:
            next(call)
        except StopIteration:
            error = TrocarError("UNAVAILABLE", "GCM_UNREACHABLE", f"the GCM does not hold {self.component}, and ended the answer")
        except grpc.RpcError as e:
            error = self._session._wire.error(e, "GuestService/Hold")
        else:
            return call
        finally:
            timer.cancel()
        raise error from None

    def _stay(self, call: Any) -> None:
        while not self._is_over():
            try:
                for _ in call:
                    pass
                # Ended in order: there is nothing to be held any more.
                return
            except grpc.RpcError:
                call = None
            while call is None and not self._over.wait(_AGAIN_S) and not self._session.closed:
                try:
                    call = self._ask(5.0)
                except TrocarError:
                    continue
        # Asked for while it ended.
        if call is not None:
            call.cancel()

    def _is_over(self) -> bool:
        return self._over.is_set() or self._session.closed

    def end(self) -> None:
        """Holds it no more: a component that is still there is removed by that."""
        self._over.set()
        if self._call is not None:
            self._call.cancel()
