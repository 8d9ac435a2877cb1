"""Messages in the chunks of an MCAP file, and between them, read one chunk at a time.

Invariant: no more than one chunk is in memory; of one that is damaged nothing is given, and ``problems`` says so.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from collections.abc import Iterator
from typing import Any, NamedTuple

from ._errors import TrocarError
from ._summary import CHANNEL, HEAD, SCHEMA, Part, Summary, inside

MESSAGE = 5
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
# A chunk that says more than this of itself is not read, B. It is held packed and unpacked at once, beside
# what is made of it, and a machine of a lab has 8 GiB; recorders write chunks of some MB, or of one frame.
_LARGEST = 1 << 30


class Message(NamedTuple):
    """One message as it is in the file; ``place`` finds it again."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes
    place: tuple[int, int]


class Damaged(Exception):
    """A part of the file that cannot be read, and why."""


class Chunks:
    """The part of an open file that reads its messages."""

    _fd: int
    size: int
    summary: Summary
    problems: list[str]

    def _having(self, channel: int) -> array:
        raise NotImplementedError

    def say(self, problem: str) -> None:
        """Adds what is wrong, once."""
        if problem not in self.problems:
            self.problems.append(problem)

    def messages(self, channels: set[int], bodies: bool = True, since: int = 0, until: int | None = None) -> Iterator[Message]:
        """Messages of these channels in the order of the file, a chunk at a time; without ``bodies`` their times alone. Parts of the file
        that were recorded before ``since`` or after ``until`` are not read.
        """
        numbers = sorted({n for channel in channels for n in self._having(channel)})
        for n in numbers:
            part = self.summary.parts[n]
            if part.index is not None and (part.end < since or (until is not None and part.start > until)):
                continue
            try:
                yield from self._of(n, part, channels, bodies)
            except Damaged as e:
                self.say(str(e))

    def at(self, place: tuple[int, int]) -> Message:
        """The message at a place."""
        n, offset = place
        part = self.summary.parts[n]
        if part.chunk and not self._plain(part):
            data = self._load(part)
            _, length = HEAD.unpack_from(data, offset)
            return _message(data, offset + HEAD.size, offset + HEAD.size + length, place, True)
        return self._direct(offset, n, True)

    def _of(self, n: int, part: Part, channels: set[int], bodies: bool) -> Iterator[Message]:
        if not part.chunk:
            at = part.begin
            while at < part.after:
                message = self._direct(at, n, False)
                if message.channel in channels:
                    yield self._direct(at, n, True) if bodies else message
                at += HEAD.size + HEAD.unpack(self._bytes(at, HEAD.size))[1]
        elif part.index is not None and self._plain(part):
            # Frames from 128 KiB on lie in chunks without a checksum: nothing else of those is read.
            begin = part.begin + HEAD.size + _CHUNK.size + 8
            for time, offset in sorted(self._entries(part, channels), key=lambda entry: entry[1]):
                message = self._direct(begin + offset, n, bodies)
                if message.channel not in channels or message.log_time != time:
                    raise Damaged(f"the index of the chunk at byte {part.begin} is wrong; messages of it are left out")
                yield message
        else:
            data = self._load(part)
            try:
                found = list(messages_in(data, n, None, channels, bodies))
            except struct.error:
                raise Damaged(f"the chunk at byte {part.begin} is damaged; it is left out") from None
            yield from found

    def _entries(self, part: Part, channels: set[int]) -> list[tuple[int, int]]:
        """Times and offsets of messages by the index of their chunk."""
        found: list[tuple[int, int]] = []
        for channel, offset in struct.iter_unpack("<HQ", part.index or b""):
            if channel not in channels:
                continue
            opcode, length = HEAD.unpack(self._bytes(offset, HEAD.size))
            body = self._bytes(offset + HEAD.size, length)
            if opcode != 7 or length < 6 or struct.unpack_from("<HI", body) != (channel, length - 6) or (length - 6) % 16:
                raise Damaged(f"the index of the chunk at byte {part.begin} is wrong; messages of it are left out")
            found += struct.iter_unpack("<QQ", body[6:])
        return found

    def _plain(self, part: Part) -> bool:
        """Whether a chunk is neither compressed nor has a checksum."""
        _, _, _, crc, compression = _CHUNK.unpack(self._bytes(part.begin + HEAD.size, _CHUNK.size))
        return crc == 0 and compression == 0

    def _direct(self, at: int, n: int, bodies: bool) -> Message:
        head = self._bytes(at, HEAD.size + _MESSAGE.size)
        opcode, length = HEAD.unpack_from(head)
        if opcode != MESSAGE or length < _MESSAGE.size:
            raise Damaged(f"there is no message at byte {at}; messages of its chunk are left out")
        data = self._bytes(at + len(head), length - _MESSAGE.size) if bodies else b""
        return Message(*_MESSAGE.unpack_from(head, HEAD.size), data, (n, at))

    def _load(self, part: Part) -> bytes:
        """The records of a chunk, unpacked, where its checksum is theirs."""
        body = part.begin + HEAD.size
        _, _, size, crc, name = _CHUNK.unpack(self._bytes(body, _CHUNK.size))
        compression = self._bytes(body + _CHUNK.size, name).decode("utf-8", "replace")
        (length,) = struct.unpack("<Q", self._bytes(body + _CHUNK.size + name, 8))
        at = body + _CHUNK.size + name + 8
        if at + length > part.begin + part.length or max(size, length) > _LARGEST:
            raise Damaged(f"the chunk at byte {part.begin} has a length that cannot be; it is left out")
        data = self._bytes(at, length)
        if compression:
            data = _unpacked(data, compression, size, part.begin)
        if crc and zlib.crc32(data) != crc:
            raise Damaged(f"the chunk at byte {part.begin} has another checksum than its bytes; it is left out")
        return data

    def _bytes(self, at: int, count: int) -> bytes:
        if self._fd < 0:
            raise TrocarError("FAILED_PRECONDITION", "WRONG_STATE", "the recording is closed; open it again")
        if at < 0 or count > self.size - at:
            raise Damaged(f"it ends before byte {at + count}, where more of it should be")
        got = os.pread(self._fd, count, at)
        while len(got) < count:
            more = os.pread(self._fd, count - len(got), at + len(got))
            if not more:
                raise Damaged(f"it ends before byte {at + count}, where more of it should be")
            got += more
        return got


