"""An MCAP file that is open: its index, or where it has none, what one way through it tells.

Invariant: the index of a file is believed only where its checksum and its own counts agree; all that is wrong is told.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array

from ._chunks import MESSAGE, Chunks, Damaged, Message, messages_in, shown
from ._errors import invalid
from ._summary import CHANNEL, CHUNK, CRC, HEAD, MAGIC, SCHEMA, Part, Summary, installed, record

CUT = "it has no end: its recorder still writes it, or was ended before it could close it"
_INDEX = "its index is damaged; it was read from the begin to the end instead"
# Opcodes of MCAP that are read here, beside those of its index; from the last one on they are whoever's own.
_HEADER, _FOOTER, _ATTACHMENT, _METADATA, _LAST, _OWN = 1, 2, 9, 12, 15, 0x80


class File(Chunks):
    """An MCAP file that is open. ``complete`` until something is missing of it; ``problems`` are what is."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.problems: list[str] = []
        self.profile = ""
        self._fd = -1
        installed()
        try:
            self._fd = os.open(name, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0))
            self.size = os.fstat(self._fd).st_size
            magic = os.pread(self._fd, 8, 0)
        except OSError as e:
            raise invalid(f"{name} cannot be read: {e.strerror}", "FILE_INVALID", file=name) from None
        if magic != MAGIC:
            raise invalid(f"{name} is no MCAP file", "FILE_INVALID", file=name)
        self.summary = Summary()
        # Counts and times by channel of a file without an index: they are taken where it is read through.
        self._spans: dict[int, list[int]] = {}
        self._of_channel: dict[int, array] | None = None
        self._first_record()
        if not self._by_summary():
            self.summary = Summary()
            self._scan()

    def close(self) -> None:
        """Ends the access; may be called again."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __del__(self) -> None:
        self.close()

    # ---- its index

    def _first_record(self) -> None:
        try:
            opcode, length = HEAD.unpack(self._bytes(8, HEAD.size))
            if opcode == _HEADER:
                self.profile = record("Header", self._bytes(17, length)).profile
        except Exception:  # Whatever is wrong with it is said when it is read through.
            self.profile = ""

    def _by_summary(self) -> bool:
        """Takes the index at the end of the file; false where there is none that can be trusted."""
        tail = 8 + HEAD.size + 20
        if self.size < 8 + tail or os.pread(self._fd, 8, self.size - 8) != MAGIC:
            return False
        footer = os.pread(self._fd, HEAD.size + 20, self.size - tail)
        opcode, length, begin, _, crc = struct.unpack("<BQQQI", footer)
        if (opcode, length) != (_FOOTER, 20) or not 8 <= begin <= self.size - tail:
            return False
        data = self._bytes(begin, self.size - tail - begin)
        if crc and zlib.crc32(footer[:-CRC], zlib.crc32(data)) != crc:
            self.say(_INDEX)
            return False
        try:
            return self.summary.take(data) and self._between(begin)
        except (Damaged, struct.error, ValueError):
            self.say(_INDEX)
            return False

    def _between(self, end: int) -> bool:
        """Takes what lies between the chunks of the index; false where that is another chunk."""
        parts, at = [], 8
        for part in [*self.summary.parts, Part(end, 0, 0, 0, 0, b"")]:
            first = None
            while at < part.begin:
                opcode, length = HEAD.unpack(self._bytes(at, HEAD.size))
                if opcode == CHUNK:
                    return False
                if opcode == MESSAGE:
                    first = at if first is None else first
                elif first is not None:
                    parts.append(_loose(first, at - first))
                    first = None
                at += HEAD.size + length
            if first is not None:
                parts.append(_loose(first, at - first))
            if at > part.begin:
                return False
            at = part.after
            parts.append(part)
        self.summary.parts = parts[:-1]
        return True

    def _scan(self) -> None:
        """Goes through the records of a file without an index, or with a wrong one."""
        at, ended = 8, False
        while not ended:
            head = os.pread(self._fd, HEAD.size, at)
            # Zeros are room that the recorder has asked the disk for, and not used.
            if len(head) < HEAD.size or head[0] == 0:
                break
            opcode, length = HEAD.unpack(head)
            if _LAST < opcode < _OWN:
                self.say(f"it is damaged near byte {at} (no record has the number {opcode}); what came before is here")
                return
            body = at + HEAD.size
            if length > self.size - body:
                break
            try:
                self._scanned(opcode, at, length)
            except Damaged as e:
                self.say(str(e))
            except Exception as e:  # Damaged bytes end in whatever the decoders make of them.
                self.say(f"it is damaged near byte {at} ({shown(e)}); the rest of it is here")
            at = body + length
            ended = opcode == _FOOTER
        if not ended or os.pread(self._fd, 8, at) != MAGIC:
            self.say(CUT)

    def _scanned(self, opcode: int, at: int, length: int) -> None:
        if opcode == CHUNK:
            part = Part(at, HEAD.size + length, 0, 0, at + HEAD.size + length, None)
            data = self._load(part)
            for message in messages_in(data, 0, self.summary.define, None, False):
                self._count(part, message)
            self.summary.parts.append(part)
        elif opcode == MESSAGE:
            part = _loose(at, HEAD.size + length)
            self._count(part, self._direct(at, 0, False))
            last = self.summary.parts[-1] if self.summary.parts else None
            if last is not None and not last.chunk and last.after == at:
                last.length, last.after = last.length + part.length, part.after
                last.seen.update(part.seen)
            else:
                self.summary.parts.append(part)
        elif opcode in (SCHEMA, CHANNEL):
            self.summary.define(opcode, self._bytes(at + HEAD.size, length))
        elif opcode == _METADATA:
            self.summary.metadata.append((at, HEAD.size + length))
        elif opcode == _ATTACHMENT:
            self.summary.attachments.append((at, HEAD.size + length))

    def _count(self, part: Part, message: Message) -> None:
        span = self._spans.setdefault(message.channel, [0, message.log_time, message.log_time])
        span[0] += 1
        span[1] = min(span[1], message.log_time)
        span[2] = max(span[2], message.log_time)
        part.seen.add(message.channel)

    # ---- what is asked for

    def count(self, channel: int) -> int:
        """The number of messages of a channel."""
        if self.summary.counts is not None:
            return self.summary.counts.get(channel, 0)
        return self._spans.get(channel, [0])[0]

    def span(self, channel: int) -> tuple[int, int] | None:
        """When the first and the last message of a channel were recorded, ns."""
        if channel not in self._spans and self.summary.counts is not None and self.count(channel):
            parts = [self.summary.parts[n] for n in self._having(channel)]
            times = array("Q")
            for part in sorted(parts, key=lambda part: part.start):
                if times and part.start >= min(times):
                    break
                times.extend(self._times(part, channel))
            for part in sorted(parts, key=lambda part: -part.end):
                if times and part.end <= max(times):
                    break
                times.extend(self._times(part, channel))
            if times:
                self._spans[channel] = [self.count(channel), min(times), max(times)]
        span = self._spans.get(channel)
        return (span[1], span[2]) if span else None

    def _having(self, channel: int) -> array:
        """Numbers of the parts that may have messages of a channel."""
        if self._of_channel is None:
            self._of_channel, everywhere = {}, array("L")
            for n, part in enumerate(self.summary.parts):
                channels = part.channels()
                if channels is None:
                    everywhere.append(n)
                for c in channels or ():
                    self._of_channel.setdefault(c, array("L")).append(n)
            if everywhere:
                for c in self.summary.channels:
                    self._of_channel[c] = array("L", sorted({*self._of_channel.get(c, ()), *everywhere}))
        return self._of_channel.get(channel, array("L"))

    def _times(self, part: Part, channel: int) -> list[int]:
        if part.chunk and part.index is not None:
            try:
                return [time for time, _ in self._entries(part, {channel})]
            except Damaged:
                pass  # Its messages tell.
        try:
            return [m.log_time for m in self._of(0, part, {channel}, False)]
        except Damaged as e:
            self.say(str(e))
            return []

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata by name; the last of a name counts."""
        found = {}
        for at, _ in self.summary.metadata:
            try:
                told = record("Metadata", self._bytes(at + HEAD.size, HEAD.unpack(self._bytes(at, HEAD.size))[1]))
                found[told.name] = dict(told.metadata)
            except Exception as e:  # Damaged bytes end in whatever the decoder makes of them.
                self.say(f"it is damaged near byte {at} ({shown(e)}); the rest of it is here")
        return found

    def attachments(self) -> dict[str, bytes]:
        """Files inside of the file, by name."""
        found = {}
        for at, _ in self.summary.attachments:
            try:
                told = record("Attachment", self._bytes(at + HEAD.size, HEAD.unpack(self._bytes(at, HEAD.size))[1]))
                found[told.name] = told.data
            except Exception as e:  # As above.
                self.say(f"it is damaged near byte {at} ({shown(e)}); the rest of it is here")
        return found


def _loose(begin: int, length: int) -> Part:
    """Messages in no chunk: their times are not known before they are read."""
    part = Part(begin, length, 0, (1 << 64) - 1, begin + length, None)
    part.chunk = False
    return part
