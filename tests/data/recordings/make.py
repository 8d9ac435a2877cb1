#!/usr/bin/env python3
"""Recordings (MCAP) byte by byte, so that they can be wrong where a test wants it: the corpus beside this file.

    python3 tests/data/recordings/make.py DIR     writes the corpus into DIR

Invariant: the same bytes each time; a test compares them with those of the repository.
"""

import pathlib
import struct
import sys
import zlib

MAGIC = b"\x89MCAP0\r\n"
DOUBLE, BOOL, STRING, MESSAGE, BYTES, ENUM = 1, 8, 9, 11, 12, 14
HUGE = b"\xff\xff\xff\xff"


def record(opcode, body):
    return bytes([opcode]) + struct.pack("<Q", len(body)) + body


def string(text):
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def schema(number, name, data, encoding="protobuf"):
    return record(3, struct.pack("<H", number) + string(name) + string(encoding) + struct.pack("<I", len(data)) + data)


def channel(number, of_schema, topic, encoding="protobuf"):
    return record(4, struct.pack("<HH", number, of_schema) + string(topic) + string(encoding) + struct.pack("<I", 0))


def message(of_channel, sequence, data):
    return record(5, struct.pack("<HIQQ", of_channel, sequence, sequence, sequence) + data)


def chunk(records, crc=None, compression=""):
    crc = zlib.crc32(records) if crc is None else crc
    return record(6, struct.pack("<QQQI", 0, 0, len(records), crc) + string(compression) + struct.pack("<Q", len(records)) + records)


def statistics(messages, of_channel):
    counts = b"".join(struct.pack("<HQ", *pair) for pair in of_channel.items())
    head = struct.pack("<QHIIIIQQ", messages, 1, len(of_channel), 0, 0, 1, 1, messages)
    return record(11, head + struct.pack("<I", len(counts)) + counts)


def whole(*records, header=None):
    end = record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0))
    return MAGIC + (header or record(1, string("x") + string("corpus"))) + b"".join(records) + end + MAGIC


# ---- protobuf: values, and descriptors of types

def varint(n):
    out = b""
    while n > 0x7F:
        out, n = out + bytes([n & 0x7F | 0x80]), n >> 7
    return out + bytes([n])


def inner(number, data):
    return varint(number << 3 | 2) + varint(len(data)) + data


def number(of, n):
    return varint(of << 3) + varint(n)


def double(of, value):
    return varint(of << 3 | 1) + struct.pack("<d", value)


def field(name, of, kind, type_name=None, repeated=False):
    named = inner(6, type_name.encode()) if type_name else b""
    return inner(1, name.encode()) + number(3, of) + number(4, 3 if repeated else 1) + number(5, kind) + named


def kind(name, *fields, enums=()):
    return inner(1, name.encode()) + b"".join(inner(2, each) for each in fields) + b"".join(inner(4, each) for each in enums)


def types(*messages, syntax="proto3"):
    head = inner(1, b"a.proto") + inner(2, b"p")
    return inner(1, head + b"".join(inner(4, each) for each in messages) + inner(12, syntax.encode()))


def chain(length, branches):
    """A type that holds so many of the next one, and so on."""
    links = [kind(f"M{n}", *(field(f"f{b}", b + 1, MESSAGE, f".p.M{n + 1}") for b in range(branches))) for n in range(length)]
    return types(*links, kind(f"M{length}", field("x", 1, DOUBLE)))


LINE = kind("V", field("x", 1, DOUBLE))
ONE = schema(1, "p.V", types(LINE)) + channel(1, 1, "/a/b/c")


def lines(many):
    return b"".join(message(1, n, double(1, float(n))) for n in range(1, many + 1))


def corpus():
    flipped = bytearray(ONE + lines(10))
    flipped[-5] ^= 0x40
    node = kind("Node", field("x", 1, DOUBLE), field("next", 2, MESSAGE, ".p.Node"))
    level = inner(1, b"Level") + b"".join(inner(2, inner(1, name) + number(2, n)) for n, name in enumerate((b"LOW", b"HIGH")))
    mixed = kind("Mixed", field("list", 1, DOUBLE, repeated=True), field("text", 2, STRING), field("data", 3, BYTES), field("yes", 4, BOOL),
                 field("level", 5, ENUM, ".p.Mixed.Level"), field("inner", 6, MESSAGE, ".p.V", repeated=True), enums=[level])
    values = [inner(1, struct.pack("<3d", 1, 2, 3)) + inner(2, b"a,\"b\"") + number(4, 1), inner(3, bytes(40)) + number(5, 1),
              inner(6, double(1, 5.0)) * 3 + inner(1, struct.pack("<5d", *range(5)))]
    return {
        "good": whole(chunk(ONE + lines(10)), statistics(10, {1: 10})),
        "mixed": whole(schema(1, "p.Mixed", types(LINE, mixed)), channel(1, 1, "/a/b/mixed"), *(message(1, n + 1, v) for n, v in enumerate(values))),
        "recursive": whole(schema(1, "p.Node", types(node)), channel(1, 1, "/a/b/c"), message(1, 1, double(1, 1.0)),
                           message(1, 2, double(1, 2.0) + inner(2, double(1, 3.0)))),
        "long-chain": whole(schema(1, "p.M0", chain(300, 1)), channel(1, 1, "/a/b/c"), message(1, 1, b""), message(1, 2, inner(1, inner(1, b"")))),
        "branching": whole(schema(1, "p.M0", chain(30, 2)), channel(1, 1, "/a/b/c"), message(1, 1, b"")),
        "flipped": whole(chunk(bytes(flipped), crc=zlib.crc32(ONE + lines(10))), message(1, 11, double(1, 11.0)),
                         ONE.replace(b"/a/b/c", b"/a/b/d"), message(1, 12, double(1, 12.0))),
        "compressed": whole(chunk(b"\0" * 50, compression="zstd"), ONE, statistics(200, {1: 200})),
        "compressed-uncounted": whole(chunk(b"\0" * 50, compression="zstd"), ONE),
        "huge-header": whole(ONE, lines(1), header=record(1, string("x") + HUGE + b"corpus")),
        "huge-topic": whole(record(4, struct.pack("<HH", 1, 1) + HUGE + b"/a/b/c")),
        "long-topic": whole(schema(1, "p.V", types(LINE)), channel(1, 1, "/" + "a/" * 2000 + "b"), lines(1)),
        "long-name": whole(schema(1, "p.V", types(kind("V", field("x" * 5000, 1, DOUBLE)))), channel(1, 1, "/a/b/c"), lines(1)),
        "unknown-syntax": whole(schema(1, "p.V", types(LINE, syntax="proto9")), channel(1, 1, "/a/b/c"), lines(1)),
        "undescribed": whole(message(7, 1, double(1, 1.0))),
        "cut": whole(chunk(ONE + lines(10)))[:400],
    }


def main():
    for name, data in corpus().items():
        (pathlib.Path(sys.argv[1]) / f"{name}.mcap").write_bytes(data)


if __name__ == "__main__":
    main()
