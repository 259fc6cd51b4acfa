"""The FMUs' icon: a propeller, drawn in code."""

import struct
import zlib
from functools import cache
from math import cos, hypot, pi, sin

SIZE = 96  # pixels
BLADE, HUB = (31, 86, 140), (20, 24, 32)  # red, green, blue
LENGTH, WIDTH, BOSS = 0.46, 0.105, 0.09  # of the picture's side
TILT = 0.6  # rad


def _covered(distance: float) -> float:
    """Share of a pixel inside an outline, from its distance [side]; positive: inside."""
    return min(1.0, max(0.0, 0.5 + distance * SIZE))


def _pixel(x: float, y: float) -> tuple[int, int, int, int]:
    """Red, green, blue, opacity at (x, y), both within +-0.5 of the middle."""
    along, across = x * cos(TILT) + y * sin(TILT), y * cos(TILT) - x * sin(TILT)
    reach = abs(along) / LENGTH
    half = WIDTH * sin(pi * min(1.0, reach) ** 0.7) if reach < 1.0 else 0.0
    blade, hub = _covered(half - abs(across)) if half > 0.0 else 0.0, _covered(BOSS - hypot(x, y))
    shade = [round(b + (h - b) * hub) for b, h in zip(BLADE, HUB, strict=True)]
    return shade[0], shade[1], shade[2], round(255 * max(blade, hub))


@cache
def icon() -> bytes:
    """A PNG with transparent background."""
    middle = [(i + 0.5) / SIZE - 0.5 for i in range(SIZE)]
    rows = b"".join(b"\0" + bytes(v for x in middle for v in _pixel(x, y)) for y in middle)
    header = struct.pack(">2I5B", SIZE, SIZE, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows, 9)) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
