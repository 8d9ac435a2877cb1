"""Pixels as PNG, numbers as colours, and QOI as pixels; nothing but numpy and zlib is needed.

Invariant: what is written has exactly the pixels that were given; what a QOI file says of its size is believed only as far as its bytes go.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

# Pixels of a QOI image at most, and how many a byte of it may stand for.
_MOST, _RUN = 1 << 26, 62


def png(pixels: np.ndarray) -> bytes:
    """A picture ``(height, width)`` or ``(height, width, 1, 3 or 4)`` of 8 or 16 bit as PNG."""
    pixels = pixels[:, :, None] if pixels.ndim == 2 else pixels
    height, width, colours = pixels.shape
    kind = {1: 0, 3: 2, 4: 6}[colours]
    depth = {"u1": 8, "u2": 16}[pixels.dtype.str[1:]]
    # Each row begins with its filter; the high byte comes first.
    rows = np.zeros((height, 1 + width * colours * depth // 8), "u1")
    rows[:, 1:] = np.ascontiguousarray(pixels.astype(">u2" if depth == 16 else "u1")).reshape(height, -1).view("u1")
    head = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _part(b"IHDR", head) + _part(b"IDAT", zlib.compress(rows.tobytes(), 3)) + _part(b"IEND", b"")


def _part(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def coloured(values: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Numbers as colours (turbo) from the least to the most of them; those that are not finite are black."""
    finite = np.isfinite(values)
    known = values if finite.all() else values[finite]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    # Numbers of 16 bit are exact in 32.
    scaled = values.astype("f4" if values.dtype.itemsize <= 2 else "f8")
    scaled[~finite] = low
    scaled -= low
    scaled /= (high - low) or 1.0
    scaled *= 255
    scaled += 0.5
    out = _TURBO[scaled.astype("u1")]
    out[~finite] = 0
    return out, low, high


def _turbo() -> np.ndarray:
    """The 256 colours of the map "turbo", by the polynomials that Google gave for it."""
    factors = [
        (0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943),
        (0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604),
        (0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973),
    ]
    powers = (np.arange(256) / 255)[:, None] ** np.arange(6)
    return (np.clip(powers @ np.array(factors).T, 0, 1) * 255 + 0.5).astype("u1")


_TURBO = _turbo()


def qoi(data: bytes) -> np.ndarray | None:
    """The pixels of a QOI image, ``(height, width, 3 or 4)``; None where it is none."""
    if len(data) < 22 or data[:4] != b"qoif":
        return None
    width, height, channels, _ = struct.unpack_from(">IIBB", data, 4)
    count = width * height
    if not count or count > min(_MOST, len(data) * _RUN) or channels not in (3, 4):
        return None
    try:
        out = _pixels(data, count)
    except IndexError:
        return None
    return np.frombuffer(out, "u1").reshape(height, width, 4)[:, :, :channels]


def _pixels(data: bytes, count: int) -> bytes:
    """RGBA, pixel after pixel: https://qoiformat.org/qoi-specification.pdf."""
    seen = [b"\0\0\0\0"] * 64
    r, g, b, a = 0, 0, 0, 255
    pixel, out, at, left = bytes((r, g, b, a)), [], 14, count
    while left:
        op = data[at]
        at += 1
        if op >= 0xFE:
            r, g, b = data[at : at + 3]
            at += 3
            if op == 0xFF:
                a = data[at]
                at += 1
        elif op >= 0xC0:
            run = min((op & 63) + 1, left)
            out.append(pixel * run)
            left -= run
            continue
        elif op >= 0x80:
            more, green = data[at], (op & 63) - 32
            at += 1
            r, g, b = (r + green - 8 + (more >> 4)) & 255, (g + green) & 255, (b + green - 8 + (more & 15)) & 255
        elif op >= 0x40:
            r, g, b = (r + (op >> 4 & 3) - 2) & 255, (g + (op >> 2 & 3) - 2) & 255, (b + (op & 3) - 2) & 255
        else:
            pixel = seen[op]
            r, g, b, a = pixel
            out.append(pixel)
            left -= 1
            continue
        pixel = bytes((r, g, b, a))
        seen[(r * 3 + g * 5 + b * 7 + a * 11) & 63] = pixel
        out.append(pixel)
        left -= 1
    return b"".join(out)
