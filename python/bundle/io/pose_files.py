"""Files of poses: TUM, EuRoC, KITTI, and lists of named poses.

    tum    timestamp tx ty tz qx qy qz qw       seconds; world_from_body
    euroc  timestamp,px,py,pz,qw,qx,qy,qz,...   nanoseconds; world_from_body
    kitti  12 numbers, the rows of (R, t)       line k, from 0, is frame k; world_from_camera
    poses  name qw qx qy qz tx ty tz            camera_from_world, as in COLMAP, or its inverse

Only lists of poses exist in both directions; the others have one direction by definition. The first
line that is neither empty nor a comment decides the format: commas and a number mean EuRoC, twelve
numbers KITTI, eight numbers TUM, and a word before seven numbers a list. A list whose names are
numbers looks like TUM and needs an explicit format.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from bundle.base.arrays import refuse_row
from bundle.base.paths import UTF16, as_path, numbered_lines
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.interface.judging_options import DIRECTIONS, POSE_FORMATS
from bundle.interface.option_fields import choice
from bundle.io.sequences.trajectory_files import load_ground_truth, load_tum, read_csv
from bundle.model.pose_table import PoseTable
from bundle.model.rigid_motions import inverse_poses, quaternion_from_matrix, unit_poses

NORM = 0.01  # largest deviation of the norm of a quaternion from 1, and of R^T R from the identity

_COLUMNS = "name qw qx qy qz tx ty tz"


def pose_format(path: str | os.PathLike[str]) -> str | None:
    """Return the format of a file of poses by its first line; None if it has no such format."""
    line = first_line(Path(path))[1]
    words = line.replace(",", " ").split()
    if "," in line and len(words) >= 8 and (_is_number(words[0]) or words[0] == "timestamp"):
        return "euroc"
    if all(map(_is_number, words)):
        return {12: "kitti", 8: "tum"}.get(len(words))
    return "poses" if len(words) >= 8 and all(map(_is_number, words[-7:])) else None


def first_line(path: Path) -> tuple[int, str]:
    """Return the number and the text of the first line that is not a comment; "" if none exists."""
    with path.open("rb") as file:
        start = file.read(1 << 16)
    text = start.decode("utf-16" if start[:2] in UTF16 else "utf-8-sig", errors="replace")
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip() and line.strip()[0] != "#":
            return number, line.strip()
    return 1, ""


def load_poses(
    path: str | os.PathLike[str],
    format: str | None = None,
    direction: str = DIRECTIONS[0],
) -> PoseTable:
    """Read a file of poses; poses with time stamps are sorted by time.

    Args:
        path: path of the file.
        format: "tum", "euroc", "kitti" or "poses"; None: decided by the first line.
        direction: "camera_from_world" or "world_from_camera", for lists of poses.

    Raises:
        InputError: a line violates the format: wrong number of columns, a word instead of a number,
            a number that is not finite, a quaternion whose norm is not 1, a matrix that is no
            rotation, or a repeated name or time stamp. The message names file and line.
        OSError: the file cannot be read.
    """
    path = as_path(path)
    chosen = pose_format(path) if format is None else choice("format", format, POSE_FORMATS)
    way = choice("direction", direction, DIRECTIONS)
    if chosen is None:
        at, line = first_line(path)
        raise InputError(
            f"{shown(path)}: line {at}: expected poses of TUM (8 numbers), EuRoC (commas), "
            f"KITTI (12 numbers) or a list ({_COLUMNS}), found {plural(len(line.split()), 'word')}"
        )
    if chosen == "kitti":
        return _load_kitti(path)
    if chosen == "poses":
        return _load_list(path, way)
    read = load_tum if chosen == "tum" else load_ground_truth
    trajectory = read(path, in_order=False)
    stamps = trajectory.timestamps_ns
    return PoseTable(trajectory.states[:, :7], (), stamps, chosen)


def _load_kitti(path: Path) -> PoseTable:
    names = [f"{letter}{column}" for letter in "123" for column in ("1", "2", "3", "4")]
    table = read_csv(path, [], names, delimiter=None)
    if not len(table):
        raise InputError(f"{shown(path)}: expected lines of 12 numbers, found an empty file")
    matrices = table.numbers.reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    with np.errstate(all="ignore"):
        gap = np.abs(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3)).max(axis=(1, 2))
        determinant = np.linalg.det(rotations)
    refuse_row(
        ~np.isfinite(matrices).all(axis=(1, 2)) | ~(gap < NORM) | ~(determinant > 0),
        lambda row: (
            f"{table.place(row)}: expected a finite 3 x 4 matrix with a rotation, found "
            f"determinant {determinant[row]:.3g} and R^T R that differs from the identity by "
            f"{gap[row]:.3g}"
        ),
    )
    poses = np.hstack([quaternion_from_matrix(rotations), matrices[:, :, 3]])
    return PoseTable(poses, (), None, "kitti")


def _load_list(path: Path, direction: str) -> PoseTable:
    places: dict[str, int] = {}
    rows: list[list[float]] = []
    for number, line in numbered_lines(path):
        text = line.strip()
        if not text or text[0] == "#":
            continue
        place = f"{shown(path)}: line {number}"
        name, row = _named_row(place, text)
        if name in places:
            raise InputError(
                f"{place}: expected each name once, found {brief(name)} again (first in line "
                f"{places[name]})"
            )
        places[name] = number
        rows.append(row)
    if not rows:
        raise InputError(f"{shown(path)}: expected lines of {_COLUMNS}, found 0")
    numbers = np.array(rows)
    norm = np.linalg.norm(numbers[:, :4], axis=1)
    wrong = np.flatnonzero(~(np.abs(norm - 1) < NORM) | ~np.isfinite(numbers).all(axis=1))
    if len(wrong):
        at = list(places.values())[int(wrong[0])]
        raise InputError(
            f"{shown(path)}: line {at}: expected finite numbers and a quaternion of norm 1, "
            f"found norm {norm[wrong[0]]:g}"
        )
    poses = unit_poses(numbers[:, [1, 2, 3, 0, 4, 5, 6]])
    poses = inverse_poses(poses) if direction == DIRECTIONS[0] else poses
    return PoseTable(poses, tuple(places), None, "poses")


def _named_row(place: str, text: str) -> tuple[str, list[float]]:
    """Return the name, which may contain blanks, and the seven numbers at the end of a line."""
    words = text.rsplit(None, 7)
    if "," in text and not all(map(_is_number, words[1:])):
        words = [word.strip() for word in text.rsplit(",", 7)]
    if len(words) < 8:
        raise InputError(f"{place}: expected {_COLUMNS}, found {plural(len(words), 'word')}")
    name, *numbers = words
    for column, word in zip(_COLUMNS.split()[1:], numbers, strict=True):
        if not _is_number(word):
            raise InputError(f"{place}: {column}: expected a number, found {brief(word)}")
    parts = name.split()
    if len(parts) > 1 and all(map(_is_number, parts[1:])):
        found = len(text.split())
        raise InputError(f"{place}: expected 8 columns ({_COLUMNS}), found {found}")
    return name.strip("'\""), [float(word) for word in numbers]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
