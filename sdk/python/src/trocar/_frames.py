"""Frames of a recording: pictures, lines of an OCT, disparity and depth, as numpy arrays and as pictures in a notebook.

Invariant: an array has the values that were sent; only a picture for people is scaled or coloured, and it says so.
"""

from __future__ import annotations

import base64
import html
import struct
from array import array as numbers
from collections.abc import Iterator
from typing import Any

import numpy as np

from ._chunks import Damaged, shown
from ._errors import TrocarError, invalid
from ._png import coloured, png, qoi
from ._words import counted

# Items, colours and what is done for PNG, by the names that the recorder takes from Foxglove.
_PIXELS = {
    "mono8": ("u1", 1), "8UC1": ("u1", 1), "bayer_rggb8": ("u1", 1), "rgb8": ("u1", 3), "bgr8": ("u1", 3), "8UC3": ("u1", 3),
    "rgba8": ("u1", 4), "bgra8": ("u1", 4), "mono16": ("<u2", 1), "16UC1": ("<u2", 1), "16SC1": ("<i2", 1), "32FC1": ("<f4", 1),
    "yuyv": ("u1", 2), "yuv422_yuy2": ("u1", 2),
}  # fmt: skip
_SAMPLES = {"U8": "u1", "U16": "<u2", "F32": "<f4"}
_LARGEST = 1 << 15


class RecordedFrame:
    """One frame. ``array`` are its values, ``format`` what they are (``"rgb8"``, ``"jpeg"``, ``"32FC1"``, ``"U16"``), ``value`` the message
    itself, ``data`` its bytes as they are in the file; ``stamp_ns`` when it was acquired, ``t`` the same in s since the recording began.

    An image is ``(height, width)`` or ``(height, width, colours)`` in the order of its format, OCT ``(lines, samples)``. A message that is
    not what its type says is a frame as well: its ``value`` is None, ``data`` all of the message, and ``array`` is refused.
    """

    def __init__(self, topic: Any, message: Any, value: Any) -> None:
        self._message = message
        self.topic = topic.name
        self.stamp_ns, self.log_time, self.sequence = message.publish_time, message.log_time, message.sequence
        self.t = (message.publish_time - topic._recording.begin_ns) / 1e9
        self.value = value
        self._array: np.ndarray | None = None

    @property
    def data(self) -> bytes:
        """Its bytes."""
        return self._message.data if self.value is None else self.value.data

    @property
    def format(self) -> str:
        """The kind of its values."""
        if self.value is None:
            return ""
        told = getattr(self.value, "encoding", "") or getattr(self.value, "format", "")
        if isinstance(told, str):
            return told
        field = self.value.DESCRIPTOR.fields_by_name["format"]
        word = field.enum_type.values_by_number.get(told) if field.enum_type is not None else None
        return word.name.rpartition("_")[2] if word is not None else str(told)

    @property
    def array(self) -> np.ndarray:
        """Its values; refused where they are of a kind that is not known here, or not all there."""
        if self._array is None:
            self._array = self._decoded()
            self._array.flags.writeable = False
        return self._array

    def _decoded(self) -> np.ndarray:
        value, kind = self.value, self.format
        if value is None:
            raise self._bad("it is not what its type says")
        if kind == "qoi":
            found = qoi(self.data)
            if found is None:
                raise self._bad("it is no QOI image")
            return found
        if kind in ("jpeg", "jpg", "png", "webp"):
            return self._by_pillow()
        if hasattr(value, "lines") and hasattr(value, "samples") and kind in _SAMPLES:
            item = np.dtype(_SAMPLES[kind])
            if value.lines * value.samples * item.itemsize > len(self.data):
                raise self._bad(f"it has {len(self.data)} bytes for {value.lines} lines of {value.samples}")
            return np.frombuffer(self.data, item, value.lines * value.samples).reshape(value.lines, value.samples)
        if kind in _PIXELS and hasattr(value, "step"):
            return self._image(np.dtype(_PIXELS[kind][0]), _PIXELS[kind][1])
        if hasattr(value, "encoding") or hasattr(value, "width"):
            raise self._bad(f"pixels of the kind {kind!r} are not known here")
        return np.frombuffer(self.data, "u1")

    def _image(self, item: np.dtype, colours: int) -> np.ndarray:
        width, height, step = self.value.width, self.value.height, self.value.step
        row = width * colours * item.itemsize
        fits = 0 < width <= _LARGEST and 0 < height <= _LARGEST and step >= row and len(self.data) >= step * (height - 1) + row
        if not fits:
            raise self._bad(f"{len(self.data)} bytes are not the {width} x {height} pixels that it says")
        out = np.ndarray((height, width, colours), item, self.data, 0, (step, colours * item.itemsize, item.itemsize))
        return np.ascontiguousarray(out[:, :, 0] if colours == 1 else out)

    def _by_pillow(self) -> np.ndarray:
        try:
            from io import BytesIO

            from PIL import Image
        except ImportError:
            sentence = f"values of a {self.format} image need Pillow: pip install pillow; `data` has the image as it is"
            raise TrocarError("FAILED_PRECONDITION", "NOT_INSTALLED", sentence) from None
        try:
            return np.array(Image.open(BytesIO(self.data)))
        except Exception as e:  # Damaged images end in whatever the decoder makes of them.
            raise self._bad(f"it is no {self.format} image ({type(e).__name__})") from None

    def _bad(self, why: str) -> TrocarError:
        sentence = f"the frame of {self.topic} at {self.t:.3f} s cannot be shown as numbers: {why}; `data` has its bytes"
        return invalid(sentence, "FRAME_INVALID", topic=self.topic)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        out = self.array if dtype is None else self.array.astype(dtype)
        return out.copy() if copy else out

    # ---- as a picture

    def _picture(self) -> tuple[np.ndarray | None, str]:
        """Pixels for PNG, and what was done to the values for it."""
        values, kind = self.array, self.format
        if (
            values.ndim not in (2, 3)
            or 0 in values.shape
            or max(values.shape[:2]) > _LARGEST
            or (values.ndim == 3 and values.shape[2] == 2)
        ):
            return None, ""
        if kind in ("bgr8", "bgra8"):
            order = [2, 1, 0, 3][: values.shape[2]]
            return values[:, :, order], ""
        if values.dtype == np.uint8:
            return values, ""
        pixels, low, high = coloured(values)
        return pixels, f"{self.format}: colours from {low:g} (blue) to {high:g} (red)"

    @property
    def shown(self) -> str:
        """A sentence on how its values are shown as colours: those of 16 bit and floats are. Empty where they are shown as they are."""
        return self._picture()[1]

    def to_png(self, path: Any) -> str:
        """Writes it as PNG: 8 bit and ``mono16`` as they are, all else in colours, as the answer says (empty where nothing was changed)."""
        if self.format in ("mono16", "16UC1"):
            pixels, said = self.array, ""
        else:
            pixels, said = self._picture()
        if pixels is None:
            raise self._bad(f"PNG has no word for {self.format}")
        with open(path, "wb") as out:
            out.write(png(pixels))
        return said

    def _repr_png_(self) -> bytes | None:
        if self.format in ("jpeg", "jpg"):
            return None
        try:
            pixels, _ = self._picture()
        except TrocarError:
            return None
        return png(pixels) if pixels is not None else None

    def _repr_jpeg_(self) -> bytes | None:
        return self.data if self.format in ("jpeg", "jpg") else None

    def _repr_html_(self) -> str | None:
        """Only of what is scaled: the picture, and below it how."""
        try:
            pixels, said = self._picture() if self.format not in ("jpeg", "jpg") else (None, "")
        except TrocarError:
            return None
        if pixels is None or not said:
            return None
        source = base64.b64encode(png(pixels)).decode()
        return f"<div><img src='data:image/png;base64,{source}'/><p>{html.escape(said)}</p></div>"

    def __repr__(self) -> str:
        size = f"{self.value.width} x {self.value.height} " if hasattr(self.value, "width") else ""
        size = f"{self.value.lines} x {self.value.samples} " if hasattr(self.value, "lines") and hasattr(self.value, "samples") else size
        return f"<frame of {self.topic}: {size}{self.format or 'bytes'}, {len(self.data)} B, {self.t:.3f} s>"


