"""Colours of directions: hues around the circle, each as light as the others to the eye."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["direction_colours"]

# Hues of equal lightness and chroma in CIE LCh(ab) (L = 62, C = 38), every 30 degrees from right,
# clockwise as an image is seen; between them, linear in sRGB.
_HUES = np.array(
    [
        (212, 123, 151), (213, 126, 118), (198, 136, 92), (171, 148, 81), (136, 158, 90),
        (95, 164, 115), (40, 167, 149), (0, 167, 182), (3, 162, 207), (98, 153, 217),
        (153, 141, 208), (192, 129, 184),
    ],
    float,
)  # fmt: skip


def direction_colours(vectors: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return (n, 3) colours red, green, blue of the directions of (n, 2) vectors, y down."""
    turn = np.mod(np.arctan2(vectors[:, 1], vectors[:, 0]) / (2 * np.pi), 1.0) * len(_HUES)
    first = np.floor(turn).astype(int) % len(_HUES)
    share = (turn - np.floor(turn))[:, None]
    mixed = (1 - share) * _HUES[first] + share * _HUES[(first + 1) % len(_HUES)]
    colours: NDArray[np.uint8] = np.rint(mixed).astype(np.uint8)
    return colours
