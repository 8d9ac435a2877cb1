"""``Recording(path)``: a recording (MCAP) that is open, and its topics; ``read`` takes it into memory.

Invariant: a file that was cut off (a crash, a full disk) gives all that can be read of it, and says that it is not complete.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ._align import aligned
from ._errors import invalid
from ._frames import Frames
from ._mcap import CUT, File
from ._pair import Pair
from ._paths import globbed, nearest
from ._told import Told
from ._topic import Topic
from ._view import as_html, as_text


class Recording(Mapping, Told):
    """A recording that is open: ``rec["robot/arm/tip"]`` is a topic, ``rec.topics`` are all.

    Opening reads its index; messages are read when they are asked for, a chunk at a time. ``complete`` is false where its end is missing
    or something in it is damaged, and ``why`` says what. ``begin_ns`` is when its first message was recorded, ns of the recorder's clock.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.file = os.fspath(path)
        self._file = File(self.file)
        summary = self._file.summary
        channels: dict[str, list[int]] = {}
        for number, channel in summary.channels.items():
            channels.setdefault(channel.topic, []).append(number)
        self._topics = {name: Topic(self, name, channels[name]) for name in sorted(channels)}
        self._silence: dict[str, Topic] | None = None
        self._pairs: dict[str, Pair] = {}
        self._chosen: set[str] | None = None
        self._begin: int | None = None
        for name in channels:
            base = name.removesuffix("/left")
            if base != name and f"{base}/right" in channels and base not in channels:
                self._pairs[base] = Pair(self, base, self._topics[name], self._topics[f"{base}/right"])

    def close(self) -> None:
        """Closes the file; what was taken out of it stays."""
        self._file.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- what it is

    @property
    def complete(self) -> bool:
        """Whether it was closed, and nothing in it was found damaged so far."""
        return not self._file.problems

    @property
    def problems(self) -> list[str]:
        """Sentences about what is wrong with it, as far as it was read."""
        return list(self._file.problems)

    @property
    def why(self) -> str:
        """The reason why it is not complete; else empty."""
        problems = sorted(self._file.problems, key=lambda problem: problem != CUT)
        return "; ".join(problems[:5]) + (f"; and {len(problems) - 5} more" if len(problems) > 5 else "")

    @property
    def profile(self) -> str:
        """Whose it is; ``"trocar"`` where trocar recorded it."""
        return self._file.profile

    @property
    def begin_ns(self) -> int:
        """When its first message was recorded, ns of the recorder's clock."""
        if self._begin is None:
            self._begin = min((s[0] for c in self._file.summary.channels if (s := self._file.span(c))), default=0)
        return self._begin

    @property
    def duration_s(self) -> float:
        """From its first message to its last, s."""
        last = max((s[1] for c in self._file.summary.channels if (s := self._file.span(c))), default=self.begin_ns)
        return (last - self.begin_ns) / 1e9

    @property
    def begin(self) -> Any:
        """Date and time of its first message, UTC; None where it does not tell its clock."""
        import datetime

        offset = self._unix_offset()
        if offset is None:
            return None
        since = datetime.timedelta(microseconds=(self.begin_ns + offset) // 1000)
        return datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc) + since

    def _unix_offset(self) -> int | None:
        """ns from the clock of its stamps to the time since 1970. Others than trocar take that time for their stamps."""
        told = self.metadata.get("trocar.clock", {}).get("offset_to_unix_ns", "")
        if told.lstrip("-").isdecimal():
            return int(told)
        return None if self.profile == "trocar" else 0

    def _index(self, pd: Any, stamps: np.ndarray, clock: str) -> Any:
        if clock == "ns":
            return pd.Index(stamps, name="t_ns")
        if clock == "recording":
            limit = (1 << 63) - 1
            if len(stamps) and max(int(stamps.max()), self.begin_ns) > limit:
                raise invalid(f'{self.file} has stamps that are no times: take clock="ns"', "OUT_OF_RANGE", file=self.file)
            # Whole numbers are subtracted: a float does not hold the ns of a clock.
            return pd.Index((stamps.astype("i8") - np.int64(min(self.begin_ns, limit))) / 1e9, name="t")
        offset = self._unix_offset()
        if offset is None:
            raise invalid(
                f'{self.file} does not tell the time on the wall (trocar.clock): take clock="recording"', "NOT_TOLD", file=self.file
            )
        limit = (1 << 63) - 1
        if len(stamps) and not -limit <= int(stamps.min()) + offset <= int(stamps.max()) + offset <= limit:
            raise invalid(f'{self.file} has stamps that are no dates: take clock="ns"', "OUT_OF_RANGE", file=self.file)
        dates = np.array([int(s) + offset for s in stamps], "i8").view("M8[ns]")
        return pd.DatetimeIndex(dates, name="time").tz_localize("UTC")

    # ---- its topics

    @property
    def topics(self) -> dict[str, Topic]:
        """All topics by name, those that were recorded and gave nothing among them."""
        if self._chosen is not None:
            return {n: t for n, t in self._topics.items() if n in self._chosen}
        if self._silence is None:
            # A tap or a pair has its topics below its name.
            gave = {n for n in self._topics if len(self._topics[n])}
            names = [n for n in sorted(self.losses.silent) if not any(g == n or g.startswith(f"{n}/") for g in gave)]
            self._silence = {n: Topic(self, n, []) for n in names if n not in self._topics}
        return dict(sorted({**self._topics, **self._silence}.items()))

    def __getitem__(self, topic: str) -> Any:
        if not isinstance(topic, str):
            raise KeyError(f"{self.file} has topics by name; {topic!r} is none")
        topics = self.topics
        for name in (topic, f"/{topic}"):
            if name in topics:
                return topics[name]
            if name in self._pairs and self._chosen is None:
                return self._pairs[name]
        known = [*topics, *self._pairs]
        ends = next((name for name in known if name.endswith(f"/{topic}")), None)
        near = f"; did you mean {ends}?" if ends else nearest(topic if topic.startswith("/") else f"/{topic}", known)
        shown = ", ".join(known[:12]) + (f" and {len(known) - 12} more" if len(known) > 12 else "")
        it_has = f"{near} It has" if near else "; it has"
        raise KeyError(f"{self.file} has no topic {topic!r}{it_has} {shown or 'none'}")

    def __iter__(self) -> Iterator[str]:
        return iter(self.topics)

    def __len__(self) -> int:
        return len(self.topics)

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = object.__hash__

    def _ipython_key_completions_(self) -> list[str]:
        names = [*self.topics, *self._pairs]
        return [*(n.lstrip("/") for n in names), *names]

    def table(
        self,
        fields: Any,
        *,
        on: str | None = None,
        rate_hz: float | None = None,
        how: str = "nearest",
        tolerance: float | None = None,
        start: float | None = None,
        end: float | None = None,
        time: str = "publish_time",
        clock: str = "recording",
    ) -> Any:
        """One ``DataFrame`` of several topics. ``fields`` are topics, or columns of them: ``"robot/arm/tip.pose.position[0]"``.

        A row is for each message of the topic ``on`` (the first of ``fields`` unless it is named), or ``rate_hz`` rows are made per second.
        A value is that of the message that is ``"nearest"``, the ``"previous"`` one, or on the line between both neighbours
        (``"linear"``: floats; all else is taken from the previous). Where that message is more than ``tolerance`` s away the value
        is missing; unless it is given it is twice the median distance of the topic's messages, 0 where they have none. ``attrs`` has
        ``units``, ``beyond`` (how many values are missing by that, by column), ``tolerance_s`` (by topic) and ``notes``.
        """
        return aligned(self, fields, on, rate_hz, how, tolerance, start, end, time, clock)

    def __repr__(self) -> str:
        return as_text(self)

    def _repr_html_(self) -> str:
        return as_html(self)


