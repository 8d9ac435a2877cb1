"""One topic of a recording: its messages one after the other, and its fields as arrays, tables and frames.

Invariant: no more of the file is kept than was asked for; messages that cannot be read are left out, counted, and told.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ._arrays import array, decoder, plain, structured, within
from ._errors import TrocarError, invalid
from ._frames import Frames
from ._paths import nearest
from ._tables import Tables

# Fields of foxglove's messages that hold a field of ours, by the begin of their path.
_FOXGLOVE = {
    "foxglove.PoseInFrame": {"pose.position": "position"},
    "foxglove.FrameTransform": {"translation": "position"},
    "foxglove.JointStates": {f"joints.{n}": n for n in ("position", "velocity", "effort")},
}


class Sample(NamedTuple):
    """One message: ``t`` is when it was acquired, s since the recording began; its times in ns; ``value`` is the message itself."""

    t: float
    publish_time: int
    log_time: int
    sequence: int
    value: Any


class Topic(Tables):
    """The messages of one topic. Fields are numpy arrays with one entry per message, by attribute or key.

    ``log_time`` is when each was recorded, ``publish_time`` when it was acquired, ns; ``messages`` are the decoded messages themselves,
    and iterating gives them one by one with their times. ``to_pandas()`` and ``to_numpy()`` are tables of it, ``frames`` its pictures.
    """

    def __init__(self, recording: Any, name: str, channels: list[int]) -> None:
        self.name = name
        self._recording, self._channels = recording, channels
        self._decoders: dict[int, Any] = {}
        self._kept: list[tuple[Any, Any]] | None = None
        self._times: np.ndarray | None = None
        self._arrays: dict[str, np.ndarray] = {}
        self._frames: Frames | None = None
        self.unreadable = 0

    # ---- what is known of it without reading its messages

    @property
    def types(self) -> list[str]:
        """Names of its types, one after the other where they changed."""
        schemas = [self._schema(c) for c in self._channels]
        return list(dict.fromkeys(s.name if s is not None else "" for s in schemas))

    @property
    def schema(self) -> str:
        """The name of its (first) type."""
        return self.types[0] if self._channels else ""

    type = schema

    @property
    def metadata(self) -> dict[str, str]:
        """The metadata that the recorder wrote of it."""
        return dict(self._recording._file.summary.channels[self._channels[0]].metadata) if self._channels else {}

    @property
    def units(self) -> dict[str, str]:
        """The unit of each field that has one."""
        found = {}
        for channel in self._channels:
            told = self._recording._file.summary.channels[channel].metadata
            schema = self._schema(channel)
            ours = {v: k for k, v in _FOXGLOVE.get(schema.name if schema is not None else "", {}).items()}
            for key, unit in told.items():
                if key.startswith("unit:"):
                    found[ours.get(key[5:], key[5:])] = unit
        return found

    @property
    def fields(self) -> list[str]:
        """Names of the fields."""
        for channel in self._channels:
            try:
                empty = self._decoder(channel)(b"")
            except Exception:
                continue
            if hasattr(empty, "DESCRIPTOR"):
                return [f.name for f in empty.DESCRIPTOR.fields]
        first = next((value for _, value in self._read()), None) if len(self) else None
        return [str(k) for k in first] if isinstance(first, Mapping) else []

    def _span(self) -> tuple[int, int] | None:
        if self._kept is not None:
            times = [m.log_time for m, _ in self._kept]
            return (min(times), max(times)) if times else None
        spans = [s for c in self._channels if (s := self._recording._file.span(c))]
        return (min(s[0] for s in spans), max(s[1] for s in spans)) if spans else None

    @property
    def first_ns(self) -> int | None:
        """When its first message was recorded, ns of the recorder's clock."""
        span = self._span()
        return span[0] if span else None

    @property
    def last_ns(self) -> int | None:
        """When its last message was recorded, ns of the recorder's clock."""
        span = self._span()
        return span[1] if span else None

    @property
    def first(self) -> float | None:
        """When its first message was recorded, s since the recording began."""
        return None if self.first_ns is None else (self.first_ns - self._recording.begin_ns) / 1e9

    @property
    def last(self) -> float | None:
        """When its last message was recorded, s since the recording began."""
        return None if self.last_ns is None else (self.last_ns - self._recording.begin_ns) / 1e9

    @property
    def count(self) -> int:
        """The number of its messages."""
        return len(self)

    @property
    def rate_hz(self) -> float | None:
        """Messages per second between its first and its last one, Hz; None where they are less than 10 ms apart."""
        span = self._span()
        if span is None or span[1] - span[0] <= 10_000_000:
            return None
        return (len(self) - 1) / ((span[1] - span[0]) / 1e9)

    @property
    def lost(self) -> int | None:
        """Samples that were lost; of an image of a pair and of a tap, those of the whole output. None where the file does not tell."""
        losses = self._recording.losses
        return losses.of(self.name).lost if losses.told else None

    @property
    def interrupted(self) -> int:
        """The number of times that the connection or the process of its source went away."""
        return self._recording.losses.of(self.name).interrupted

    @property
    def silent(self) -> bool:
        """Whether it was recorded and gave nothing."""
        return not len(self) and self.name in self._recording.losses.silent

    def __len__(self) -> int:
        if self._kept is not None:
            return len(self._kept)
        return sum(self._recording._file.count(c) for c in self._channels)

    # ---- its messages

    def _schema(self, channel: int) -> Any:
        summary = self._recording._file.summary
        return summary.schemas.get(summary.channels[channel].schema_id)

    def _decoder(self, channel: int) -> Any:
        if channel not in self._decoders:
            about = self._recording._file.summary.channels[channel]
            self._decoders[channel] = decoder(about.message_encoding, self._schema(channel))
        return self._decoders[channel]

    def _raw(self, bodies: bool = True, since: int = 0) -> Iterator[Any]:
        yield from self._recording._file.messages(set(self._channels), bodies, since)

    def _read(self, since: int = 0) -> Iterator[tuple[Any, Any]]:
        """Its messages as they are in the file, and what is in them."""
        if self._kept is not None:
            yield from self._kept
            return
        self.unreadable = 0
        for m in self._raw(True, since):
            taken = self._taken(m)
            if taken is not None:
                yield taken

    def _taken(self, m: Any) -> tuple[Any, Any] | None:
        try:
            value = self._decoder(m.channel)(m.data)
        except TrocarError:
            raise
        except Exception as e:  # What was sent is not what its type says.
            self.unreadable += 1
            self._recording._file.say(f"messages of {self.name} are not what their type says ({type(e).__name__}); they are left out")
            return None
        return m._replace(data=b""), value

    def _keep(self) -> None:
        if self._kept is None:
            self._kept = list(self._read())
            self._times = None

    def __iter__(self) -> Iterator[Sample]:
        begin = self._recording.begin_ns
        for m, value in self._read():
            yield Sample((m.publish_time - begin) / 1e9, m.publish_time, m.log_time, m.sequence, value)

    @property
    def messages(self) -> list[Any]:
        """All messages, decoded, in memory."""
        self._keep()
        return [value for _, value in self._kept or ()]

    def _stamps(self) -> np.ndarray:
        if self._times is None:
            # Pictures are not read for their times.
            entries = self._raw(False) if self._kept is None and self._is_frames() else (m for m, _ in self._read())
            rows = [(m.log_time, m.publish_time, m.sequence) for m in entries]
            self._times = np.array(rows, "u8").reshape(-1, 3)
        return self._times

    @property
    def log_time(self) -> np.ndarray:
        """When each message was recorded, ns."""
        return self._stamps()[:, 0].copy()

    @property
    def publish_time(self) -> np.ndarray:
        """When each message was acquired, ns."""
        return self._stamps()[:, 1].copy()

    @property
    def sequence(self) -> np.ndarray:
        """The number of each message as its source counted it."""
        return self._stamps()[:, 2].copy()

    @property
    def t(self) -> np.ndarray:
        """Times of acquisition, s since the first."""
        stamps = self.publish_time.astype("i8")
        return (stamps - stamps[0]).astype(float) / 1e9 if len(stamps) else np.array([])

    def __getitem__(self, name: str) -> np.ndarray:
        """One field of all messages; ``"pose.position.x"`` goes into structs."""
        if name not in self._arrays:
            try:
                self._arrays[name] = array([plain(within(value, name)) for _, value in self._read()])
            except (AttributeError, KeyError, TypeError):
                fields = self.fields
                raise KeyError(f"{self.name} has no field {name!r}; it has {', '.join(fields)}{nearest(name, fields)}") from None
        return self._arrays[name]

    def __getattr__(self, name: str) -> np.ndarray:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as e:
            raise AttributeError(e.args[0]) from None

    def array(self) -> np.ndarray:
        """All fields with one shape as a structured array, with ``log_time`` and ``publish_time`` in front."""
        self._keep()
        columns = {"log_time": self.log_time, "publish_time": self.publish_time}
        columns.update((n, self[n]) for n in self.fields)
        return structured({n: c for n, c in columns.items() if c.dtype != object})

    # ---- frames

    def _is_frames(self) -> bool:
        for channel in self._channels:
            try:
                empty = self._decoder(channel)(b"")
            except Exception:
                continue
            field = getattr(empty, "DESCRIPTOR", None) and empty.DESCRIPTOR.fields_by_name.get("data")
            if field is not None and field.type == 12:
                return True
        return False

    @property
    def frames(self) -> Frames:
        """Its frames, by number, by slice, or one after the other."""
        if not self._is_frames():
            there = [t.name for t in self._recording.topics.values() if t._channels and t._is_frames()]
            raise invalid(f"{self.name} has no frames; {', '.join(there) or 'nothing in it'} has", "NOT_FRAMES", topic=self.name)
        if self._frames is None:
            self._frames = Frames(self)
        return self._frames

    def frame(self, number: int) -> Any:
        """The frame of this number, from 0; from the end where it is negative."""
        return self.frames[number]

    def __dir__(self) -> list[str]:
        return [*self.fields, *(n for n in object.__dir__(self) if not n.startswith("_"))]

    def _ipython_key_completions_(self) -> list[str]:
        return self.fields

    def __repr__(self) -> str:
        first, last = self.first_ns, self.last_ns
        span = f", {(last - first) / 1e9:.3f} s" if first is not None and last is not None and last > first else ""
        return f"<{self.name}: {len(self)} of {', then '.join(self.types) or 'nothing'}{span}; {', '.join(self.fields)}>"
