"""The index of an MCAP file: its schemas and channels, where its chunks lie, and how many messages there are.

Invariant: an index that does not name all there is of the file by its own counts is none.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import Any

from ._errors import TrocarError

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
SCHEMA, CHANNEL, CHUNK, CRC = 3, 4, 6, 4
_CHUNK_INDEX, _ATTACHMENT_INDEX, _STATISTICS, _METADATA_INDEX = 8, 10, 11, 13


class Part:
    """A chunk, or messages in a row that lie in none. ``index`` has the places of its message indexes by channel; of a file without an
    index it is None, and ``seen`` has the channels.
    """

    __slots__ = ("after", "begin", "chunk", "end", "index", "length", "seen", "start")

    def __init__(self, begin: int, length: int, start: int, end: int, after: int, index: bytes | None) -> None:
        self.begin, self.length, self.start, self.end, self.after, self.index = begin, length, start, end, after, index
        self.seen: set[int] = set()
        self.chunk = True

    def channels(self) -> set[int] | None:
        """Channels in it, as far as they are known."""
        if self.index is not None:
            return {channel for channel, _ in struct.iter_unpack("<HQ", self.index)}
        return self.seen or None


class Summary:
    """The facts about a file without reading its messages. ``counts`` are by channel, None where the file does not tell."""

    def __init__(self) -> None:
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, Any] = {}
        self.parts: list[Part] = []
        self.counts: dict[int, int] | None = None
        self.metadata: list[tuple[int, int]] = []
        self.attachments: list[tuple[int, int]] = []

    def define(self, opcode: int, body: bytes) -> None:
        """Takes a schema or a channel; the first of a number stays."""
        if opcode == CHANNEL:
            channel = record("Channel", body)
            self.channels.setdefault(channel.id, channel)
        else:
            schema = record("Schema", body)
            self.schemas.setdefault(schema.id, schema)

    def take(self, data: bytes) -> bool:
        """Takes all of an index; false where something is missing in it."""
        told = None
        for opcode, at, end in inside(data):
            if opcode in (SCHEMA, CHANNEL):
                self.define(opcode, data[at:end])
            elif opcode == _CHUNK_INDEX:
                self.parts.append(_chunk(data, at))
            elif opcode == _STATISTICS:
                told = record("Statistics", data[at:end])
            elif opcode == _METADATA_INDEX:
                self.metadata.append(struct.unpack_from("<QQ", data, at))
            elif opcode == _ATTACHMENT_INDEX:
                self.attachments.append(struct.unpack_from("<QQ", data, at))
        self.parts.sort(key=lambda part: part.begin)
        self.metadata.sort()
        if told is None or told.chunk_count != len(self.parts) or told.channel_count != len(self.channels):
            return False
        if told.metadata_count != len(self.metadata) or told.attachment_count != len(self.attachments):
            return False
        self.counts = dict(told.channel_message_counts)
        known = all(c.schema_id in self.schemas or not c.schema_id for c in self.channels.values())
        placed = all(part.index for part in self.parts)
        return known and placed and set(self.counts) <= set(self.channels) and sum(self.counts.values()) == told.message_count


def _chunk(data: bytes, at: int) -> Part:
    start, end, begin, length, pairs = struct.unpack_from("<QQQQI", data, at)
    at += 36
    if pairs % 10:
        raise ValueError("a list of pairs has half of one")
    (indexes,) = struct.unpack_from("<Q", data, at + pairs)
    return Part(begin, length, start, end, begin + length + indexes, data[at : at + pairs])


def inside(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Records that follow each other: opcode, begin and end of each one's body."""
    at, length = 0, len(data)
    while at < length:
        opcode, size = HEAD.unpack_from(data, at)
        at += HEAD.size
        if size > length - at:
            raise struct.error("a record ends behind what it is in")
        yield opcode, at, at + size
        at += size


def installed() -> Any:
    """The reader of the package ``mcap``, or how to get it."""
    try:
        from mcap import data_stream, records
    except ImportError:
        sentence = "reading recordings needs mcap: pip install mcap mcap-protobuf-support"
        raise TrocarError("FAILED_PRECONDITION", "NOT_INSTALLED", sentence) from None
    return records, data_stream


def record(kind: str, body: bytes) -> Any:
    """A record by the reader of the package ``mcap``."""
    records, data_stream = installed()
    try:
        return getattr(records, kind).read(data_stream.ReadDataStream(BytesIO(body)))
    except Exception as e:  # Damaged bytes end in whatever the decoder makes of them.
        raise ValueError(f"a record {kind} is none: {type(e).__name__}") from None
