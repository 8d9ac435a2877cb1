"""The channels to the GCM: unary calls with deadlines, streams, and nothing of grpc beyond this file's callers.

Invariant: every unary call has a deadline; a refusal becomes a ``TrocarError`` here and nowhere else. Calls have a
connection of their own, so that no number of streams keeps them waiting; a Stop goes by the socket for Stop alone where it is
there.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import queue
import re
import threading
import time
from collections.abc import Callable
from typing import Any

import grpc

from . import _proto
from ._door import stop_doors
from ._errors import TrocarError, from_rpc, invalid

LARGEST = 256 << 20
"""Bytes of the largest answer taken: a frame in full size."""

_OPTIONS = [
    ("grpc.max_receive_message_length", LARGEST),
    ("grpc.max_send_message_length", 16 << 20),
    # A GCM that comes back is found again soon, not after the minute gRPC would let pass.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
    # In spite of its name the time one attempt may take: a busy machine answers late.
    ("grpc.min_reconnect_backoff_ms", 5000),
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.enable_http_proxy", 0),
]


ANSWERS = 1.0
"""Time that each of several GCMs has to say whether it leads, s."""
MOST = 16
"""GCMs that are asked in one search, those that others name, too."""

STREAMS = 100
"""Streams one connection carries. A host takes 256; the rest of them would wait unseen."""


def shown(identity: Any) -> Any:
    """grpc's credentials of the identity in this file, which `trocar ca issue` made."""
    remedy = "name the file of yours: identity=FILE or TROCAR_IDENTITY; `trocar ca issue` makes one"
    if identity is None:
        raise invalid(f"a certificate is asked for there: {remedy}", field="identity")
    try:
        with open(identity, "rb") as file:
            mode, whole = os.fstat(file.fileno()).st_mode, file.read()
    except OSError as e:
        raise invalid(f"{identity} cannot be read ({e.strerror}): {remedy}", field="identity") from e
    if mode & 0o077:
        raise invalid(f"{identity} holds a key, and others may read or change it: `chmod 600 {identity}`", field="identity")
    blocks = re.findall(rb"-----BEGIN ([A-Z ]+)-----.*?-----END \1-----\s*", whole, re.S)
    certificates = re.findall(rb"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----\s*", whole, re.S)
    if b"PRIVATE KEY" not in blocks or len(certificates) < 2:
        raise invalid(f"{identity} is no identity, which has a key, a certificate and that of its authority: {remedy}", field="identity")
    return grpc.ssl_channel_credentials(b"".join(certificates[1:]), whole, certificates[0])