def read(file: Any, topics: Any = None, start: float | None = None, end: float | None = None) -> Recording:
    """Reads a recording into memory. ``topics`` are names or globs of those wanted (all by default); ``start`` and ``end`` bound it,
    s since its first message. ``trocar.Recording(file)`` reads what is asked for alone.
    """
    out = Recording(file)
    wanted = [globbed(t if t.startswith(("/", "*")) else "/" + t) for t in ([topics] if isinstance(topics, str) else topics or ())]
    chosen = {n: t for n, t in out._topics.items() if not wanted or any(w.match(n) for w in wanted)}
    low = 0 if start is None else max(out.begin_ns + round(start * 1e9), 0)
    high = None if end is None else out.begin_ns + round(end * 1e9)
    by_channel = {c: t for t in chosen.values() for c in t._channels}
    # Frames are counted with those that cannot be read.
    every: dict[str, list[Any]] = {n: [] for n in chosen}
    for topic in chosen.values():
        topic._kept = []
    for m in out._file.messages(set(by_channel), True, low, high):
        if m.log_time >= low and (high is None or m.log_time <= high):
            topic = by_channel[m.channel]
            taken = topic._taken(m)
            every[topic.name].append(taken or (m, None))
            if taken is not None and topic._kept is not None:
                topic._kept.append(taken)
    for n, topic in chosen.items():
        if topic.unreadable:
            topic._frames = Frames(topic, every[n])
    out._chosen = {n for n, t in chosen.items() if len(t) or not wanted}
    return out
