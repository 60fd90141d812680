"""COLMAP models on disk without pycolmap: reading, and writing what differs in numbers alone.

A solve changes poses, camera parameters and points. Such a problem is written in the format of its
source by replacing these numbers in the source's files, which
``bundle.model.pycolmap.deferred_source`` keeps; all other edits go through pycolmap
(``bundle.model.pycolmap.write_back``).
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.base import address_space
from bundle.errors import InputError, first_line
from bundle.io.atomic.interrupts import interrupts_deferred
from bundle.io.model_notes import check_rig_files, lacks_keypoint_lines, note_contradiction
from bundle.model import rig_arrays
from bundle.model.problem import Problem
from bundle.model.pycolmap.deferred_source import DeferredSource
from bundle.model.pycolmap.problem_source import LOST_SIGMAS

if TYPE_CHECKING:
    import pycolmap

__all__ = ["can_rewrite", "load", "lost", "point_errors", "problem_of", "rewrite", "rewrite_like"]

# What a problem shares with its source where only numbers that a solve changes are other ones.
_SHARED_ARRAYS = (
    "image_ids",
    "image_camera",
    "camera_ids",
    "camera_sizes",
    "point_ids",
    "observation_image",
    "observation_point",
    "observation_keypoint",
    "observation_xy",
    "frame_ids",
    "frame_rig_ids",
    "image_frame",
    "image_sensor",
    "sensor_rig_ids",
    "sensor_camera_ids",
)
_SHARED_NAMES = ("image_names", "camera_models")

_NO_PROJECTION = math.sqrt(sys.float_info.max)
"""COLMAP's reprojection error of a point behind its camera."""


def load(path: str | os.PathLike[str]) -> Problem:
    """Read the model in a folder, the binary one if there are two, as COLMAP does.

    Raises:
        InputError: it is no model, or there is something wrong with it. The message has the file
            and the line (of text) or byte (of binary), what was expected and what was found.
    """
    folder = Path(path)
    if not folder.is_dir():
        found = "something else" if folder.exists() else "nothing"
        raise InputError(f"{folder}: expected the folder of a COLMAP model, found {found}")
    check_rig_files(folder)
    try:
        model, fields = _core.read_colmap_model(os.fsencode(folder))
    except InputError:
        place = lacks_keypoint_lines(folder)
        if place is None:
            raise
        raise InputError(
            f"{place}: expected the keypoints of the image before, in a line that is blank if "
            "there are none, found another image"
        ) from None
    problem = problem_of(folder, model, fields)
    if hasattr(model, "image_poses"):
        note_contradiction(folder, model.image_poses, problem.cam_from_world)
    return problem


def problem_of(folder: Path, model: _core.ColmapModel, fields: dict[str, Any]) -> Problem:
    """Return the problem of what the core read.

    Raises:
        InputError: there is something wrong with it.
    """
    fields["cam_from_world"] = rig_arrays.placed(fields)
    source = DeferredSource(model, fields, partial(_reconstruction, folder, fields))
    try:
        return Problem(**fields, format="colmap", source=source)
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None


def _reconstruction(
    folder: Path, fields: Mapping[str, Any], model: _core.ColmapModel
) -> pycolmap.Reconstruction:
    """Read a model by pycolmap, from its files as they were read.

    Raises: see :meth:`bundle.model.pycolmap.deferred_source.DeferredSource.reconstruction`.
    """
    address_space.require("pycolmap", address_space.PYCOLMAP)
    import tempfile  # takes a while to import

    with interrupts_deferred():  # pycolmap takes a while to import and cannot be interrupted
        import pycolmap

        from bundle.model.pycolmap.reconstruction import remember
    reconstruction = pycolmap.Reconstruction()
    # The files as they were read: those on the disk may have changed.
    with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
        for name, content in model.files().items():
            (Path(temporary) / name).write_bytes(content)
        try:
            if model.is_binary:
                reconstruction.read_binary(temporary)
            else:
                reconstruction.read_text(temporary)
        except (ValueError, LookupError, RuntimeError, MemoryError) as error:
            # Nothing known comes here, but older versions lack the newest camera models.
            raise InputError(
                f"{folder}: expected a model that pycolmap {pycolmap.__version__} reads, "
                f"found: {first_line(error)}"
            ) from None
    for image_id, name in model.names_with_spaces.items():
        reconstruction.image(image_id).name = name
    remember(reconstruction, fields)
    return reconstruction


