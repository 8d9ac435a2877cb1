"""Plots of signals: sampled in a thread, drawn by matplotlib live in a window or a notebook, or into a file without a screen.

Invariant: sampling needs no matplotlib and no screen; what could not be read is a gap in the line and counted, never an old value.
"""

from __future__ import annotations

import asyncio
import base64
import collections
import re
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _values
from ._errors import TrocarError, invalid
from ._paths import path_of
from ._words import counted

_STEP = re.compile(r"\.([A-Za-z_][A-Za-z0-9_]*)|\[(-?\d+)\]")
_MOST = 200_000
# Least time between two pictures in a notebook, s; and how many times longer than drawing one takes.
_RENEWED_S, _RENEWED_TIMES = 0.5, 4


class Signal:
    """One thing to plot: a path, and which number in its value."""

    def __init__(self, session: Any, text: str) -> None:
        self.text = text
        self.missed = 0
        self.why = ""
        self.path, self._steps = _split(session, text)
        self._read: Callable[[], tuple[int, Any]] = _reader(session, self.path)
        stamp, value = self._read()
        self.unit = _applies(session, self.path, self._steps, _unit(value, self._steps))
        self.first = (stamp, self.pick(value))
        self.points: collections.deque[tuple[float, float]] = collections.deque(maxlen=_MOST)
        self.began_ns = stamp

    def pick(self, value: Any) -> float:
        """The number that is meant, in its unit."""
        for name, index in self._steps:
            try:
                value = value[name] if name else value[int(index)]
            except (KeyError, ValueError):
                there = f"there are {', '.join(_fields(value))}" if _fields(value) else "it has no fields"
                raise invalid(f"{self.text}: there is no field {name!r} in it; {there}", field=self.text) from None
            except (IndexError, TypeError):
                length = len(value) if hasattr(value, "__len__") else 0
                raise invalid(f"{self.text}: there is no item {name or index} in it; it has {length}", field=self.text) from None
        try:
            return float(value)
        except (TypeError, ValueError):
            fields = _fields(value)
            hint = f"name one of its fields: {', '.join(f'.{f}' for f in fields)}" if fields else "name one item: [0]"
            raise invalid(f"{self.text} is no single number; {hint}", field=self.text) from None

    def sample(self, lock: threading.Lock) -> None:
        """Looks once."""
        point = None
        try:
            stamp, value = self._read()
            point = ((stamp - self.began_ns) / 1e9, self.pick(value))
        except TrocarError as e:
            self.missed, self.why = self.missed + 1, str(e)
        with lock:
            last = self.points[-1] if self.points else None
            if point is None and last is not None:
                self.points.append((last[0], np.nan))
            elif point is not None and (last is None or point[0] > last[0] or np.isnan(last[1])):
                self.points.append(point)


def _fields(value: Any) -> list[str]:
    return list(value) if isinstance(value, _values.Record) else list(getattr(getattr(value, "dtype", None), "names", None) or ())


def _split(session: Any, text: str) -> tuple[str, list[tuple[str, str]]]:
    """``robot/eyerobot/arm/measured_js.position[0]`` in its path and ``position``, ``0``. Names of processes and components may have
    dots; what is there decides.
    """
    if not isinstance(text, str):
        return path_of(text, (2, 3, 4)), []
    head, _, last = text.rpartition("/")
    if not head:
        return path_of(text, (2, 3, 4)), []
    ends = [i for i, c in enumerate(last) if c in ".["] if head.count("/") != 0 or "[" in last or "." in last else []
    if head.count("/") == 0 and f"{head}/{last}" in session._graph.components:
        ends = []
    at = len(last)
    for end in reversed(ends) if head.count("/") == 0 else ends:
        if head.count("/") != 0 or f"{head}/{last[:end]}" in session._graph.components:
            at = end
            break
    path, rest = path_of(f"{head}/{last[:at]}", (2, 3, 4)), last[at:]
    steps = [(m.group(1) or "", m.group(2) or "") for m in _STEP.finditer(rest)]
    if "".join(m.group(0) for m in _STEP.finditer(rest)) != rest:
        raise invalid(f"{text}: {rest!r} names no field; write .field, [0], or .field[0]", field=text)
    return path, steps


