"""Following events, outputs and states: a reader that never waits, a bounded queue, and a thread for the handler.

Invariant: a handler that stalls stalls nobody: when its queue is full the oldest item goes, and is counted in ``skipped``.
"""

from __future__ import annotations

import collections
import inspect
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import grpc

from . import _proto, _values
from ._errors import TrocarError

_STATE = 1
_QUIET_S = 10.0
DEPTH = 1024
"""Items that may wait for a handler."""


class Item(NamedTuple):
    """What came with a value: where from, when it was made (ns of the host's monotonic clock), its number, and how many were lost
    between the item before and this one.
    """

    path: str
    value: Any
    stamp_ns: int
    seq: int
    skipped: int
    jpeg: bytes


class Follower:
    """One path that is followed. As a decorator's result it can still be called like the function it decorates.

    ``received`` counts items, ``skipped`` those lost on the way or to a full queue, ``errors`` handlers that raised (shown on stderr,
    once in ten seconds at most), ``breaks`` how often the stream broke and was taken up again (what was sent meanwhile is not known).
    ``close()`` ends it.
    """

    def __init__(
        self,
        session: Any,
        path: str,
        kind: Any,
        handler: Callable[..., Any] | None,
        depth: int = DEPTH,
        max_rate_hz: float = 0.0,
        thumbnail_width: int = 0,
    ) -> None:
        self.path = path
        self.received = 0
        self.skipped = 0
        self.errors = 0
        self.breaks = 0
        self.ended: TrocarError | None = None
        self._session = session
        self._type, self._unit = kind
        if handler is not None and not callable(handler):
            raise TypeError(f"{path}: a handler is a function; {handler!r} is not")
        self._handler = handler
        self._takes = _arguments(handler) if handler is not None else 0
        self._items: collections.deque[Item] = collections.deque()
        self._depth = max(1, int(depth))
        self._ready = threading.Condition()
        self._closed = False
        selection = _proto.message("Selection")
        self._selections = [selection(path=path, max_rate_hz=max_rate_hz, thumbnail_width=thumbnail_width)]
        self._wanted = path.count("/") == 1
        if not self._wanted:
            self._selections.append(selection(path="/".join(path.split("/")[:2])))
        self._call = self._open(session.deadline)
        name = path.rpartition("/")[2]
        threading.Thread(target=self._read, name=f"trocar-read-{name}", daemon=True).start()
        if handler is not None:
            threading.Thread(target=self._handle, name=f"trocar-handle-{name}", daemon=True).start()

    def _open(self, patience: float) -> Any:
        """Followed from here on: the component's state is sent at once, so whatever is sent after that item is not missed."""
        call = self._session._wire.stream("InteractService/Subscribe", _proto.message("SubscribeRequest")(selections=self._selections))
        timer = threading.Timer(max(patience, 1.0) + 1.0, call.cancel)
        timer.daemon = True
        timer.start()
        try:
            first = next(call)
        except StopIteration:
            raise TrocarError("UNAVAILABLE", "PEER_LOST", f"{self.path} is not sent any more") from None
        except grpc.RpcError as e:
            raise self._session._wire.error(e, "InteractService/Subscribe") from None
        finally:
            timer.cancel()
        self._put(first)
        return call

    def _read(self) -> None:
        while not self._closed:
            try:
                for item in self._call:
                    self._put(item)
                    if self.ended:
                        self._call.cancel()
                        return
            except grpc.RpcError as e:
                error = self._session._wire.error(e, "InteractService/Subscribe")
            else:
                error = TrocarError("UNAVAILABLE", "PEER_LOST", f"{self.path} is not sent any more")
            if self._closed:
                return
            if not self._again(error):
                return

    def _again(self, error: TrocarError) -> bool:
        """Takes the stream up again, as long as the session lives and the path may come back."""
        wait, told = 0.05, False
        while not self._closed and not self._session.closed:
            if error.code not in ("UNAVAILABLE", "CANCELLED", "DEADLINE_EXCEEDED", "UNKNOWN", "NOT_FOUND", "INTERNAL"):
                break
            if error.code == "NOT_FOUND" and not told:
                told = True
                self._session._say(f"{self.path} is gone; it is followed again when it is back ({error.reason})")
            if self._session._closing.wait(wait):
                break
            wait = min(wait * 2, 1.0)
            try:
                self._call = self._open(5.0)
            except TrocarError as e:
                error = e
                continue
            self.breaks += 1
            if told:
                self._session._say(f"{self.path} is back and followed again")
            return True
        self._end(error)
        return False

    def _end(self, error: TrocarError) -> None:
        self.ended = error
        with self._ready:
            self._ready.notify_all()

    def _put(self, item: Any) -> None:
        if item.kind == _STATE and not self._wanted:
            return
        try:
            value = _values.from_json(self._type, _values.plain(item.json), self._unit)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as e:
            why = f"{self.path} sends something else than when it was followed ({type(e).__name__}: {e}): follow it again"
            self._end(TrocarError("FAILED_PRECONDITION", "TYPE_MISMATCH", why))
            return
        with self._ready:
            lost = int(item.skipped)
            if len(self._items) >= self._depth:
                oldest = self._items.popleft()
                lost_here = 1 + oldest.skipped
                # What was lost before the oldest is now lost before its successor.
                if self._items:
                    self._items[0] = self._items[0]._replace(skipped=self._items[0].skipped + lost_here)
                else:
                    lost += lost_here
                self.skipped += 1
            self.skipped += int(item.skipped)
            self.received += 1
            self._items.append(Item(item.path, value, item.stamp_ns, item.seq, lost, item.jpeg))
            self._ready.notify()

    def _take(self, timeout: float | None) -> Item | None:
        with self._ready:
            self._ready.wait_for(lambda: self._items or self._closed or self.ended, timeout)
            return self._items.popleft() if self._items else None

    def _handle(self) -> None:
        told_at, told = -_QUIET_S, 0
        while True:
            item = self._take(None)
            if item is None:
                return
            arguments = [item.value, item][: self._takes]
            try:
                self(*arguments)
            except Exception:
                self.errors += 1
                # One that raises at each of a thousand events a second is told of now and then.
                if time.monotonic() - told_at < _QUIET_S:
                    continue
                before = f", {self.errors - told - 1} times since the last one shown" if self.errors > told + 1 else ""
                told_at, told = time.monotonic(), self.errors
                try:
                    sys.stderr.write(f"trocar: the handler of {self.path} raised{before}:\n{traceback.format_exc()}")
                except (OSError, ValueError):  # Nobody reads stderr any more; the count tells it all the same.
                    pass

    @property
    def waiting(self) -> int:
        """Items that wait for the handler."""
        return len(self._items)

    def next(self, timeout: float = 1.0) -> Item:
        """The next item, where no handler takes them; ``timeout`` seconds at most."""
        item = self._take(timeout)
        if item is None:
            raise self.ended or TrocarError("DEADLINE_EXCEEDED", "NO_SAMPLE", f"{self.path}: nothing came within {timeout} s")
        return item

    def __iter__(self) -> Iterator[Item]:
        while True:
            item = self._take(None)
            if item is None:
                return
            yield item

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Calls the decorated function itself."""
        if self._handler is None:
            raise TypeError(f"{self.path} is followed without a handler")
        return self._handler(*args, **kwargs)

    def close(self) -> None:
        """Ends it; what still waits is not handled any more."""
        self._closed = True
        self._call.cancel()
        with self._ready:
            self._items.clear()
            self._ready.notify_all()
        self._session._followers.discard(self)

    def __enter__(self) -> Follower:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self._closed else f"ended: {self.ended}" if self.ended else "open"
        return (
            f"<follows {self.path}, {state}: {self.received} received, {self.skipped} skipped, {self.waiting} waiting, "
            f"{self.errors} errors>"
        )


def _arguments(handler: Callable[..., Any]) -> int:
    """How many of (value, item) a handler takes."""
    try:
        parameters = inspect.signature(handler).parameters.values()
    except (TypeError, ValueError):
        return 1
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        return 2
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return min(2, sum(p.kind in kinds for p in parameters))
