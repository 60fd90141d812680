"""Bundle Adjustment in the Large (BAL): text files, plain or compressed by gzip or bzip2.

A BAL camera is COLMAP's RADIAL model with principal point (0, 0), its frame rotated by
diag(1, -1, -1) and the image's y negated; ``cpp/core/io/bal.h`` derives it. Reading and writing
preserve every bit. Converting a rotation vector to a quaternion and back would lose its last bits
and full turns. A problem therefore keeps the rotation vectors of its file. A vector is written back
if the quaternion of its image has not changed.

Format: https://grail.cs.washington.edu/projects/bal/
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.errors import InputError, shown
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.pycolmap import problem_source
from bundle.model.pycolmap.problem_source import LOST_SIGMAS, BalSource


class _Layout(NamedTuple):
    """Parameter columns of a camera model that BAL stores, and those that must be zero."""

    focal: tuple[int, ...]
    principal_point: tuple[int, int]
    distortion: tuple[int, ...] = ()
    zero: tuple[int, ...] = ()


_LAYOUTS = {
    "SIMPLE_PINHOLE": _Layout((0,), (1, 2)),
    "PINHOLE": _Layout((0, 1), (2, 3)),
    "SIMPLE_RADIAL": _Layout((0,), (1, 2), (3,)),
    "RADIAL": _Layout((0,), (1, 2), (3, 4)),
    "OPENCV": _Layout((0, 1), (2, 3), (4, 5), (6, 7)),
}


def load(path: Path, progress: Callable[[int], None] | None = None) -> Problem:
    """Read a BAL file; compression is detected automatically.

    Observations keep the order of the file, including repeated observations. ``progress`` is called
    repeatedly with the number of bytes read.

    Raises:
        InputError: the file violates the format. The message has path and line; for a damaged
            compressed file it has path and byte.
        OSError: the file cannot be read.
    """
    return problem_of(*_core.read_bal(path, progress))


def problem_of(
    poses: NDArray[np.float64],
    rotations: NDArray[np.float64],
    params: NDArray[np.float64],
    points: NDArray[np.float64],
    image: NDArray[np.int32],
    point: NDArray[np.int32],
    xy: NDArray[np.float64],
) -> Problem:
    """Return the problem with the arrays that the C++ core read."""
    return Problem(
        cam_from_world=poses,
        camera_models=("RADIAL",) * len(poses),
        camera_params=params,
        points=points,
        observation_image=image,
        observation_point=point,
        observation_xy=xy,
        format="bal",
        source=BalSource(rotations, poses),
    )


def save(
    problem: Problem,
    path: Path,
    compression: str = "",
    progress: Callable[[int], None] | None = None,
) -> None:
    """Write a BAL file, compressed by "gzip" or "bzip2", or uncompressed ("").

    Every image gets its own camera. Principal points are subtracted from the observations.
    ``progress`` is called repeatedly with the number of bytes written.

    Raises:
        InputError: see ``radial_params``.
        OSError: the file cannot be written.
    """
    rotations, keeps_rotation = _source_rotations(problem)
    _core.write_bal(
        path,
        problem.cam_from_world,
        radial_params(problem),
        problem.points,
        problem.observation_image,
        problem.observation_point,
        problem.observation_xy,
        rotations,
        keeps_rotation,
        compression,
        progress,
    )


def save_like(
    source: Path, num_observations: int, problem: Problem, points: NDArray[np.float64], path: Path
) -> None:
    """Write the cameras of a problem, the given points, and the observations of a BAL file.

    Observations are copied from file to file; the observations of the problem are ignored.
    """
    rotations, keeps_rotation = _source_rotations(problem)
    _core.write_bal_like(
        source,
        num_observations,
        path,
        problem.cam_from_world,
        radial_params(problem),
        points,
        rotations,
        keeps_rotation,
        "",
    )


def _source_rotations(problem: Problem) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the source's rotation of each image, and a mask of images with unchanged rotation."""
    rotations = np.zeros((problem.num_images, 3))
    keeps = np.zeros(problem.num_images, bool)
    source = vars(problem)["source"]  # the attribute would load pycolmap
    if isinstance(source, BalSource):
        ids = problem.image_ids  # in a BAL file, ids are positions
        known = np.flatnonzero((ids >= 0) & (ids < len(source.rotations)))
        rotations[known] = source.rotations[ids[known]]
        before = source.cam_from_world[ids[known], :4]
        keeps[known] = (problem.cam_from_world[known, :4] == before).all(axis=1)
    return rotations, keeps


