"""Recordings from Python: a recorder beside the data, made for the time of a ``with`` block, driven and taken away again.

Invariant: samples never pass through Python; whatever happens in the block, the file is closed and the recorder is removed, or the
error names the one that is left behind, and it is known until it is gone.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Mapping
from typing import Any

from . import _proto, _values
from ._errors import TrocarError, invalid
from ._hold import Hold
from ._paths import globbed, nearest, path_of
from ._words import counted

_CLASS = "recorder/recorder"
_MOST = 1024
# Samples that may wait, at most, and bytes of them; frames that may: a queue leaves their pool enough for its owner.
_DEEPEST, _QUEUE_BYTES, _FRAMES = 4096, 16 << 20, 64
_BEGUN = ("RECORDING", "PAUSED")


class LiveRecording:
    """A recording of what some patterns name.

    It is armed at once: a recorder is made, connected and started, and keeps the last ``pre_trigger`` seconds. ``with`` (or
    ``start()``) begins the file, the end of the block (or ``stop()``) closes it and takes the recorder away. ``path`` is the file as the
    recorder's process sees it, ``topics`` what is recorded, ``result`` the figures of the finished file, ``read()`` the file itself.
    ``component`` is the recorder; empty = it is gone. While the GCM is gone it goes on recording, and ``stop()`` works once that is back.
    It ends with this process, a kill included: its file is closed and the recorder removed.
    """

    def __init__(
        self,
        session: Any,
        name: str,
        patterns: Iterable[str],
        pre_trigger: float = 0.0,
        *,
        process: str = "",
        directory: str = "",
        video: str = "raw",
        max_rate_hz: Mapping[str, float] | float = 0.0,
        cpus: Iterable[int] | int = (),
        config: Mapping[str, Any] | None = None,
    ) -> None:
        if not isinstance(name, str) or not name:
            raise invalid(f'record: the name of the recording is a text such as "trial7"; {name!r} is none', field="name")
        if ".." in name.split("/") or not name.isprintable():
            raise invalid(f'record: {name!r} is no name of a file in the recorder\'s directory; give one such as "trial7"', field="name")
        if isinstance(pre_trigger, bool) or not isinstance(pre_trigger, (int, float)) or not 0 <= pre_trigger <= 3600:
            raise invalid(f"pre_trigger is {pre_trigger!r}; give seconds from 0 to 3600", field="pre_trigger")
        self._session = session
        self.file = name if name.lower().endswith(".mcap") else f"{name}.mcap"
        self.path = ""
        self.result: Any = None
        self.component = ""
        self._running = False
        self._held: Hold | None = None
        wanted = [patterns] if isinstance(patterns, str) else list(patterns)
        self._depths = _matching(session, wanted)
        self.topics = list(self._depths)
        # Above all without a priority, as `trocar record`: what the disk does in the kernel may hold those up for 100 ms.
        execution = _proto.message("Execution")(priority=1, cpus=_numbers(cpus))
        config = {**(config or {}), "video": video, "pre_trigger_s": float(pre_trigger)}
        if directory:
            config["directory"] = directory
        self._arm(name, process or _best_process(session, self.topics), config, max_rate_hz, execution)

    def _arm(self, name: str, process: str, config: dict[str, Any], rate: Any, execution: Any) -> None:
        session = self._session
        inputs = [f"t{i}" for i in range(len(self.topics))]
        config.update(topics=inputs, sources=self.topics)
        if rate:
            config["max_rate_hz"] = [_rate(rate, t) for t in self.topics]
        component = _free(session, process, name)
        Step = _proto.message("Step")
        create = _proto.message("CreateRequest")(**{"class": _CLASS}, path=component)
        create.execution.CopyFrom(execution)
        create.config.CopyFrom(_values.to_wire_struct(config, "config"))
        # Whatever ends this process ends the recorder.
        self._held = Hold(session, component)
        # Its inputs are there once it is configured, so it is made first; whatever fails then takes it away again.
        try:
            created = session._wire.call("GcmService/Create", create, 10.0)
        except BaseException:
            self._held.end()
            raise
        self.component = component
        session._recordings.add(self)
        session._seen(created.revision)
        # Its thread may not have been given what was asked for.
        for text in created.warnings:
            session._say(f"{component}: {text}")
        steps = []
        for name, topic in zip(inputs, self.topics):
            connect = _proto.message("ConnectRequest")(client=f"{component}/{name}", server=topic)
            connect.options.queue.fifo, connect.options.queue.drop_oldest = self._depths[topic], False
            steps.append(Step(connect=connect))
        steps.append(Step(start=_proto.message("StartRequest")(paths=[component])))
        try:
            session._wire.call("GcmService/Apply", _proto.message("ApplyRequest")(steps=steps), 30.0)
        except BaseException:
            self.close()
            raise

    def _ctl(self, command: str, *args: Any, **fields: Any) -> Any:
        if not self.component:
            raise TrocarError("FAILED_PRECONDITION", "WRONG_STATE", f"the recording {self.file} is over; make another")
        return self._session.call(f"{self.component}/ctl/{command}", *args, deadline=5.0, **fields)

    def start(self, *, delay: float = 0.0, duration: float = 0.0) -> LiveRecording:
        """Begins the file, ``delay`` seconds from now, and records for ``duration`` seconds (0: until ``stop``)."""
        __tracebackhide__ = True
        self._ctl("start", path=self.file, delay=float(delay), duration=float(duration))
        self._running = True
        # The recorder begins in its next step; what the caller does then is in the file.
        end = time.monotonic() + 5.0
        while not delay and str(self.status()["phase"]) not in _BEGUN:
            if time.monotonic() > end:
                raise TrocarError("DEADLINE_EXCEEDED", "NOT_REACHED", f"{self.component} did not begin within 5 s; see ire.logs()")
            self._session.sleep(0.005)
        return self

    def stop(self) -> Any:
        """Closes the file and takes the recorder away; answers the figures of the file. After a failure it may be called again."""
        __tracebackhide__ = True
        if not self.component:
            return self.result
        try:
            if self._running:
                self.result = self._end()
                self._running = False
                self.path = str(self.result["path"])
                if self.result["lost"]:
                    self._session._say(f"{self.path}: lost {counted(int(self.result['lost']), 'sample')}; the file tells which")
                if self.result["interrupted"]:
                    times = counted(int(self.result["interrupted"]), "time")
                    self._session._say(f"{self.path}: connections or processes of sources went away {times}; the file tells which")
        finally:
            self.close()
        return self.result

    def _end(self) -> Any:
        __tracebackhide__ = True
        try:
            return self._session.wait_for(f"{self.component}/ctl/stopped", deadline=30.0, call=f"{self.component}/ctl/stop")
        except TrocarError:
            # It has ended by itself: its time was over, or there was no more room.
            last = self._ctl("last")
            if not last["reason"]:
                raise
            return last

    def marker(self, text: str) -> None:
        """Puts a line into the recording, at this time."""
        __tracebackhide__ = True
        self._ctl("marker", text)

    def pause(self) -> None:
        """Leaves out what comes from now on, until ``resume``."""
        __tracebackhide__ = True
        self._ctl("pause")

    def resume(self) -> None:
        """Goes on after ``pause``."""
        __tracebackhide__ = True
        self._ctl("resume")

    def status(self) -> Any:
        """The recording in numbers: messages, bytes, what was lost, s since it began."""
        __tracebackhide__ = True
        return self._ctl("status") if self.component else self.result

    def read(self, **settings: Any) -> Any:
        """The file, once it is closed and where it lies on this machine; see ``trocar.read``."""
        from ._recording import read

        if not self.path:
            raise TrocarError("FAILED_PRECONDITION", "WRONG_STATE", f"{self.file} is not closed yet")
        return read(self.path, **settings)

    def close(self) -> None:
        """Takes the recorder away, whatever it does; its file is closed by that, too. After a failure it may be called again."""
        __tracebackhide__ = True
        if self.component:
            try:
                self._session.remove(self.component, force=True)
            except TrocarError as e:
                # That it is not there any more is what is wanted; of a process that is not there nobody knows what it has.
                if e.reason != "COMPONENT_NOT_FOUND":
                    raise self._left_behind(e) from None
        self.component, self._running = "", False
        if self._held is not None:
            self._held.end()
        self._session._recordings.discard(self)

    def _left_behind(self, e: TrocarError) -> TrocarError:
        sentence = (
            f"the recorder {self.component} is left behind, with what it records: {e.sentence}; once the GCM and its process answer "
            f"again, stop() or close() this recording again, or `trocar rm --force {self.component}`"
        )
        return TrocarError(e.code, e.reason, sentence, {**e.metadata, "component": self.component}, e.violations, e.help)

    def __enter__(self) -> LiveRecording:
        __tracebackhide__ = True
        try:
            return self.start()
        except BaseException:
            self.close()
            raise

    def __exit__(self, *_: object) -> None:
        __tracebackhide__ = True
        self.stop()

    def __repr__(self) -> str:
        how = "recording" if self._running else "armed" if self.component else "over"
        return f"<{self.file}, {how}: {counted(len(self.topics), 'topic')}{f', {self.path}' if self.path else ''}>"


def _numbers(cpus: Any) -> list[int]:
    numbers = list(cpus) if isinstance(cpus, Iterable) and not isinstance(cpus, (str, bytes)) else [cpus]
    if not all(type(n) is int and 0 <= n < 4096 for n in numbers):
        raise invalid(f"record: cpus is {cpus!r}; give numbers of processors, e.g. [1, 2]", field="cpus")
    return numbers


def _rate(rate: Any, topic: str) -> float:
    if not isinstance(rate, Mapping):
        return float(rate)
    return next((float(r) for pattern, r in rate.items() if globbed(pattern).match(topic)), 0.0)


def _depth(port_type: Any) -> int:
    """How many samples of this type may wait."""
    if port_type.WhichOneof("kind") == "frame":
        return _FRAMES
    return min(max(_QUEUE_BYTES // max(port_type.plain.size, 1), 16), _DEEPEST)


def _matching(session: Any, patterns: list[str]) -> dict[str, int]:
    """Outputs that patterns name, with how deep their queues are: ``robot/**``, ``*/camera/image``; a component means all of them."""
    if not patterns or not all(isinstance(p, str) for p in patterns):
        raise invalid('record: name what to record, e.g. ["robot/**"]', field="patterns")
    there: dict[str, int] = {}
    for path in sorted(session._graph.components):
        described = session._graph.describe(path)
        cls = getattr(described.component, "class")
        if cls == _CLASS or session._graph.processes[path.partition("/")[0]].guest:
            continue
        there |= {f"{path}/{o.name}": _depth(o.type) for o in described.ports.outputs if o.type.WhichOneof("kind") != "any"}
    found: dict[str, int] = {}
    for pattern in patterns:
        regex = globbed(pattern if "*" in pattern or pattern.count("/") != 1 else f"{pattern}/**")
        hits = [p for p in there if regex.match(p)]
        if not hits:
            shown = ", ".join(list(there)[:20]) + (f" and {len(there) - 20} more" if len(there) > 20 else "")
            raise TrocarError(
                "NOT_FOUND",
                "NOTHING_MATCHES",
                f"record: {pattern!r} matches no output; there are {shown or 'none'}{nearest(pattern, there)}",
                {"pattern": pattern, "known": ", ".join(there)},
            )
        found.update((p, there[p]) for p in hits)
    if len(found) > _MOST:
        raise invalid(f"record: the patterns name {len(found)} outputs; a recorder takes {_MOST}: name fewer", field="patterns")
    return found


def _best_process(session: Any, topics: list[str]) -> str:
    """Where most of the data are, of the processes that offer a recorder."""
    able = [p.name for p in session._graph.processes.values() if _CLASS in p.classes and not p.guest]
    if not able:
        raise TrocarError(
            "NOT_FOUND",
            "CLASS_NOT_FOUND",
            f"no process offers the class {_CLASS}; put the recorder's plugin into a plugin directory of one of them",
            {"class": _CLASS},
        )
    count = {name: sum(t.startswith(name + "/") for t in topics) for name in able}
    return max(able, key=lambda name: count[name])


def _free(session: Any, process: str, name: str) -> str:
    base = "rec_" + (re.sub(r"[^A-Za-z0-9_]", "_", name.rpartition("/")[2])[:40] or "1")
    for n in range(1, 1000):
        path = path_of(f"{process}/{base}{n if n > 1 else ''}")
        if path not in session._graph.components:
            return path
    raise TrocarError("ALREADY_EXISTS", "COMPONENT_EXISTS", f"{process}/{base} and its like are all taken; remove some")
