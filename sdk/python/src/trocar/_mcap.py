"""``read(file)``: a recording (MCAP) as numpy arrays, a structured array for each topic.

Invariant: a file that was cut off (a crash, a full disk) gives all that can be read of it, and says that it is not complete.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ._errors import TrocarError, invalid
from ._paths import globbed, nearest

_CUT = "it has no end: its recorder still writes it, or was ended before it could close it"


class Topic:
    """The messages of one topic. Fields are numpy arrays with one entry per message, by attribute or key.

    ``log_time`` is when each was recorded, ``publish_time`` when it was acquired, ns; ``messages`` are the decoded messages themselves.
    """

    def __init__(self, name: str, schema: str, metadata: dict[str, str]) -> None:
        self.name, self.schema, self.metadata = name, schema, metadata
        self.messages: list[Any] = []
        self._log: list[int] = []
        self._publish: list[int] = []
        self._columns: dict[str, np.ndarray] = {}

    @property
    def log_time(self) -> np.ndarray:
        """When each message was recorded, ns."""
        return np.array(self._log, "u8")

    @property
    def publish_time(self) -> np.ndarray:
        """When each message was acquired, ns."""
        return np.array(self._publish, "u8")

    @property
    def t(self) -> np.ndarray:
        """Times of acquisition, s since the first."""
        return (self.publish_time - self.publish_time[0]).astype(float) / 1e9 if self._publish else np.array([])

    @property
    def fields(self) -> list[str]:
        """Names of the fields."""
        if not self.messages:
            return []
        first = self.messages[0]
        if isinstance(first, Mapping):
            return list(first)
        return [f.name for f in first.DESCRIPTOR.fields] if hasattr(first, "DESCRIPTOR") else []

    def __getitem__(self, name: str) -> np.ndarray:
        """One field of all messages; ``"pose.position.x"`` goes into structs."""
        if name not in self._columns:
            try:
                self._columns[name] = _column([_field(m, name) for m in self.messages])
            except (AttributeError, KeyError):
                raise KeyError(f"{self.name} has no field {name!r}; it has {', '.join(self.fields)}{nearest(name, self.fields)}") from None
        return self._columns[name]

    def __getattr__(self, name: str) -> np.ndarray:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as e:
            raise AttributeError(e.args[0]) from None

    def array(self) -> np.ndarray:
        """All fields with one shape as a structured array, with ``log_time`` and ``publish_time`` in front."""
        columns = {"log_time": self.log_time, "publish_time": self.publish_time}
        columns.update((n, self[n]) for n in self.fields)
        columns = {n: c for n, c in columns.items() if c.dtype != object}
        out = np.empty(len(self), np.dtype([(n, c.dtype, c.shape[1:]) for n, c in columns.items()]))
        for name, column in columns.items():
            out[name] = column
        return out

    def __len__(self) -> int:
        return len(self.messages)

    def __dir__(self) -> list[str]:
        return [
            *self.fields,
            "array",
            "fields",
            "log_time",
            "messages",
            "metadata",
            "name",
            "publish_time",
            "schema",
            "t",
        ]

    def _ipython_key_completions_(self) -> list[str]:
        return self.fields

    def __repr__(self) -> str:
        span = f", {(self._publish[-1] - self._publish[0]) / 1e9:.3f} s" if len(self) > 1 else ""
        return f"<{self.name}: {len(self)} of {self.schema}{span}; {', '.join(self.fields)}>"


class RecordingFile(Mapping):
    """What a file holds, by topic. ``complete`` is false where its end is missing, ``metadata`` what the recorder wrote of the system."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.complete = True
        self.why = ""
        self.profile = ""
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self._topics: dict[str, Topic] = {}

    def __getitem__(self, topic: str) -> Topic:
        found = self._topics.get(topic, self._topics.get("/" + topic))
        if found is None:
            raise KeyError(f"{self.file} has no topic {topic!r}; it has {', '.join(self._topics) or 'none'}{nearest(topic, self._topics)}")
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._topics)

    def __len__(self) -> int:
        return len(self._topics)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._topics)

    def __repr__(self) -> str:
        head = f"{self.file}: {len(self)} topics" + ("" if self.complete else f", not complete: {self.why}")
        return "\n".join([head, *(f"  {t!r}" for t in self._topics.values())])


