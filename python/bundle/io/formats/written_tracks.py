"""Points with their views as text, and common functions of the writers of all formats.

A block of points is one ``%`` format with one tuple of numbers: the format of a point depends only
on the number of its views, so that no number is formatted alone in Python.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, shown
from bundle.model.colmap.source_records import number_keypoints
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import LOST_SIGMAS, beside_the_problem, source_records

Array = NDArray[np.float64]
_BLOCK = 1 << 16


def colors_of(problem: Problem) -> NDArray[np.uint8]:
    """Return (num_points, 3) colours of the source; black for points that it lacks."""
    records = source_records(vars(problem)["source"])
    colors = np.zeros((problem.num_points, 3), np.uint8)
    if records is None:
        return colors
    contents = records.contents()
    order = np.argsort(contents.point_ids)
    ids = contents.point_ids[order]
    place = np.minimum(np.searchsorted(ids, problem.point_ids), max(len(ids) - 1, 0))
    if len(ids):
        known = ids[place] == problem.point_ids
        colors[known] = contents.point_colors[order[place[known]]]
    return colors


def keys_of(problem: Problem) -> NDArray[np.int64]:
    """Return the keypoint index of each observation; observations without one get new indices."""
    capacity = np.full(problem.num_images, -1, np.int64)
    given = problem.observation_keypoint >= 0
    if given.any():
        capacity[:] = 0
        largest = problem.observation_keypoint[given] + 1
        np.maximum.at(capacity, problem.observation_image[given], largest)
    return number_keypoints(problem, capacity).keypoint


def names_of(problem: Problem) -> list[str]:
    """Return the names of the images; an image without a name gets one such as image_000007."""
    ids = problem.image_ids.tolist()
    return [
        name or f"image_{image_id:06d}"
        for name, image_id in zip(problem.image_names, ids, strict=True)
    ]


def check_names(problem: Problem, what: str, forbidden: str = "\n\r\t") -> None:
    """Raise an InputError for a name that a text format cannot hold."""
    for image_id, name in zip(problem.image_ids.tolist(), problem.image_names, strict=True):
        if set(forbidden) & set(name):
            raise InputError(
                f"image {image_id}: expected a name that {what} can hold, found {shown(name)!r}"
            )


def camera_error(problem: Problem, camera: int, what: str, expected: str) -> InputError:
    """Return the error of a format that cannot hold a camera."""
    return InputError(
        f"camera {problem.camera_ids[camera]}: {what} cannot hold it: expected {expected}, found "
        f"{problem.camera_models[camera]}"
    )


def common_losses(problem: Problem, *, keeps: Iterable[str] = ()) -> tuple[str, ...]:
    """Return one sentence for each kind of information that the formats lose.

    ``keeps``: what this format holds: "ids", "rigs", "colors", "sharing", "names", "sizes".
    """
    keeps = set(keeps)
    used = np.bincount(problem.image_camera, minlength=problem.num_cameras)
    ids = [
        what
        for what, values in (("image", problem.image_ids), ("point", problem.point_ids))
        if not np.array_equal(values, np.arange(len(values)))
    ]
    beside = [
        what
        for what in beside_the_problem(vars(problem)["source"])
        if not (what in ("rigs", "frames") or (what == "point colours" and "colors" in keeps))
    ]
    found = (
        (problem.num_frames and "rigs" not in keeps, "Rigs are taken apart into images."),
        (
            (used > 1).any() and "sharing" not in keeps,
            f"Cameras shared by several images ({(used > 1).sum()}) become one per image.",
        ),
        (
            (used == 0).any() and "sharing" not in keeps,
            f"Cameras without an image ({(used == 0).sum()}) are left out.",
        ),
        (ids and "ids" not in keeps, f"Ids are renumbered from 0: {', '.join(ids)}."),
        (
            problem.camera_sizes[problem.image_camera].any() and "sizes" not in keeps,
            "Sizes of images are left out.",
        ),
        (any(problem.image_names) and "names" not in keeps, "Names of images are left out."),
        (problem.observation_sigma is not None, LOST_SIGMAS),
        (
            "rigs" in beside_the_problem(vars(problem)["source"]),
            "Keypoints without a point, and images without a pose, are left out.",
        ),
        (
            "point colours" in beside,
            "Colours of points are left out.",
        ),
    )
    return tuple(sentence for applies, sentence in found if applies)


def write_tracks(
    file: TextIO,
    templates: tuple[str, str, str],
    point_columns: Array,
    view_columns: Array,
    observation_point: NDArray[np.int32],
) -> None:
    """Write the points with their views.

    Args:
        templates: ``%`` formats of a point before its views, of a view, and after the views. The
            last number before the views is their count.
        point_columns: (num_points, n) numbers of the points, without the count.
        view_columns: (num_observations, m) numbers of the views.
        observation_point: (num_observations,) point of each view.
    """
    before, one, after = templates
    order = np.argsort(observation_point, kind="stable")
    counts = np.bincount(observation_point, minlength=len(point_columns))
    ends = np.concatenate([[0], np.cumsum(counts)])
    width, per_view = point_columns.shape[1] + 1, view_columns.shape[1]
    begin = 0
    while begin < len(counts):
        last = int(np.searchsorted(ends, ends[begin] + _BLOCK, side="right")) - 1
        end = min(max(last, begin + 1), begin + _BLOCK, len(counts))
        mine = counts[begin:end]
        starts = np.cumsum(width + per_view * mine) - (width + per_view * mine)
        flat = np.empty(int((width + per_view * mine).sum()))
        heads = starts[:, None] + np.arange(width)
        flat[heads] = np.column_stack([point_columns[begin:end], mine])
        is_view = np.ones(len(flat), bool)
        is_view[heads] = False
        flat[is_view] = view_columns[order[ends[begin] : ends[end]]].ravel()
        forms = {int(n): before + one * int(n) + after for n in np.unique(mine)}
        file.write("".join([forms[n] for n in mine.tolist()]) % tuple(flat.tolist()))
        begin = end


def write_rows(file: TextIO, template: str, columns: Array) -> None:
    """Write each row of a table by a ``%`` format."""
    for begin in range(0, len(columns), _BLOCK):
        part = columns[begin : begin + _BLOCK]
        file.write(template * len(part) % tuple(part.ravel().tolist()))