def radial_params(problem: Problem, what: str = "a BAL file") -> NDArray[np.float64]:
    """Return f, cx, cy, k1, k2 of each image, in pixels: (num_images, 5)."""
    params = np.zeros((problem.num_images, 5))
    models = np.array(problem.camera_models, dtype=object)[problem.image_camera]
    for model in sorted(set(models)):
        images = np.flatnonzero(models == model)
        if model not in _LAYOUTS:
            raise _unsupported(problem, images[0], f"expected one of {', '.join(_LAYOUTS)}", what)
        layout = _LAYOUTS[model]
        source = problem.camera_params[problem.image_camera[images]]
        focal = source[:, list(layout.focal)]
        beyond = (focal != focal[:, :1]).any(axis=1)
        beyond |= (source[:, list(layout.zero)] != 0).any(axis=1)
        if beyond.any():
            expected = "expected fx = fy and no tangential distortion"
            raise _unsupported(problem, images[np.argmax(beyond)], expected, what)
        params[images, 0] = focal[:, 0]
        for column, parameter in enumerate(layout.principal_point + layout.distortion, start=1):
            params[images, column] = source[:, parameter]
    problem.check_padding()
    return params


def check_refined(
    problem: Problem, refined: Collection[str], fixed_camera_ids: Collection[int] = ()
) -> None:
    """Raise the error that ``radial_params`` would raise after a solve with these options.

    ``refined``: kinds of refined parameters, "focal", "principal_point", "extra"; others have no
    effect.
    """
    radial_params(problem)
    for image, camera in enumerate(problem.image_camera.tolist()):
        model = problem.camera_models[camera]
        layout, kinds = _LAYOUTS[model], param_kinds(model)
        moving = (*(layout.focal if len(layout.focal) > 1 else ()), *layout.zero)
        free = sorted({kinds[parameter] for parameter in moving} & set(refined))
        if free and problem.camera_ids[camera] not in fixed_camera_ids:
            expected = f"expected {' and '.join(free)} not to be refined"
            raise _unsupported(problem, image, expected)


def _unsupported(
    problem: Problem, image: int, expected: str, what: str = "a BAL file"
) -> InputError:
    camera = problem.image_camera[image]
    name = problem.image_names[image]
    return InputError(
        f"image {problem.image_ids[image]}{f' ({shown(name)})' if name else ''}: {what} cannot "
        f"hold its camera: {expected}, found {problem.camera_models[camera]} "
        f"(camera {problem.camera_ids[camera]})"
    )


def losses(problem: Problem) -> tuple[str, ...]:
    """Return one sentence for each kind of information that a BAL file loses.

    Raises:
        InputError: see ``radial_params``.
    """
    params = radial_params(problem)
    used = np.bincount(problem.image_camera, minlength=problem.num_cameras)
    offset = np.abs(params[:, 1:3]).max(initial=0.0)
    models = sorted({problem.camera_models[camera] for camera in np.flatnonzero(used)} - {"RADIAL"})
    renumbered = [
        what
        for what, ids in (
            ("image", problem.image_ids),
            ("camera", problem.camera_ids[problem.image_camera]),
            ("point", problem.point_ids),
        )
        if not np.array_equal(ids, np.arange(len(ids)))
    ]
    beside = problem_source.beside_the_problem(vars(problem)["source"])
    found = (
        (models, f"Cameras of model {', '.join(models)} come back as RADIAL."),
        (
            (used > 1).any(),
            f"Cameras shared by several images ({(used > 1).sum()}) become one per image.",
        ),
        ((used == 0).any(), f"Cameras without an image ({(used == 0).sum()}) are left out."),
        (
            offset > 0,
            f"Principal points, up to {offset:g} px, are subtracted from the observations.",
        ),
        (problem.num_frames, "Rigs are taken apart: each image gets a pose of its own."),
        (any(problem.image_names), "Names of images are left out."),
        (renumbered, f"Ids are renumbered from 0: {', '.join(renumbered)}."),
        (problem.camera_sizes[problem.image_camera].any(), "Sizes of images are left out."),
        (
            (problem.observation_keypoint >= 0).any(),
            "Keypoint indices, and keypoints without a point, are left out.",
        ),
        (problem.observation_sigma is not None, LOST_SIGMAS),
        (beside, f"{_listed(beside)} are left out.".capitalize()),
    )
    return tuple(sentence for applies, sentence in found if applies)


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