def read(file: str, topics: Any = None, start: float | None = None, end: float | None = None) -> RecordingFile:
    """Reads a recording. ``topics`` are names or globs of those wanted (all by default); ``start`` and ``end`` bound it, s since its
    first message.
    """
    try:
        from mcap.exceptions import EndOfFile
        from mcap.stream_reader import StreamReader
    except ImportError:
        raise TrocarError("FAILED_PRECONDITION", "NOT_INSTALLED", "reading recordings needs mcap: pip install 'trocar[ire]'") from None
    name = str(file)
    wanted = [globbed(t if t.startswith(("/", "*")) else "/" + t) for t in ([topics] if isinstance(topics, str) else topics or ())]
    out = RecordingFile(name)
    took = _Taking(out, wanted, start, end)
    try:
        stream = open(name, "rb")
    except OSError as e:
        raise invalid(f"{name} cannot be read: {e.strerror}", "FILE_INVALID", file=name) from None
    with stream:
        if stream.read(8) != b"\x89MCAP0\r\n":
            raise invalid(f"{name} is no MCAP file", "FILE_INVALID", file=name)
        stream.seek(0)
        ended = False
        try:
            # Record after record: a file whose summary was never written reads as well as any other.
            for record in StreamReader(stream).records:
                ended = took.take(record) or ended
        except TrocarError:
            raise
        except EndOfFile:
            out.complete, out.why = False, _CUT
        except Exception as e:  # Damaged bytes end in whatever the decoders make of them (struct.error, zstd, lz4).
            shown = f"{type(e).__name__}: {e}".rstrip(": ")
            out.complete, out.why = False, f"it is damaged near byte {stream.tell()} ({shown}); what came before is here"
        if out.complete and not ended:
            out.complete, out.why = False, _CUT
    out._topics = {t.name: t for t in sorted(took.by_channel.values(), key=lambda t: t.name) if len(t) or not wanted}
    return out


class _Taking:
    """Takes records one after the other into the topics."""

    def __init__(self, out: RecordingFile, wanted: list[Any], start: float | None, end: float | None) -> None:
        self.out, self.wanted, self.start, self.end = out, wanted, start, end
        self.schemas: dict[int, Any] = {}
        self.by_channel: dict[int, Topic] = {}
        self.decoders: dict[int, Any] = {}
        self.first: int | None = None

    def take(self, record: Any) -> bool:
        """True when this is the end of a file that was closed."""
        kind = type(record).__name__
        if kind == "Message":
            self._message(record)
        elif kind == "Schema":
            self.schemas[record.id] = record
        elif kind == "Channel":
            self._channel(record)
        elif kind == "Metadata":
            self.out.metadata[record.name] = dict(record.metadata)
        elif kind == "Attachment":
            self.out.attachments[record.name] = record.data
        elif kind == "Header":
            self.out.profile = record.profile
        return kind == "Footer"

    def _channel(self, channel: Any) -> None:
        if channel.id in self.by_channel or (self.wanted and not any(w.match(channel.topic) for w in self.wanted)):
            return
        same = [t for t in self.by_channel.values() if t.name == channel.topic]
        schema = self.schemas.get(channel.schema_id)
        topic = same[0] if same else Topic(channel.topic, schema.name if schema else "", dict(channel.metadata))
        self.by_channel[channel.id] = topic
        self.decoders[channel.id] = _decoder(channel.message_encoding, schema)

    def _message(self, message: Any) -> None:
        if self.first is None:
            self.first = message.log_time
        at = (message.log_time - self.first) / 1e9
        if (self.start is not None and at < self.start) or (self.end is not None and at > self.end):
            return
        topic = self.by_channel.get(message.channel_id)
        if topic is not None:
            topic.messages.append(self.decoders[message.channel_id](message.data))
            topic._log.append(message.log_time)
            topic._publish.append(message.publish_time)


def _decoder(encoding: str, schema: Any) -> Any:
    if encoding == "json":
        return json.loads
    if encoding == "protobuf" and schema is not None:
        try:
            from mcap_protobuf.decoder import DecoderFactory
        except ImportError:
            raise TrocarError(
                "FAILED_PRECONDITION",
                "NOT_INSTALLED",
                "this recording needs mcap-protobuf-support: pip install 'trocar[ire]'",
            ) from None
        found = DecoderFactory().decoder_for(encoding, schema)
        if found is not None:
            return found
    return bytes


def _field(message: Any, name: str) -> Any:
    for part in name.split("."):
        message = message[part] if isinstance(message, Mapping) else getattr(message, part)
    return message


def _column(values: list[Any]) -> np.ndarray:
    """Values of a field as one array where they have one shape, else as objects."""
    plain = [_plain(v) for v in values]
    if plain and isinstance(plain[0], (int, float, bool, str)):
        return np.array(plain)
    if plain and isinstance(plain[0], list) and all(len(p) == len(plain[0]) for p in plain):
        if all(isinstance(x, (int, float, bool)) for p in plain for x in p):
            return np.array(plain)
    out = np.empty(len(plain), object)
    for i, value in enumerate(plain):
        out[i] = value
    return out


def _plain(value: Any) -> Any:
    if isinstance(value, (int, float, bool, str, bytes, Mapping)):
        return value
    if hasattr(value, "DESCRIPTOR"):
        if value.DESCRIPTOR.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
            return value.seconds * 1_000_000_000 + value.nanos
        return value
    # Repeated fields are sequences without being lists; anything else stays as it is.
    return [_plain(v) for v in value] if hasattr(value, "__len__") else value
