"""rolling_shutter.json: the rolling shutters of a COLMAP model (docs/rolling_shutter.md).

``direction`` is "rows" (from top to bottom) or "columns" (from left to right); ``readout`` is a
share of the time between two frames, or null if it is unknown. Cameras that are not listed have a
global shutter. ``twist`` is the motion per height of the image in the camera's frame; every image
of a listed camera has one, or "images" is left out, and all twists are zero. ``neighbours`` are the
ids of the images before and after it in its video, which may have a global shutter.

COLMAP does not know the file. It is replaced and removed with its model.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, shown
from bundle.io.atomic.replaced_paths import ROLLING_SHUTTER
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import DIRECTIONS, ROW_TIMES, RollingShutter

if TYPE_CHECKING:
    from bundle.io.formats.file_values import Node

LOST_ROLLING_SHUTTER = (
    "The rolling shutter is left out: other programs assume a global shutter (convert "
    "--global-shutter corrects the observations)."
)

_CAMERA = ("camera_id", "direction", "readout")
_IMAGE = ("image_id", "twist", "frame", "neighbours")


def with_rolling_shutter(problem: Problem, folder: Path) -> Problem:
    """Return a model with the rolling shutters in its folder; without the file, as it is."""
    path = folder / ROLLING_SHUTTER
    if not path.is_file():
        return problem
    shutter = read_rolling_shutter(path, problem)
    try:
        return problem.replace(rolling_shutter=shutter)
    except InputError as error:
        words = str(error).removeprefix("rolling_shutter: ")
        raise InputError(f"{shown(path)}: {words}") from None


def read_rolling_shutter(path: Path, problem: Problem) -> RollingShutter:
    """Read a rolling_shutter.json for the cameras and images of a problem."""
    from bundle.io.formats.file_values import read_json  # late: most models have no such file

    node = read_json(path)
    _check_members(node, ("cameras", "images", "row_time", "frame_rate"))
    direction = ["global"] * problem.num_cameras
    readout = np.full(problem.num_cameras, np.nan)
    for entry, camera in _entries(node.get("cameras"), "camera", _CAMERA, problem.camera_ids):
        direction[camera] = _choice(entry.get("direction"), DIRECTIONS[1:])
        share = entry.get("readout")
        if share.value is not None:
            readout[camera] = share.number()
            if not 0 < readout[camera] <= 1:
                share.fail("a share of the frame time above 0 and at most 1, or null")
    rolls = np.array([one != "global" for one in direction], bool)[problem.image_camera]
    twist = np.zeros((problem.num_images, 6))
    frames = np.full(problem.num_images, np.nan)
    neighbours = np.full((problem.num_images, 2), -1, np.int32)
    images = node.find("images")
    if images is not None:
        listed = np.zeros(problem.num_images, bool)
        index = {image_id: k for k, image_id in enumerate(problem.image_ids.tolist())}
        for entry, image in _entries(images, "image", _IMAGE, problem.image_ids):
            if rolls[image]:
                listed[image] = True
                twist[image] = entry.get("twist").numbers(6)
            elif entry.find("twist") is not None:
                entry.get("image_id").fail("an image of a camera in cameras")
            if (frame := entry.find("frame")) is not None:
                frames[image] = frame.number()
            if (pair := entry.find("neighbours")) is not None:
                neighbours[image] = _neighbours(pair, index)
        missing = np.flatnonzero(rolls & ~listed)
        if len(missing):
            raise InputError(
                f"{images.place}: expected a twist for each image with a rolling shutter, found "
                f"none for image {problem.image_ids[missing[0]]}"
            )
    row_time, rate = node.find("row_time"), node.find("frame_rate")
    if rate is not None and not rate.number() > 0:
        rate.fail("frames per second above 0")
    return RollingShutter(
        direction=tuple(direction),
        readout=readout,
        twist=twist,
        frames=None if np.isnan(frames).all() else frames,
        neighbours=None if (neighbours < 0).all() else neighbours,
        frame_rate=math.nan if rate is None else rate.number(),
        row_time=ROW_TIMES[0] if row_time is None else _choice(row_time, ROW_TIMES),
    )


def rolling_shutter_text(problem: Problem) -> str:
    """Return the text of rolling_shutter.json; "" if all shutters of a problem are global."""
    record = rolling_shutter_record(problem)
    if record is None:
        return ""
    members = []
    for name, value in record.items():
        entries = [json.dumps(entry) for entry in value] if isinstance(value, list) else []
        lines = ",\n  ".join(entries)
        members.append(f' "{name}": ' + (f"[\n  {lines}\n ]" if entries else json.dumps(value)))
    return "{\n" + ",\n".join(members) + "\n}\n"


def rolling_shutter_record(problem: Problem) -> dict[str, Any] | None:
    """Return the content of rolling_shutter.json; None if all shutters of a problem are global."""
    shutter = problem.rolling_shutter
    if shutter is None or not shutter.is_rolling.any():
        return None
    rolls = shutter.is_rolling[problem.image_camera]
    images = []
    ids = problem.image_ids.tolist()
    for image, is_rolling in enumerate(rolls.tolist()):
        record: dict[str, Any] = {"image_id": ids[image]}
        if is_rolling:
            record["twist"] = shutter.twist[image].tolist()
        if shutter.frames is not None and math.isfinite(shutter.frames[image]):
            record["frame"] = float(shutter.frames[image])
        if shutter.neighbours is not None and shutter.neighbours[image].min() >= 0:
            record["neighbours"] = [ids[k] for k in shutter.neighbours[image].tolist()]
        if len(record) > 1:
            images.append(record)
    cameras = [
        {
            "camera_id": int(problem.camera_ids[camera]),
            "direction": shutter.direction[camera],
            "readout": _known(float(shutter.readout[camera])),
        }
        for camera in np.flatnonzero(shutter.is_rolling).tolist()
    ]
    record = {"cameras": cameras, "images": images}
    if math.isfinite(shutter.frame_rate):
        record["frame_rate"] = shutter.frame_rate
    return record if shutter.row_time == ROW_TIMES[0] else {**record, "row_time": shutter.row_time}


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _entries(
    node: Node, kind: str, members: tuple[str, ...], ids: NDArray[np.int64]
) -> list[tuple[Node, int]]:
    """Return the entries of an array with the index of the camera or image of each."""
    index = {one: k for k, one in enumerate(ids.tolist())}
    found, seen = [], set()
    for entry in node.entries():
        _check_members(entry, members)
        identity = entry.get(f"{kind}_id")
        number = identity.whole()
        if number not in index:
            identity.fail(f"a {kind} of the model")
        if number in seen:
            identity.fail(f"one entry per {kind}")
        seen.add(number)
        found.append((entry, index[number]))
    return found


def _check_members(node: Node, known: tuple[str, ...]) -> None:
    for name, value in node.items():
        if name not in known:
            raise InputError(
                f"{value.place.removesuffix(f': {name}')}: expected the members "
                f"{', '.join(known)}, found {name}"
            )


def _choice(node: Node, choices: tuple[str, ...]) -> str:
    if node.value not in choices:
        node.fail(" or ".join(choices))
    return node.text()


def _neighbours(node: Node, index: dict[int, int]) -> list[int]:
    entries = list(node.entries())
    if len(entries) != 2:
        node.fail("the ids of two images")
    for entry in entries:
        if entry.whole() not in index:
            entry.fail("an image of the model")
    return [index[entry.value] for entry in entries]


# Times of images in their video, from a csv file.
#
# The header names the columns: ``image_id`` or ``name``; ``frame``, or ``time_s`` in seconds; and
# optionally ``neighbour_a`` and ``neighbour_b``, the ids of the images before and after. Without
# these two, the neighbours of an image are the nearest in time among the images of its camera. A
# gap of more than four times the median gap separates videos.

LONGEST_GAP = 4.0  # largest gap within a video, in median gaps


def read_frame_times(
    path: str | Path, problem: Problem, frame_rate: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the time of each image in frames (NaN: not in the file), and its neighbours.

    ``frame_rate``: frames per second, for times in seconds; 0: unknown.
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