def messages_in(data: bytes, n: int, define: Any, channels: set[int] | None, bodies: bool) -> Iterator[Message]:
    """The messages of a chunk's records; ``define`` takes its schemas and channels."""
    for opcode, at, end in inside(data):
        if opcode == MESSAGE:
            if channels is None or data[at] | data[at + 1] << 8 in channels:
                yield _message(data, at, end, (n, at - HEAD.size), bodies)
        elif define is not None and opcode in (SCHEMA, CHANNEL):
            define(opcode, data[at:end])


def _message(data: bytes, at: int, end: int, place: tuple[int, int], bodies: bool) -> Message:
    return Message(*_MESSAGE.unpack_from(data, at), data[at + _MESSAGE.size : end] if bodies else b"", place)


def _unpacked(data: bytes, compression: str, size: int, at: int) -> bytes:
    try:
        if compression == "zstd":
            import zstandard

            # `decompress` makes as much as the packed bytes say of themselves, whatever the most is.
            told = zstandard.frame_content_size(data) if size else 0
            if told not in (size, -1):
                raise Damaged(f"the chunk at byte {at} says it has {size} bytes, and its packed bytes {told}; it is left out")
            unpack = zstandard.ZstdDecompressor()
            out = b"" if not size else unpack.decompress(data) if told == size else unpack.stream_reader(data).read(size + 1)
        elif compression == "lz4":
            import lz4.frame

            out = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1) if size else b""
        else:
            raise Damaged(f"the chunk at byte {at} is compressed as {compression!r}, which is not known here; it is left out")
    except ImportError:
        package = "zstandard" if compression == "zstd" else compression
        raise TrocarError("FAILED_PRECONDITION", "NOT_INSTALLED", f"this recording needs {compression}: pip install {package}") from None
    except (RuntimeError, ValueError, MemoryError, EOFError) as e:
        raise Damaged(f"the chunk at byte {at} cannot be unpacked ({shown(e)}); it is left out") from None
    except Exception as e:
        if type(e).__name__ != "ZstdError":
            raise
        raise Damaged(f"the chunk at byte {at} cannot be unpacked ({shown(e)}); it is left out") from None
    if len(out) != size:
        raise Damaged(f"the chunk at byte {at} has {len(out)} bytes where it says {size}; it is left out")
    return out


def shown(e: Exception) -> str:
    """An error of a decoder in few words."""
    return f"{type(e).__name__}: {e}".rstrip(": ")