def _reader(session: Any, path: str) -> Callable[[], tuple[int, Any]]:
    """Asks for the newest value and its stamp, ns."""
    if path.count("/") == 3:
        command = session._command(path)
        if command._argument is not None or command._type is None or command.kind != "read":
            raise invalid(f"{path} is a {command.kind} command; only a read without argument can be plotted", "WRONG_KIND")
        request, seconds = command._request((), {}, None, False)

        def read() -> tuple[int, Any]:
            answer = session._wire.call("InteractService/Invoke", request, seconds + 1.0)
            return answer.stamp_ns or time.monotonic_ns(), command._answer(answer)

        return read

    def latest() -> tuple[int, Any]:
        value = session.latest(path)
        stamp = getattr(value, "stamp_ns", None)
        return (int(np.max(stamp)) if stamp is not None else time.monotonic_ns()), value

    return latest


def _unit(value: Any, steps: list[tuple[str, str]]) -> str:
    unit = ""
    for name, _ in steps:
        if not name:
            value = value[0] if hasattr(value, "__len__") and len(value) else value
            continue
        unit = getattr(value, "units", {}).get(name, "")
        try:
            value = value[name]
        except (KeyError, ValueError, IndexError, TypeError):
            break
    return getattr(value, "unit", "") or unit


def _applies(session: Any, path: str, steps: list[tuple[str, str]], unit: str) -> str:
    """Of ``m|rad`` the one that is a joint's unit, by the interface's ``configuration_js``; both where nobody tells."""
    joint = next((int(index) for name, index in steps if not name), None)
    ways = dict(zip(("PRISMATIC", "REVOLUTE"), unit.split("|")))
    if len(ways) < 2 or joint is None or path.count("/") != 3:
        return unit
    try:
        kind = session.call(f"{path.rpartition('/')[0]}/configuration_js")["kinds"][joint]
    except (TrocarError, KeyError, IndexError):
        return unit
    return ways.get(getattr(kind, "name", str(kind)), unit)


