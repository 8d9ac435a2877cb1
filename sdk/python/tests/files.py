"""Recordings that tests write: of types made here, by the stock writer of MCAP."""

import json

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import CompressionType, Writer


def types(full_name, messages, enums=()):
    """Schema and class of a type: ``messages`` are names with their fields (name, type, repeated, name of a type, may be missing)."""
    package, _, wanted = full_name.rpartition(".")
    file = descriptor_pb2.FileDescriptorProto(name=f"{full_name}.proto", package=package, syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    for name, words in enums:
        of = file.enum_type.add(name=name)
        for number, word in words:
            of.value.add(name=word, number=number)
    for name, fields in messages:
        m = file.message_type.add(name=name)
        for number, (field, kind, many, of, optional) in enumerate(fields, 1):
            f = m.field.add(name=field, number=number, type=kind, label=3 if many else 1)
            if of:
                f.type_name = of if of.startswith(".") else f".{package}.{of}"
            if optional:
                f.proto3_optional, f.oneof_index = True, len(m.oneof_decl)
                m.oneof_decl.add(name=f"_{field}")
    time = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(time)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(time.SerializeToString())
    pool.AddSerializedFile(file.SerializeToString())
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{wanted}"))
    return descriptor_pb2.FileDescriptorSet(file=[time, file]).SerializeToString(), cls


def schema():
    """The type of most tests."""
    fields = [("x", 1, False, "", False), ("joints", 1, True, "", False), ("name", 9, False, "", False), ("n", 4, False, "", False)]
    return types("trocar.Thing_0123", [("Thing_0123", fields)])


IMAGE = [("timestamp", 11, False, ".google.protobuf.Timestamp", False), ("frame_id", 9, False, "", False)]


def raw_image():
    """foxglove.RawImage."""
    rest = [(name, 9 if name == "encoding" else 7, False, "", False) for name in ("width", "height", "encoding", "step")]
    return types("foxglove.RawImage", [("RawImage", [*IMAGE, *rest, ("data", 12, False, "", False)])])


def compressed_image():
    """foxglove.CompressedImage."""
    rest = [("data", 12, False, "", False), ("format", 9, False, "", False)]
    return types("foxglove.CompressedImage", [("CompressedImage", [*IMAGE, *rest])])


def oct_lines():
    """Lines of an OCT, as the recorder describes them."""
    head = [("lines", 7, False, "", False), ("samples", 7, False, "", False), ("format", 14, False, "SampleFormat", False)]
    words = [(0, "SAMPLEFORMAT_UNKNOWN"), (1, "SAMPLEFORMAT_U16"), (2, "SAMPLEFORMAT_F32")]
    return types("trocar.h1.Lines", [("Lines", [*head, ("data", 12, False, "", False)])], [("SampleFormat", words)])


class File:
    """A recording that is being written; ``close`` ends it, unless it is to be cut off."""

    def __init__(self, path, profile="trocar", **settings):
        self.path = path
        self.out = open(path, "wb")
        self.writer = Writer(self.out, **{"chunk_size": 1024, "compression": CompressionType.NONE, **settings})
        self.writer.start(profile=profile)
        self.numbers = {}

    def topic(self, name, kind=None, metadata=None, encoding="protobuf", full_name=None):
        """Adds a topic: of a type as ``types`` gives it, or of JSON."""
        if kind is None and encoding == "protobuf":
            number = self.writer.register_schema("note", "jsonschema", b"{}")
            encoding = "json"
        elif kind is None:
            number = 0
        else:
            number = self.writer.register_schema(full_name or kind[1].DESCRIPTOR.full_name, "protobuf", kind[0])
        return self.writer.register_channel(name, encoding, number, metadata or {})

    def add(self, channel, log, value, publish=None):
        """A message, at these times in ns."""
        data = value if isinstance(value, bytes) else json.dumps(value).encode() if isinstance(value, dict) else value.SerializeToString()
        self.numbers[channel] = self.numbers.get(channel, -1) + 1
        self.writer.add_message(channel, log, data, log if publish is None else publish, self.numbers[channel])

    def tell(self, name, **metadata):
        """Metadata, as the recorder writes it of the system."""
        self.writer.add_metadata(name, metadata)

    def close(self):
        self.writer.finish()
        self.out.close()
        return self.path


def write(path, count=100, finish=True, **settings):
    """A recording of ``count`` things at 1 kHz, and a note."""
    kind = schema()
    file = File(path, **{"compression": CompressionType.LZ4, **settings})
    things = file.topic("/robot/arm/state", kind, {"unit": "m"})
    notes = file.topic("/recorder/note")
    file.tell("trocar", version="1")
    for i in range(count):
        value = kind[1](x=i / 2, joints=[i, -i], name=f"n{i}", n=i)
        file.add(things, 1_000_000_000 + i * 1_000_000, value, 999_000_000 + i * 1_000_000)
    file.add(notes, 2_000_000_000, {"text": "half way"})
    if finish:
        file.close()
    else:
        file.out.close()
    return path
