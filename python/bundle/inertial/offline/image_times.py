"""Times of a reconstruction's images, from a file with a line for each frame of a video.

Lines have the name of an image and its time in nanoseconds, between blanks, tabs or a comma; lines
that begin with ``#`` and a header are ignored. The times ascend from line to line; images of a rig
may have the same time. Frames that are not in the reconstruction are ignored.
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import numbered_lines
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.model.problem import Problem

LIMIT = 2**63


def read_image_times(path: str | os.PathLike[str], problem: Problem) -> NDArray[np.int64]:
    """Return the (n,) times of the problem's images in nanoseconds.

    Raises:
        InputError: a line has other words, times do not ascend, or an image has no time.
        OSError: the file cannot be read.
    """
    times: dict[str, int] = {}
    last: tuple[int, int] | None = None
    for number, line in numbered_lines(path):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        place = f"{shown(path)}: line {number}"
        name, _, word = text.replace(",", " ").replace("\t", " ").rpartition(" ")
        name = name.strip().strip('"')
        is_stamp = word.isascii() and word.lstrip("-").isdigit() and len(word) < 20
        if not is_stamp or not name or not -LIMIT < int(word) < LIMIT:
            if not times and last is None and not any(c.isdigit() for c in word):
                continue  # a header
            raise InputError(
                f"{place}: expected the name of an image and nanoseconds, found {brief(text)}"
            )
        stamp = int(word)
        if last is not None and stamp < last[1]:
            raise InputError(
                f"{place}: expected a time from {last[1]} ns of line {last[0]} on, found {stamp}"
            )
        if name in times:
            raise InputError(
                f"{place}: expected one line for each image, found {brief(name)} again"
            )
        times[name] = stamp
        last = number, stamp
    if not times:
        raise InputError(f"{shown(path)}: expected lines of name and nanoseconds, found 0")
    missing = [name for name in problem.image_names if name not in times]
    if missing:
        raise InputError(
            f"{shown(path)}: expected a time for each image of the model, found no time of "
            f"{plural(len(missing), 'image')} such as {brief(missing[0])}"
        )
    return np.array([times[name] for name in problem.image_names], np.int64)