def can_rewrite(problem: Problem, *, binary: bool) -> bool:
    """Tell whether a problem is its source with other poses, camera parameters and points."""
    return _model(problem, binary=binary) is not None


def rewrite(problem: Problem, folder: Path, *, binary: bool) -> tuple[str, ...]:
    """Write the files of a model into an existing folder; return what they do not hold.

    Only for a problem of which :func:`can_rewrite` is true.

    Raises:
        OSError: the files could not be written, or not whole.
        InputError: there are numbers beyond the parameters of a camera.
    """
    problem.check_padding()
    model = _model(problem, binary=binary)
    assert model is not None
    model.write(
        folder,
        problem.cam_from_world,
        problem.camera_params,
        problem.points,
        _point_errors(problem)[:, None],
        problem.rig_from_world,
        problem.sensor_from_rig,
    )
    return lost(problem, binary=binary)


def rewrite_like(
    problem: Problem,
    point_ids: NDArray[np.int64],
    points: NDArray[np.float64],
    errors: NDArray[np.float64],
    folder: Path,
) -> None:
    """Write cameras and images of a problem and these points beside the keypoints of its source.

    Keypoints and tracks pass from file to file; the points of the problem are not looked at.

    Args:
        problem: its source is a part of a binary model (``_core.read_colmap_part``).
        point_ids: (num_points,) of all points of the source, ascending.
        points: (num_points, 3).
        errors: (num_points,) as :func:`point_errors` returns them.
        folder: an existing one.

    Raises:
        OSError: the files could not be written, or not whole.
        InputError: the files of the source have changed.
    """
    problem.check_padding()
    source: Any = vars(problem)["source"]
    source.model.rewrite(
        folder,
        problem.cam_from_world,
        problem.camera_params,
        points,
        errors[:, None],
        problem.rig_from_world,
        problem.sensor_from_rig,
        point_ids,
    )


def lost(problem: Problem, *, binary: bool) -> tuple[str, ...]:
    """Return what no COLMAP model of this format keeps of a problem, one sentence each."""
    sigmas = () if problem.observation_sigma is None else (LOST_SIGMAS,)
    return (*sigmas, *(() if binary else lost_in_text(problem)))


def lost_in_text(problem: Problem) -> tuple[str, ...]:
    """Return what COLMAP does not read back from text files that hold everything."""
    spaces = sum(" " in name for name in problem.image_names)
    if not spaces:
        return ()
    return (
        f"{spaces} image names have spaces: they are in the text files, but COLMAP reads "
        "only their first word back.",
    )


def _model(problem: Problem, *, binary: bool) -> _core.ColmapModel | None:
    """Return the model whose files a problem can be written by, None if there is none."""
    source: Any = vars(problem)["source"]
    model = source.model if isinstance(source, DeferredSource) else None
    if model is None or model.is_binary != binary:
        return None
    fields = source.fields
    shared = all(getattr(problem, name) == fields[name] for name in _SHARED_NAMES) and all(
        np.array_equal(getattr(problem, name), fields[name]) for name in _SHARED_ARRAYS
    )
    return model if shared else None


def _point_errors(problem: Problem) -> NDArray[np.float64]:
    errors, behind = _core.reprojection_errors(problem, 0, "auto")
    return point_errors(errors, behind, problem.observation_point, problem.num_points)


def point_errors(
    errors: NDArray[np.float64],
    behind: NDArray[np.bool_],
    point: NDArray[np.int32],
    num_points: int,
) -> NDArray[np.float64]:
    """Return the mean reprojection error of each point as COLMAP has it, -1 without observation.

    Args:
        errors: (num_observations,) ||r|| in pixels; nan without a projection.
        behind: (num_observations,) whether the point is behind the camera.
        point: (num_observations,) index of the point.
        num_points: how many there are.
    """
    errors = np.where(behind | np.isnan(errors), _NO_PROJECTION, errors)
    counts = np.bincount(point, minlength=num_points)
    sums = np.bincount(point, weights=errors, minlength=num_points)
    return np.where(counts > 0, sums / np.maximum(counts, 1), -1.0)
