"""This process's place in the graph: joined as a guest, with a required interface for each provided one that is used.

Invariant: the place lasts as long as the Join stream; after a loss it is taken anew with the same interfaces, and that is said.
"""

from __future__ import annotations

import os
import platform
import threading
from typing import Any

import grpc

from . import _proto
from ._errors import TrocarError

_Join = _proto.message("JoinRequest")
_Require = _proto.message("RequireRequest")


class Place:
    """Process and component under which the graph shows this session."""

    def __init__(self, session: Any, name: str) -> None:
        self._session, self._name = session, name
        self.process = ""
        self.component = ""
        self.refused: TrocarError | None = None
        self._call: Any = None
        self._lock = threading.Lock()
        self._interfaces: list[Any] = []
        self._term = 0

    def join(self, patience: float = 5.0) -> None:
        """Takes the place; a GCM that knows no guests leaves the session without one."""
        request = _Join(
            process=self._name,
            component="shell",
            program=f"Python {platform.python_version()} on {platform.node() or 'an unnamed machine'}",
            pid=os.getpid(),
        )
        call = self._session._wire.stream("GuestService/Join", request)
        timer = threading.Timer(patience, call.cancel)
        timer.daemon = True
        timer.start()
        try:
            given = next(call)
        except StopIteration:
            error = TrocarError("UNAVAILABLE", "GCM_UNREACHABLE", "the GCM gave no place and ended the answer")
            raise error from None
        except grpc.RpcError as e:
            error = self._session._wire.error(e, "GuestService/Join")
            # A person who only looks or operates has no place in the graph.
            if error.code != "UNIMPLEMENTED" and error.reason not in ("ROLE_FORBIDDEN", "FORBIDDEN"):
                raise error from None
            self.refused = error
            return
        finally:
            timer.cancel()
        self.process, self.component, self._term = given.process, given.component, given.term
        self.refused, self._call = None, call
        threading.Thread(target=self._stay, args=(call,), name="trocar-place", daemon=True).start()

    def _stay(self, call: Any) -> None:
        error: TrocarError | None = None
        try:
            for _ in call:
                pass
        except grpc.RpcError as e:
            error = self._session._wire.error(e, "GuestService/Join")
        session = self._session
        if session.closed or call is not self._call:
            return
        former, wait = self.component, 0.05
        self.process = self.component = ""
        while not session._closing.wait(wait):
            wait = min(wait * 2, 1.0)
            try:
                self.join()
            except TrocarError as e:
                if e.code in ("UNAVAILABLE", "DEADLINE_EXCEEDED", "CANCELLED", "UNKNOWN", "INTERNAL"):
                    continue
                session._say(f"no place in the graph any more: {e}")
                return
            if self.component:
                self._again(former, error)
            return

    def _again(self, former: str, _: TrocarError | None) -> None:
        """Requires anew what was required before; a component that comes back later is waited for."""
        left = list(self._interfaces)
        done, wait = 0, 0.05
        while left and not self._session._closing.is_set():
            still = []
            for interface in left:
                try:
                    self._require(interface)
                    done += 1
                except TrocarError as e:
                    if e.code in ("INVALID_ARGUMENT", "FAILED_PRECONDITION", "UNIMPLEMENTED"):
                        self._session._say(f"{interface._path} is not connected again: {e}")
                    else:
                        still.append(interface)
                        last = e
            if still and wait >= 1.6:
                for interface in still:
                    self._session._say(f"{interface._path} is not back yet ({last.reason}); it is connected when it is")
                wait = 1.0
                left = still
                threading.Thread(target=self._later, args=(left,), name="trocar-require", daemon=True).start()
                break
            left = still
            if left:
                self._session._closing.wait(wait)
                wait *= 2
        renamed = f" instead of {former}" if former and former != self.component else ""
        self._session._say(f"joined again as {self.component}{renamed}, {done} of {len(self._interfaces)} connected again")

    def _later(self, left: list[Any]) -> None:
        place = self.component
        while left and self.component == place and not self._session._closing.wait(1.0):
            for interface in list(left):
                try:
                    self._require(interface)
                except TrocarError:
                    continue
                left.remove(interface)
                self._session._say(f"{interface._path} is connected again")

    def _require(self, interface: Any) -> None:
        name = interface._client.rpartition("/")[2]
        answer = self.require(interface._path, name)
        interface.__dict__.update(_client=answer.client, _connection=answer.connection)
        interface._adopt(answer.provided)

    def require(self, server: str, name: str, timeout: float = 5.0) -> Any:
        """Adds a required interface and connects it."""
        request = _Require(component=self.component, name=name, server=server)
        return self._session._wire.call("GuestService/Require", request, timeout)

    def keep(self, interface: Any) -> None:
        """Requires this interface again whenever the place is taken anew."""
        with self._lock:
            self._interfaces.append(interface)

    def forget(self, connection: int) -> None:
        """It was disconnected on purpose."""
        with self._lock:
            self._interfaces = [i for i in self._interfaces if i._connection != connection]

    def leave(self) -> None:
        """Gives the place up; it disappears from the graph with its connections."""
        call, self._call = self._call, None
        if call is not None:
            call.cancel()