class Wire:
    """The way to one GCM, or to the one that leads among several. ``address`` is ``host:port``, or those of all with commas
    between them; ``https://`` in front of one says that both sides show certificates there. ``identity`` is the file of ours,
    ``credentials`` are grpc's channel credentials instead; neither = plain text.

    With ``TROCAR_TOKEN`` in the environment each request carries that token: another user's, who gave it (`trocar token`).
    """

    def __init__(
        self,
        address: str,
        credentials: Any = None,
        options: list[tuple[str, Any]] | None = None,
        identity: str | os.PathLike[str] | None = None,
    ) -> None:
        self._among = [one.strip() for one in address.split(",") if one.strip()] or [address]
        self.address = self._among[0]
        self.moved: Callable[[], None] = lambda: None
        """Called when another GCM leads than before."""
        self._looking = threading.Lock()
        self._credentials = credentials
        self._identity = identity or os.environ.get("TROCAR_IDENTITY", "").strip() or None
        self._merged = [*_OPTIONS, *(options or [])]
        token = os.environ.get("TROCAR_TOKEN", "").strip()
        self._metadata = (("authorization", f"Bearer {token}"),) if token else None
        self.channel = self._channel(self.address)
        self._unary: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._carriers: list[_Carrier] = []
        self.closed = False

    def _channel(self, address: str) -> Any:
        # Channels that may share a connection would.
        options = [*self._merged, ("grpc.use_local_subchannel_pool", 1)]
        bare = address.removeprefix("https://")
        if bare != address:
            # Nobody but a GCM has a certificate of that name.
            return grpc.secure_channel(bare, shown(self._identity), [*options, ("grpc.ssl_target_name_override", "gcm.trocar")])
        if self._credentials is None:
            return grpc.insecure_channel(address, options)
        return grpc.secure_channel(address, self._credentials, options)

    def look(self, patience: float) -> bool:
        """Looks for the GCM that leads among several, once and then ``patience`` seconds more; answers whether it is another one
        than before.
        """
        if len(self._among) < 2:
            return False
        with self._looking:
            until = time.monotonic() + patience
            found = self._leader()
            while found is None and not self.closed and time.monotonic() < until:
                time.sleep(0.1)
                found = self._leader()
            if found is None or found == self.address or self.closed:
                return False
            with self._lock:
                # Streams of the GCM before end by themselves.
                before, self.channel, self.address = self.channel, self._channel(found), found
                self._unary, self._carriers = {}, []
        before.close()
        self.moved()
        return True

    def _leader(self) -> str | None:
        """The address of the GCM that leads."""
        # One that hangs is asked after the others.
        queue = [*(one for one in self._among if one != self.address), self.address]
        asked: set[str] = set()
        while queue and len(asked) < MOST:
            address = queue.pop(0)
            if address in asked:
                continue
            asked.add(address)
            channel = self._channel(address)
            try:
                _unary(channel, "AttachService/Tell")(_proto.message("TellRequest")(), timeout=ANSWERS, metadata=self._metadata)
                return address
            except grpc.RpcError as e:
                error = from_rpc(e, "AttachService/Tell", address)
            finally:
                channel.close()
            if error.code == "UNIMPLEMENTED":
                return address
            leader = error.metadata.get("leader", "") if error.reason == "NOT_LEADER" else ""
            # One that shows certificates leads nobody to where none are shown.
            if leader and leader.startswith("https://") >= address.startswith("https://"):
                queue.insert(0, leader)
        return None

    def _unary_of(self, name: str) -> Any:
        found = self._unary.get(name)
        if found is None:
            with self._lock:
                found = self._unary[name] = _unary(self.channel, name)
        return found

    def call(self, name: str, request: Any, timeout: float) -> Any:
        """Asks and waits, ``timeout`` seconds at most."""
        __tracebackhide__ = True
        try:
            return self._unary_of(name)(request, timeout=timeout, metadata=self._metadata)
        except (grpc.RpcError, ValueError) as e:
            error = self.error(e, name)
        # A GCM that does not lead has done nothing. What became of a call that had no answer is not known.
        if error.reason in ("GCM_UNREACHABLE", "DEADLINE"):
            self.look(0.0)
        if error.reason == "NOT_LEADER" and self.look(timeout):
            try:
                return self._unary_of(name)(request, timeout=timeout, metadata=self._metadata)
            except (grpc.RpcError, ValueError) as e:
                error = self.error(e, name)
        raise error

    def stop(self, request: Any, timeout: float) -> Any:
        """Asks for a Stop: by the socket that a host of this user has for that alone, so that it waits for nobody's
        calls and connections; where there is none, as every call. Several GCMs are asked side by side: one that doubts its lead
        stops what it still reaches. The answer of the one that leads counts, then a refusal, then the answer of one that doubts.
        """
        __tracebackhide__ = True
        if len(self._among) < 2 or self.closed:
            return self._stop_at(self.address, request, timeout)
        answers: queue.Queue[Any] = queue.Queue()

        def ask(address: str) -> None:
            try:
                answers.put(self._stop_at(address, request, timeout))
            except TrocarError as error:
                answers.put(error)

        for address in self._among:
            threading.Thread(target=ask, args=(address,), name="trocar-stop", daemon=True).start()
        doubted, refused, absent = None, None, None
        for _ in self._among:
            answer = answers.get()
            if not isinstance(answer, TrocarError):
                if not answer.doubted:
                    return answer
                doubted = answer
            elif answer.reason in ("NOT_LEADER", "GCM_UNREACHABLE", "DEADLINE"):
                absent = answer
            else:
                refused = answer
        if refused is None and doubted is not None:
            return doubted
        raise refused or absent

    def _stop_at(self, address: str, request: Any, timeout: float) -> Any:
        __tracebackhide__ = True
        name = "GcmService/Stop"
        # A path would be no name of a host.
        options = [*self._merged, ("grpc.use_local_subchannel_pool", 1), ("grpc.default_authority", "localhost")]
        for path in stop_doors(address) if self._credentials is None and not address.startswith("https://") and not self.closed else ():
            channel = grpc.insecure_channel(f"unix:{path}", options)
            try:
                return _unary(channel, name)(request, timeout=timeout, metadata=self._metadata)
            except grpc.RpcError as e:
                error = self.error(e, name)
            finally:
                channel.close()
            # A socket that a killed host left refuses at once.
            if error.reason != "GCM_UNREACHABLE":
                raise error
        if len(self._among) < 2:
            return self.call(name, request, timeout)
        channel = self._channel(address)
        try:
            return _unary(channel, name)(request, timeout=timeout, metadata=self._metadata)
        except grpc.RpcError as e:
            error = from_rpc(e, name, address)
        finally:
            channel.close()
        raise error

    def begin(self, name: str, request: Any, timeout: float) -> Any:
        """Asks and hands back grpc's future."""
        try:
            return self._unary_of(name).future(request, timeout=timeout, metadata=self._metadata)
        except ValueError as e:
            raise self.error(e, name) from None

    async def acall(self, name: str, request: Any, timeout: float) -> Any:
        """Asks and awaits the answer, on the loop of asyncio that runs; cancelled, it cancels the call."""
        loop = asyncio.get_running_loop()
        done: asyncio.Future[Any] = loop.create_future()
        asked = self.begin(name, request, timeout)

        def wake() -> None:
            if not done.done():
                done.set_result(None)

        def tell(_: Any) -> None:
            # An answer that comes when the loop is closed is waited for by nobody.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(wake)

        asked.add_done_callback(tell)
        try:
            await done
        except asyncio.CancelledError:
            asked.cancel()
            raise
        try:
            return asked.result()
        except (grpc.RpcError, grpc.FutureCancelledError) as e:
            error = self.error(e, name)
        raise error

    def stream(self, name: str, request: Any) -> Any:
        """Opens a stream of answers; ends only with it or with the channel."""
        m = _proto.METHODS[name]
        carrier = self._carrier()
        try:
            opened = carrier.channel.unary_stream(
                m.path, request_serializer=m.request.SerializeToString, response_deserializer=m.response.FromString
            )(request, metadata=self._metadata)
        except ValueError as e:
            self._left(carrier)
            raise self.error(e, name) from None
        if not opened.add_callback(lambda: self._left(carrier)):
            # The stream has ended already.
            self._left(carrier)
        return opened

    def _carrier(self) -> _Carrier:
        """A connection with room for one more stream."""
        with self._lock:
            if self.closed:
                raise self.error(ValueError(), "stream")
            found = next((c for c in self._carriers if c.streams < STREAMS), None)
            if found is None:
                found = _Carrier(self._channel(self.address))
                self._carriers.append(found)
            found.streams += 1
            return found

    def _left(self, carrier: _Carrier) -> None:
        with self._lock:
            carrier.streams -= 1

    def error(self, e: Any, name: str) -> TrocarError:
        """What a failure of grpc means."""
        if isinstance(e, ValueError):
            if self.closed:
                return TrocarError("CANCELLED", "CLOSED", f"this session with {self.address} was closed; connect again")
            return TrocarError("INVALID_ARGUMENT", "ARGUMENT_INVALID", f"{name}: {e}")
        return from_rpc(e, name, self.address)

    def close(self) -> None:
        """Ends every call and stream."""
        with self._lock:
            self.closed = True
            carriers = list(self._carriers)
        self.channel.close()
        for carrier in carriers:
            carrier.channel.close()


def _unary(channel: Any, name: str) -> Any:
    m = _proto.METHODS[name]
    return channel.unary_unary(m.path, request_serializer=m.request.SerializeToString, response_deserializer=m.response.FromString)


class _Carrier:
    """A connection for streams, and how many it carries."""

    def __init__(self, channel: Any) -> None:
        self.channel = channel
        self.streams = 0
