"""The system as it is: processes, components and connections by Watch, what each offers by Describe, kept until it changes.

Invariant: the copy is replaced by each snapshot and changed by each delta, from where the one before ended; nothing here asks twice
what did not change.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import grpc

from . import _proto
from ._errors import TrocarError

_Watch = _proto.message("WatchRequest")
_Describe = _proto.message("DescribeRequest")


class Graph:
    """Follows the system in a thread; ``news(kind, text)`` hears of the GCM lost (``"gone"``) and found (``"back"``)."""

    def __init__(self, wire: Any, news: Callable[[str, TrocarError | None], None]) -> None:
        self._wire, self._news = wire, news
        self._lock = threading.Condition()
        self.processes: dict[str, Any] = {}
        self.components: dict[str, Any] = {}
        self.connections: dict[int, Any] = {}
        self.revision = 0
        self.term = 0
        self.connected = False
        self.changes = 0
        self._described: dict[str, Any] = {}
        self._cursor = ""
        self._closing = threading.Event()
        self._call: Any = None

    def open(self, patience: float) -> None:
        """Waits for the first snapshot, ``patience`` seconds at most."""
        self._call = self._wire.stream("GcmService/Watch", _Watch())
        timer = threading.Timer(patience, self._call.cancel)
        timer.daemon = True
        timer.start()
        try:
            self._take(next(self._call))
        except grpc.RpcError as e:
            error = self._wire.error(e, "GcmService/Watch")
            if error.code == "CANCELLED":
                error = TrocarError("DEADLINE_EXCEEDED", "DEADLINE", f"{self._wire.address} did not answer within {patience} s")
            raise error from None
        finally:
            timer.cancel()
        self.connected = True
        # A GCM that hangs does not end its stream.
        self._wire.moved = lambda: self._call.cancel()
        threading.Thread(target=self._run, name="trocar-graph", daemon=True).start()

    def _run(self) -> None:
        wait = 0.05
        while not self._closing.is_set():
            error = None
            try:
                for message in self._call:
                    self._take(message)
                    if not self.connected:
                        self.connected, wait = True, 0.05
                        self._news("back", None)
            except grpc.RpcError as e:
                error = self._wire.error(e, "GcmService/Watch")
            if self._closing.is_set():
                return
            if self.connected:
                self.connected = False
                self._news("gone", error)
            self._closing.wait(wait)
            wait = min(wait * 2, 0.5)
            # Another GCM may lead by now.
            self._wire.look(0.0)
            try:
                self._call = self._wire.stream("GcmService/Watch", _Watch(after=self._cursor))
            except TrocarError:
                return

    def _take(self, message: Any) -> None:
        kind = message.WhichOneof("news")
        with self._lock:
            if kind == "snapshot":
                self.processes = {p.name: p for p in message.snapshot.processes}
                self.components = {c.path: c for c in message.snapshot.components}
                self.connections = {c.id: c for c in message.snapshot.connections}
                self._described.clear()
            elif kind == "delta":
                d = message.delta
                self.processes.update((p.name, p) for p in d.processes)
                self.components.update((c.path, c) for c in d.components)
                self.connections.update((c.id, c) for c in d.connections)
                for name in d.removed_processes:
                    self.processes.pop(name, None)
                for path in d.removed_components:
                    self.components.pop(path, None)
                for number in d.removed_connections:
                    self.connections.pop(number, None)
                for path in [*(c.path for c in d.components), *d.removed_components]:
                    self._described.pop(path, None)
            self.revision, self.term, self._cursor = message.revision, message.term, message.cursor
            self.changes += 1
            self._lock.notify_all()

    def wait(self, what: Callable[[], Any], timeout: float) -> Any:
        """Until ``what()`` of this copy is true."""
        with self._lock:
            return self._lock.wait_for(what, timeout)

    def describe(self, path: str, timeout: float = 2.0) -> Any:
        """What a component is and offers; asked once, until it changes."""
        with self._lock:
            found = self._described.get(path)
            before = self.changes
        if found is None:
            found = self._wire.call("GcmService/Describe", _Describe(path=path), timeout)
            with self._lock:
                if self.changes == before and self.connected:
                    self._described[path] = found
        return found

    def close(self) -> None:
        """Ends the thread."""
        self._closing.set()
        if self._call is not None:
            self._call.cancel()