class Plot:
    """Signals over the last ``seconds``. ``data()`` are the samples, ``save(file)`` draws them, ``wait()`` waits until the window is full,
    ``stop()`` ends the sampling. In a notebook it is a picture that is renewed between cells, twice a second at most, until then.
    """

    def __init__(self, session: Any, signals: tuple[Any, ...], seconds: float, rate_hz: float, title: str) -> None:
        if not signals:
            raise invalid('plot: name a signal, e.g. "robot/eyerobot/arm/measured_js.position[0]"', field="signals")
        if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not 0 < seconds <= 86_400:
            raise invalid(f"seconds is {seconds!r}; give a time above 0, at most a day", field="seconds")
        if isinstance(rate_hz, bool) or not isinstance(rate_hz, (int, float)) or not 0 < rate_hz <= 500:
            raise invalid(f"rate_hz is {rate_hz!r}; give a rate above 0, at most 500 Hz", field="rate_hz")
        self.seconds, self.rate_hz, self.title = float(seconds), float(rate_hz), title
        self.signals = [Signal(session, s) for s in signals]
        first = min(s.began_ns for s in self.signals)
        for signal in self.signals:
            signal.began_ns = first
            signal.points.append(((signal.first[0] - first) / 1e9, signal.first[1]))
        self._lock = threading.Lock()
        self._full, self._ended = threading.Event(), threading.Event()
        self._session = session
        self._figure: Any = None
        self._timer: Any = None
        self._picture: Any = None
        threading.Thread(target=self._sample, name="trocar-plot", daemon=True).start()
        self._show()

    def _sample(self) -> None:
        pause, began = 1 / self.rate_hz, time.monotonic()
        due = began
        while not self._ended.is_set() and not self._session.closed:
            for signal in self.signals:
                try:
                    signal.sample(self._lock)
                except Exception as e:  # Whatever one look meets, the next one is made.
                    signal.missed, signal.why = signal.missed + 1, str(e)
            with self._lock:
                newest = max((s.points[-1][0] for s in self.signals if s.points), default=0.0)
                for signal in self.signals:
                    while signal.points and signal.points[0][0] < newest - self.seconds:
                        signal.points.popleft()
            if time.monotonic() - began >= self.seconds:
                self._full.set()
            due = max(due + pause, time.monotonic())
            self._ended.wait(due - time.monotonic())
        self._full.set()

    def data(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Times, s since the first sample, and values, in their unit, by signal."""
        with self._lock:
            points = {s.text: np.array(s.points, dtype=float).reshape(-1, 2) for s in self.signals}
        return {text: (p[:, 0], p[:, 1]) for text, p in points.items()}

    def wait(self, timeout: float | None = None) -> Plot:
        """Until the window is full."""
        self._full.wait(self.seconds + 5 if timeout is None else timeout)
        return self

    def stop(self) -> None:
        """Ends the sampling; what was sampled stays."""
        self._ended.set()
        if self._timer is not None:
            self._timer.stop()

    def save(self, file: str, *, wait: bool = True, dpi: int = 120) -> str:
        """Draws what is in the window into a file (PNG, SVG, PDF by its name), waiting for a full window unless ``wait=False``."""
        matplotlib = _matplotlib()
        if wait:
            self.wait()
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        figure = matplotlib.figure.Figure(figsize=(8, 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        self._draw(figure)
        figure.savefig(file, dpi=dpi)
        return file

    def _draw(self, figure: Any) -> None:
        figure.clear()
        axes = figure.add_subplot()
        units = []
        for signal, (t, v) in zip(self.signals, self.data().values()):
            axes.plot(t, v, label=f"{signal.text}{f', {signal.unit}' if signal.unit else ''}", linewidth=1.4)
            units += [signal.unit] if signal.unit not in units else []
        axes.set_xlabel("time, s")
        axes.set_ylabel(", ".join(u for u in units if u) or "value")
        axes.set_title(self.title or (self.signals[0].text if len(self.signals) == 1 else ""))
        axes.grid(True, alpha=0.3)
        if len(self.signals) > 1:
            axes.legend(loc="best", fontsize="small")

    def _show(self) -> None:
        """Opens a window that keeps itself up to date, where this process has a screen and matplotlib."""
        try:
            import matplotlib
            import matplotlib.pyplot as plt
        except ImportError:
            return
        if matplotlib.get_backend().lower() in ("agg", "pdf", "svg", "ps", "template", "cairo") or "inline" in matplotlib.get_backend():
            return
        self._figure = plt.figure(figsize=(8, 4.2), layout="constrained")
        self._timer = self._figure.canvas.new_timer(interval=100)
        self._timer.add_callback(self._redraw)
        self._figure.canvas.mpl_connect("close_event", lambda _: self.stop())
        self._timer.start()
        plt.show(block=False)

    def _redraw(self) -> None:
        self._draw(self._figure)
        self._figure.canvas.draw_idle()

    def _ipython_display_(self) -> None:
        # Where this says NotImplementedError, IPython goes on to `_repr_png_` and `repr`.
        loop = _kernel_loop()
        if loop is None or self._figure is not None:
            raise NotImplementedError
        bundle = self._bundle()
        if self._picture is not None:
            self._picture.display(bundle, raw=True)
            return
        from IPython.display import display

        self._picture = display(bundle, raw=True, display_id=True)
        loop.call_later(_RENEWED_S, self._renew, loop)

    def _renew(self, loop: asyncio.AbstractEventLoop) -> None:
        """Draws the picture anew. The kernel's loop does it, in the thread that cells run in: matplotlib knows no other."""
        began, last = loop.time(), self._ended.is_set() or self._session.closed
        self._picture.update(self._bundle(), raw=True)
        if not last:
            loop.call_later(max(_RENEWED_S, _RENEWED_TIMES * (loop.time() - began)), self._renew, loop)

    def _bundle(self) -> dict[str, str]:
        png = self._repr_png_()
        if png is None:
            raise NotImplementedError
        return {"image/png": base64.b64encode(png).decode(), "text/plain": repr(self)}

    def _repr_png_(self) -> bytes | None:
        import io

        try:
            _matplotlib()
        except TrocarError:
            return None
        out = io.BytesIO()
        self.save(out, wait=False)  # type: ignore[arg-type]
        return out.getvalue()

    def __repr__(self) -> str:
        shown = ", ".join(f"{s.text}{f' ({s.unit})' if s.unit else ''}" for s in self.signals)
        count = sum(len(s.points) for s in self.signals)
        missed = sum(s.missed for s in self.signals)
        lost = f", {missed} missed: {self.signals[0].why}" if missed else ""
        return f"<plot of {shown} over {self.seconds:g} s at {self.rate_hz:g} Hz: {counted(count, 'sample')}{lost}>"


def _kernel_loop() -> asyncio.AbstractEventLoop | None:
    """The loop of the notebook's kernel, where this is one; IPython in a terminal has none that would show pictures."""
    getter = getattr(sys.modules.get("IPython"), "get_ipython", None)
    if getattr(getter() if getter is not None else None, "kernel", None) is None:
        return None
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None


def _matplotlib() -> Any:
    try:
        import matplotlib
        import matplotlib.figure
    except ImportError:
        raise TrocarError(
            "FAILED_PRECONDITION",
            "NOT_INSTALLED",
            "plots need matplotlib: pip install matplotlib; data() works without",
        ) from None
    return matplotlib
