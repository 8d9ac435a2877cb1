"""``trocar.v1`` at run time: message classes and methods made from the descriptors the host itself answers reflection from.

Invariant: no generated code; ``trocar.v1.bin`` is byte for byte ``proto/src/gen/trocar.v1.bin``, a test compares.
"""

from __future__ import annotations

import importlib.resources
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

PACKAGE = "trocar.v1"


class Method(NamedTuple):
    """One RPC: its full name, its messages, whether the server streams."""

    path: str
    request: Any
    response: Any
    streams: bool


def _bytes() -> bytes:
    return importlib.resources.files("trocar").joinpath("trocar.v1.bin").read_bytes()


def _status_file() -> descriptor_pb2.FileDescriptorProto:
    """The parts of ``google.rpc`` an error comes in; five small messages are no reason for another package."""
    f = descriptor_pb2.FileDescriptorProto(name="trocar/status.proto", package="trocar.status", syntax="proto3")

    def message(name: str, **fields: Any) -> descriptor_pb2.DescriptorProto:
        m = f.message_type.add(name=name)
        for field, (number, kind, repeated) in fields.items():
            d = m.field.add(name=field, number=number, label=3 if repeated else 1)
            if isinstance(kind, str):
                d.type, d.type_name = 11, ".trocar.status." + kind
            else:
                d.type = kind
        return m

    text, whole, raw = 9, 5, 12
    message("Any", type_url=(1, text, False), value=(2, raw, False))
    message("Status", code=(1, whole, False), message=(2, text, False), details=(3, "Any", True))
    info = message("ErrorInfo", reason=(1, text, False), domain=(2, text, False))
    entry = info.nested_type.add(name="MetadataEntry")
    entry.field.add(name="key", number=1, label=1, type=9)
    entry.field.add(name="value", number=2, label=1, type=9)
    entry.options.map_entry = True
    info.field.add(name="metadata", number=3, label=3, type=11, type_name=".trocar.status.ErrorInfo.MetadataEntry")
    message("Violation", field=(1, text, False), description=(2, text, False))
    message("BadRequest", field_violations=(1, "Violation", True))
    message("Link", description=(1, text, False), url=(2, text, False))
    message("Help", links=(1, "Link", True))
    return f


_files = descriptor_pb2.FileDescriptorSet.FromString(_bytes())
_pool = descriptor_pool.DescriptorPool()
for _file in (*_files.file, _status_file()):
    _pool.AddSerializedFile(_file.SerializeToString())


def message(name: str) -> Any:
    """The class of a message: ``message("trocar.v1.InvokeRequest")``; a name without dots is one of ``trocar.v1``."""
    full = name if "." in name else f"{PACKAGE}.{name}"
    return message_factory.GetMessageClass(_pool.FindMessageTypeByName(full))


def _methods() -> dict[str, Method]:
    found = {}
    for file in _files.file:
        if file.package != PACKAGE:
            continue
        for service in file.service:
            for rpc in service.method:
                found[f"{service.name}/{rpc.name}"] = Method(
                    f"/{PACKAGE}.{service.name}/{rpc.name}",
                    message(rpc.input_type.lstrip(".")),
                    message(rpc.output_type.lstrip(".")),
                    rpc.server_streaming,
                )
    return found


METHODS = _methods()
"""Every RPC of trocar.v1 by ``Service/Method``."""

Value = message("google.protobuf.Value")
Struct = message("google.protobuf.Struct")
Duration = message("google.protobuf.Duration")


def words(enum: str, prefix: str) -> dict[int, str]:
    """Numbers of an enum and their words without the prefix: ``{3: "ACTIVE", …}``."""
    values = _pool.FindEnumTypeByName(f"{PACKAGE}.{enum}").values
    return {v.number: v.name[len(prefix) :] for v in values}


STATES = words("ComponentState", "COMPONENT_STATE_")
STOP_REASONS = words("StopReason", "STOP_REASON_")
HEALTH = words("Health", "HEALTH_")
KINDS = words("CommandKind", "COMMAND_KIND_")
PROCESS_STATES = words("ProcessState", "PROCESS_STATE_")
PRIMITIVES = {n: w.lower() for n, w in words("Primitive", "PRIMITIVE_").items()}


def duration(seconds: float) -> Any:
    """A protobuf duration of so many seconds."""
    ns = round(seconds * 1e9)
    return Duration(seconds=ns // 1_000_000_000, nanos=ns % 1_000_000_000)