class Frames:
    """The frames of a topic: ``frames[17]``, ``frames[::10]`` (a list), or one after the other.

    Each message has a number and is a frame, so that numbers, ``len``, ``stamps`` and a loop agree; one that cannot be read says so when
    its ``array`` is asked for.
    """

    def __init__(self, topic: Any, every: list[tuple[Any, Any]] | None = None) -> None:
        self._topic = topic
        self._every = every
        self._places: Any = None

    def _held(self) -> list[tuple[Any, Any]] | None:
        """Messages in memory, where all of them are."""
        return self._every if self._every is not None else self._topic._kept if not self._topic.unreadable else None

    def _known(self) -> Any:
        """The place and time of each; nothing else is read for it."""
        if self._places is None:
            places = numbers("Q")
            for m in self._topic._raw(False):
                places.extend((*m.place, m.publish_time))
            self._places = np.frombuffer(places, "u8").reshape(-1, 3) if places else np.zeros((0, 3), "u8")
        return self._places

    @property
    def stamps(self) -> np.ndarray:
        """When each was acquired, ns."""
        held = self._held()
        return self._known()[:, 2].copy() if held is None else np.array([m.publish_time for m, _ in held], "u8")

    def __len__(self) -> int:
        held = self._held()
        return len(self._known() if held is None else held)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(len(self)))]
        n = number.__index__()
        if not -len(self) <= n < len(self):
            raise IndexError(f"{self._topic.name} has {len(self)} frames; {n} is none of them")
        n %= len(self)
        held = self._held()
        if held is not None:
            return RecordedFrame(self._topic, *held[n])
        file, before = self._topic._recording._file, self._topic.unreadable
        try:
            found = file.at((int(self._known()[n, 0]), int(self._known()[n, 1])))
        except (Damaged, struct.error) as e:
            problem = str(e) if isinstance(e, Damaged) else shown(e)
            file.say(problem)
            raise invalid(
                f"frame {n} of {self._topic.name} cannot be read any more: {problem}", "FRAME_INVALID", topic=self._topic.name
            ) from None
        taken = self._topic._taken(found) or (found, None)
        # Only whole ways through the file count them.
        self._topic.unreadable = before
        return RecordedFrame(self._topic, *taken)

    def __iter__(self) -> Iterator[RecordedFrame]:
        held = self._held()
        if held is None:
            self._topic.unreadable = 0
        for m in held if held is not None else self._topic._raw():
            yield RecordedFrame(self._topic, *(m if held is not None else self._topic._taken(m) or (m, None)))

    def __repr__(self) -> str:
        return f"<{counted(len(self), 'frame')} of {self._topic.name}>"
