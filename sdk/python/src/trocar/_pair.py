"""Both images of a stereo pair, which a recording has as two topics ``…/left`` and ``…/right``.

Invariant: two images are a pair only where they were acquired at the same time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ._errors import invalid
from ._png import png
from ._words import counted


class StereoFrame:
    """A pair: ``left`` and ``right`` are frames; ``array`` has a leading 2. ``right`` is None where it was not recorded."""

    def __init__(self, left: Any, right: Any) -> None:
        self.left, self.right = left, right
        self.topic, self.stamp_ns, self.log_time, self.t, self.format = left.topic, left.stamp_ns, left.log_time, left.t, left.format

    @property
    def array(self) -> np.ndarray:
        """Both images, left first."""
        if self.right is None:
            raise invalid(f"the right image at {self.t:.3f} s was not recorded; `left` is there", "FRAME_INVALID", topic=self.topic)
        return np.stack([self.left.array, self.right.array])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self.array if dtype is None else self.array.astype(dtype)

    def _pixels(self) -> np.ndarray | None:
        halves = [f._picture()[0] for f in (self.left, self.right) if f is not None]
        return None if any(h is None for h in halves) else np.concatenate(halves, axis=1)

    def to_png(self, path: Any) -> str:
        """Writes both beside each other as PNG; answers what was done to their values for it."""
        pixels = self._pixels()
        if pixels is None:
            raise invalid(f"PNG has no word for {self.format}", "FRAME_INVALID", topic=self.topic)
        with open(path, "wb") as out:
            out.write(png(pixels))
        return self.left.shown

    def _repr_png_(self) -> bytes | None:
        # Two JPEG images are no one: the left one is shown as it is.
        if self.left.format in ("jpeg", "jpg"):
            return None
        pixels = self._pixels()
        return None if pixels is None else png(pixels)

    def _repr_jpeg_(self) -> bytes | None:
        return self.left._repr_jpeg_()

    def __repr__(self) -> str:
        return f"<pair of {self.topic.rpartition('/')[0]}, {self.t:.3f} s: {self.left!r}, {self.right!r}>"


class Pairs:
    """Pairs by number, by slice, or one after the other, as many as there are left images."""

    def __init__(self, left: Any, right: Any) -> None:
        self._left, self._right = left, right
        self._by_stamp: dict[int, int] | None = None

    def __len__(self) -> int:
        return len(self._left)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(len(self)))]
        return self._with(self._left[number])

    def _with(self, left: Any) -> StereoFrame:
        if self._by_stamp is None:
            self._by_stamp = {int(stamp): n for n, stamp in enumerate(self._right.stamps)}
        n = self._by_stamp.get(left.stamp_ns)
        return StereoFrame(left, None if n is None else self._right[n])

    def __iter__(self) -> Iterator[StereoFrame]:
        return (self._with(left) for left in self._left)

    def __repr__(self) -> str:
        return f"<{counted(len(self), 'pair')}>"


class Pair:
    """A stereo output: ``left`` and ``right`` are its topics, ``frames`` its pairs."""

    def __init__(self, recording: Any, name: str, left: Any, right: Any) -> None:
        self.name, self.left, self.right = name, left, right
        self._recording = recording

    @property
    def frames(self) -> Pairs:
        """Pairs of images that were acquired at the same time."""
        return Pairs(self.left.frames, self.right.frames)

    def frame(self, number: int) -> StereoFrame:
        """The pair of this number, from 0; from the end where it is negative."""
        return self.frames[number]

    @property
    def lost(self) -> int | None:
        """Pairs that were lost; None where the file does not tell."""
        return self._recording.losses.of(self.name).lost if self._recording.losses.told else None

    def __len__(self) -> int:
        return len(self.left)

    def __repr__(self) -> str:
        return f"<{self.name}: {len(self.left)} left and {counted(len(self.right), 'right image')} of {self.left.schema}>"
