"""Times of images in their video, from a csv file.

The header names the columns: ``image_id`` or ``name``; ``frame``, or ``time_s`` in seconds; and
optionally ``neighbour_a`` and ``neighbour_b``, the ids of the images before and after. Without
these two, the neighbours of an image are the nearest in time among the images of its camera. A gap
of more than four times the median gap separates videos.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, shown
from bundle.model.problem import Problem

LONGEST_GAP = 4.0
"""Largest gap within a video, in median gaps."""


def read_frame_times(
    path: str | Path, problem: Problem, frame_rate: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the time of each image in frames (NaN: not in the file), and its neighbours.

    Args:
        path: csv file with a header.
        problem: problem with the images.
        frame_rate: frames per second, for times in seconds; 0: unknown.

    Raises:
        InputError: a column is missing, or a row is wrong; the message has file and line.
        OSError: the file cannot be read.
    """
    with Path(path).open(newline="", encoding="utf-8", errors="replace") as file:
        rows = csv.DictReader(file)
        columns = [name.strip() for name in rows.fieldnames or ()]
        rows.fieldnames = columns
        key = next((name for name in ("image_id", "name") if name in columns), None)
        time = next((name for name in ("frame", "time_s") if name in columns), None)
        if key is None or time is None:
            raise InputError(
                f"{shown(path)}: expected columns image_id or name, and frame or time_s, found "
                f"{', '.join(columns) or 'none'}"
            )
        if time == "time_s" and not frame_rate > 0:
            raise InputError(f"{shown(path)}: expected --frame-rate for times in seconds (time_s)")
        ids = {str(one): k for k, one in enumerate(problem.image_ids.tolist())}
        known = ids if key == "image_id" else {n: k for k, n in enumerate(problem.image_names)}
        sides = [name for name in ("neighbour_a", "neighbour_b") if name in columns]
        frames = np.full(problem.num_images, np.nan)
        neighbours = np.full((problem.num_images, 2), -1, np.int32)
        for row in rows:
            place = f"{shown(path)}:{rows.line_num}"
            image = known.get((row[key] or "").strip())
            if image is None:  # an image that the model does not have
                continue
            value = _number(place, time, row[time])
            frames[image] = value if time == "frame" else value * frame_rate
            for side, name in enumerate(sides):
                other = ids.get((row[name] or "").strip())
                neighbours[image, side] = image if other is None else other
    if np.isnan(frames).all():
        raise InputError(f"{shown(path)}: expected images of the model, found none of them")
    if len(sides) < 2:
        return frames, neighbours_in_time(frames, problem.image_camera)
    lone = (neighbours[:, 0] == neighbours[:, 1]) | (neighbours < 0).any(axis=1)
    known_time = ~np.isnan(np.append(frames, np.nan)[neighbours]).any(axis=1)
    neighbours[lone | ~known_time] = -1
    return frames, neighbours


def neighbours_in_time(
    frames: NDArray[np.float64], image_camera: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return (num_images, 2) the images before and after of the same camera, -1 without any."""
    neighbours = np.full((len(frames), 2), -1, np.int32)
    for camera in np.unique(image_camera[~np.isnan(frames)]).tolist():
        images = np.flatnonzero((image_camera == camera) & ~np.isnan(frames))
        images = images[np.argsort(frames[images], kind="stable")]
        gaps = np.diff(frames[images])
        if not (gaps > 0).any():
            continue
        joined = (gaps > 0) & (gaps <= LONGEST_GAP * np.median(gaps[gaps > 0]))
        before, after = images.copy(), images.copy()
        before[1:][joined] = images[:-1][joined]
        after[:-1][joined] = images[1:][joined]
        tied = before != after
        neighbours[images[tied], 0] = before[tied]
        neighbours[images[tied], 1] = after[tied]
    return neighbours


def _number(place: str, column: str, text: Any) -> float:
    try:
        value = float(text)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{place}: {column}: expected a number, found {text!r}")
    return value
