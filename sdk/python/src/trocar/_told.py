"""The recorder's own words on the recording and on the system at the time: losses, markers, graph, configurations, plugins.

Invariant: what a file does not tell is None or empty, never a zero that looks like a count.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from ._words import counted


class Loss(NamedTuple):
    """Samples of an output that were lost, and how often its source went away."""

    lost: int
    interrupted: int


class Marker(NamedTuple):
    """A line that somebody put into the recording; ``t`` is s since the recording began, ``stamp_ns`` the recorder's clock."""

    t: float
    text: str
    stamp_ns: int


class Losses(Mapping):
    """Losses by output: ``losses["/robot/arm/tip"].lost``. ``silent`` are outputs that were recorded and gave nothing.

    ``told`` is false where no recorder told of losses: then nothing is known of them. ``final`` is false where the file has no end:
    what was lost after its last word is not known.
    """

    def __init__(self) -> None:
        self.told = self.final = False
        self.lost = self.interrupted = 0
        self.silent: set[str] = set()
        self._all: dict[str, Loss] = {}

    def __getitem__(self, output: str) -> Loss:
        return self._all[output] if output in self._all else self._all["/" + output]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def of(self, topic: str) -> Loss:
        """The losses of the output that a topic belongs to."""
        while topic:
            if topic in self._all:
                return self._all[topic]
            topic = topic.rpartition("/")[0]
        return Loss(0, 0)

    def _set(self, lost: Mapping[str, Any], interrupted: Mapping[str, Any]) -> None:
        for name in sorted({*lost, *interrupted}):
            self._all[name] = Loss(_whole(lost.get(name)), _whole(interrupted.get(name)))
        self.lost, self.interrupted = (sum(of) for of in zip(*self._all.values())) if self._all else (0, 0)

    def __repr__(self) -> str:
        if not self.told:
            return "<losses are not told in it>"
        lines = [f"{name}: {loss.lost} lost, {counted(loss.interrupted, 'interruption')}" for name, loss in self._all.items()]
        lines += [f"{name}: recorded, and gave nothing" for name in sorted(self.silent)]
        end = "" if self.final else ", as far as it was told before the file was cut off"
        return "\n".join([f"{self.lost} lost, {counted(self.interrupted, 'interruption')}{end}", *(f"  {line}" for line in lines)])


class Told:
    """The part of a recording that its recorder tells."""

    _file: Any
    begin_ns: int
    _topics: dict[str, Any]

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata that the recorder wrote, by name."""
        if "_metadata" not in self.__dict__:
            self._metadata = self._file.metadata()
        return self._metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files inside of the file, by name."""
        return self._file.attachments()

    @property
    def losses(self) -> Losses:
        """Losses as the recorder told them at the end, or last before the file was cut off."""
        if "_losses" not in self.__dict__:
            self._losses = self._lost()
        return self._losses

    def _lost(self) -> Losses:
        out = Losses()
        end = self.metadata.get("trocar.end", {})
        if "lost" in end:
            out.told = out.final = True
            by: dict[str, dict[str, Any]] = {"lost": {}, "interrupted": {}, "messages": {}}
            for key, value in end.items():
                what, colon, topic = key.partition(":")
                if colon and what in by:
                    by[what][topic] = value
            out._set(by["lost"], by["interrupted"])
            out.lost, out.interrupted = _whole(end["lost"]), _whole(end.get("interrupted"))
            out.silent = {t for t, n in by["messages"].items() if n == "0"}
        else:
            last = None
            for told in self._say("/recorder/loss"):
                last = told
            if last is not None:
                out.told = True
                out._set(*(last.get(k) if isinstance(last.get(k), dict) else {} for k in ("topics", "interrupted")))
                out.silent = {t for t in last.get("silent") or () if isinstance(t, str)}
        return out

    @property
    def markers(self) -> list[Marker]:
        """Lines that were put into the recording."""
        topic = self._topics.get("/recorder/markers")
        return [Marker(s.t, getattr(s.value, "message", ""), s.publish_time) for s in (topic or ()) if hasattr(s.value, "DESCRIPTOR")]

    def graph_at(self, t: float) -> Any:
        """The graph of the system as it was known ``t`` s after the recording began."""
        return next((told for told in reversed(list(self._say("/recorder/graph", t)))), None)

    @property
    def graph(self) -> Any:
        """The graph of the system when the recording began: components, connections; None where it is not told."""
        first = next(self._say("/recorder/graph"), None)
        if first is None:
            try:
                first = json.loads(self.metadata.get("trocar.graph", {}).get("json", "null"))
            except ValueError:
                first = None
        return first

    @property
    def config(self) -> dict[str, Any]:
        """The configuration of each component when the recording began, by path."""
        found: dict[str, Any] = {}
        for told in self._say("/recorder/config"):
            if isinstance(told.get("path"), str):
                found.setdefault(told["path"], told.get("config"))
        return found

    def config_at(self, t: float) -> dict[str, Any]:
        """The configuration of each component ``t`` s after the recording began, by path."""
        return {told["path"]: told.get("config") for told in self._say("/recorder/config", t) if isinstance(told.get("path"), str)}

    @property
    def plugins(self) -> dict[str, str]:
        """Version and sha256 of the plugins, by name."""
        return dict(self.metadata.get("trocar.plugins", {}))

    def _say(self, topic: str, until: float | None = None) -> Iterator[dict[str, Any]]:
        """Messages of one of the recorder's own topics, all or until then."""
        for sample in self._topics.get(topic) or ():
            if until is not None and (sample.log_time - self.begin_ns) / 1e9 > until:
                return
            if isinstance(sample.value, dict):
                yield sample.value


def _whole(value: Any) -> int:
    try:
        return int(value or 0)
    except (TypeError, ValueError):
        return 0
