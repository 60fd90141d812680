"""COLMAP models on disk: text or binary, with rigs and frames or in the older format without them.

This package does not use COLMAP's reader and writer. COLMAP's reader accepts some broken files
silently and allocates memory by counts that may be corrupt. It does not report the line or byte of
an error. COLMAP's writer does not check for write errors.

A solve changes poses, camera parameters and points only. If the output has the format of the
source, these numbers are replaced in the source's files, which
``bundle.model.pycolmap.problem_source`` keeps in memory or open. Comments, other digits and the
order of records stay. All other models are written record by record
(``bundle.model.colmap.model_records``), byte for byte as COLMAP writes them.
"""

from __future__ import annotations

import math
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import at
from bundle.errors import InputError, shown
from bundle.io.atomic.replaced_paths import (
    ROLLING_SHUTTER,
    NoteWarning,
    is_text_model,
    missing_model_files,
    models_below,
)
from bundle.io.rolling_shutter_file import rolling_shutter_text, with_rolling_shutter
from bundle.model import rig_arrays
from bundle.model.colmap.model_records import ModelRecords, check, model_records
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import LOST_SIGMAS, DeferredSource, is_colmap
from bundle.model.rig_arrays import pose_differences

# Fields that a solve does not change.
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

NO_PROJECTION = math.sqrt(sys.float_info.max)
"""COLMAP's reprojection error of a point behind its camera."""


def load(path: str | os.PathLike[str]) -> Problem:
    """Read the model in a folder; if it has a binary and a text model, read the binary one.

    COLMAP makes the same choice.

    Raises:
        InputError: the folder holds no model, or an invalid one. The message has the file, the line
            (text) or byte (binary), the expected and the actual value.
    """
    folder = Path(path)
    if not folder.is_dir():
        found = "no folder" if folder.exists() else "no such path"
        raise InputError(f"{folder}: expected the folder of a COLMAP model, found {found}")
    check_rig_files(folder)
    try:
        model, fields = _core.read_colmap_model(os.fsencode(folder))
    except InputError:
        place = lacks_keypoint_lines(folder)
        if place is None:
            raise
        raise InputError(
            f"{place}: expected the keypoints of the previous image (a blank line without "
            "keypoints), found the next image"
        ) from None
    problem = problem_of(folder, model, fields)
    if hasattr(model, "image_poses"):
        note_contradiction(folder, model.image_poses, problem.cam_from_world)
    return with_rolling_shutter(problem, folder)


def problem_of(folder: Path, model: _core.ColmapModel, fields: dict[str, Any]) -> Problem:
    """Return the problem of a model that the core read."""
    fields["cam_from_world"] = rig_arrays.placed(fields)
    source = DeferredSource(model, fields, folder)
    with at(str(folder)):
        return Problem(**fields, format="colmap", source=source)


def problem_of_records(records: ModelRecords) -> Problem:
    """Return the problem of the records of a model, as if it were read from files."""
    import tempfile  # slow to import

    with tempfile.TemporaryDirectory(prefix="bundle-") as folder:
        _core.write_colmap_records(folder, True, records)
        model, fields = _core.read_colmap_model(folder)
    return problem_of(Path("memory"), model, fields)


def can_rewrite(problem: Problem, *, binary: bool) -> bool:
    """Return True if a problem differs from its source only in poses, parameters and points."""
    return _model(problem, binary=binary) is not None


def check_save(problem: Problem, *, binary: bool) -> None:
    """Raise the InputError that :func:`save` would raise."""
    if can_rewrite(problem, binary=binary):
        problem.check_padding()
        return
    source = vars(problem)["source"]
    _check_cameras(problem)
    check(problem, source)
    if not binary and is_colmap(source):  # images of other problems get names
        _check_names(problem.image_ids, problem.image_names)


def save(problem: Problem, folder: Path, *, binary: bool) -> tuple[str, ...]:
    """Write the files of a model into an existing folder.

    Text has enough digits to read every number back unchanged.

    Args:
        folder: an existing folder, preferably an empty one: files of the other format stay in it.
        binary: True for the binary format, False for text.

    Returns:
        One sentence for each kind of information in the problem or its source that is lost.

    Raises:
        OSError: the files could not be written completely.
        InputError: COLMAP cannot represent the problem.
    """
    _write_shutter(problem, folder)
    model = _model(problem, binary=binary)
    return (
        write(problem, folder, binary=binary) if model is None else _rewrite(problem, folder, model)
    )


def rewrite_like(
    problem: Problem,
    point_ids: NDArray[np.int64],
    points: NDArray[np.float64],
    errors: NDArray[np.float64],
    folder: Path,
) -> None:
    """Write the cameras and images of a problem, the given points, and the source's keypoints.

    Keypoints and tracks are copied from file to file. The points of the problem are ignored.

    Args:
        problem: a problem that was read from part of a binary model (``_core.read_colmap_part``).
        point_ids: (num_points,) ids of all points of the source, ascending.
        points: (num_points, 3) world coordinates.
        errors: (num_points,) errors as returned by :func:`point_errors`.
    """
    problem.check_padding()
    _write_shutter(problem, folder)
    source: Any = vars(problem)["source"]
    source.model.write(
        folder,
        problem.cam_from_world,
        problem.camera_params,
        points,
        errors[:, None],
        problem.rig_from_world,
        problem.sensor_from_rig,
        point_ids,
    )


def _write_shutter(problem: Problem, folder: Path) -> None:
    text = rolling_shutter_text(problem)
    if text:
        (folder / ROLLING_SHUTTER).write_text(text, "utf-8")


def _rewrite(problem: Problem, folder: Path, model: _core.ColmapModel) -> tuple[str, ...]:
    """Write the files of the source with the poses, parameters and points of a problem."""
    problem.check_padding()
    errors, behind = _core.reprojection_errors(problem, 0, "auto")
    model.write(
        folder,
        problem.cam_from_world,
        problem.camera_params,
        problem.points,
        point_errors(errors, behind, problem.observation_point, problem.num_points)[:, None],
        problem.rig_from_world,
        problem.sensor_from_rig,
        problem.point_ids,
    )
    return _lost(problem, binary=model.is_binary)


def write(problem: Problem, folder: Path, *, binary: bool) -> tuple[str, ...]:
    """Write every record of a model; see :func:`save`."""
    source = vars(problem)["source"]
    _check_cameras(problem)
    records = model_records(problem, source)
    if not binary:
        _check_names(records.image_ids, records.image_names)
    _core.write_colmap_records(folder, binary, records)
    losses = []
    if records.num_without_pose:
        losses.append(
            f"Images without a pose are not written ({records.num_without_pose} of "
            f"{problem.num_images + records.num_without_pose}): COLMAP's files hold registered "
            "images only."
        )
    if records.num_new_points:
        losses.append(f"{records.num_new_points} points are not in the source and get no colour.")
    if records.num_renumbered:
        losses.append(
            f"{records.num_renumbered} keypoints get new indices: their images are not in the "
            "source model, so that only observed keypoints are known."
        )
    return (*losses, *_lost(problem, binary=binary))


def _check_cameras(problem: Problem) -> None:
    if problem.num_cameras == 0:
        raise InputError("camera_ids: expected a camera, as in each COLMAP model, found 0")


def _check_names(image_ids: NDArray[np.int64], names: tuple[str, ...]) -> None:
    if not all(names):
        raise InputError(
            f"image {image_ids[names.index('')]}: expected a name, as COLMAP's text format "
            "requires, found an empty name"
        )


def _lost(problem: Problem, *, binary: bool) -> tuple[str, ...]:
    """Return one sentence for each kind of information that this COLMAP format cannot hold."""
    sigmas = () if problem.observation_sigma is None else (LOST_SIGMAS,)
    return (*sigmas, *(() if binary else _lost_in_text(problem)))


def _lost_in_text(problem: Problem) -> tuple[str, ...]:
    """Return one sentence for each kind of information that COLMAP's text reader loses."""
    spaces = sum(" " in name for name in problem.image_names)
    if not spaces:
        return ()
    return (
        f"{spaces} image names have spaces: COLMAP reads only their first word from text files.",
    )


def _model(problem: Problem, *, binary: bool) -> _core.ColmapModel | None:
    """Return the source's model if only numbers in its files change, otherwise None."""
    source: Any = vars(problem)["source"]
    model = source.model if isinstance(source, DeferredSource) else None
    if model is None or model.is_binary != binary:
        return None
    fields = source.fields
    shared = all(getattr(problem, name) == fields[name] for name in _SHARED_NAMES) and all(
        np.array_equal(getattr(problem, name), fields[name]) for name in _SHARED_ARRAYS
    )
    return model if shared else None


def point_errors(
    errors: NDArray[np.float64],
    behind: NDArray[np.bool_],
    point: NDArray[np.int32],
    num_points: int,
) -> NDArray[np.float64]:
    """Return the mean reprojection error of each point in COLMAP's definition; -1 if unobserved.

    Args:
        errors: (num_observations,) ||r|| in pixels; nan without a projection.
        behind: (num_observations,) True if the point is behind the camera.
        point: (num_observations,) index of the point.
    """
    errors = np.where(behind | np.isnan(errors), NO_PROJECTION, errors)
    counts = np.bincount(point, minlength=num_points)
    sums = np.bincount(point, weights=errors, minlength=num_points)
    return np.where(counts > 0, sums / np.maximum(counts, 1), -1.0)


MOST_HINTS = 5  # largest number of models inside a folder that an error lists

_Poses = NDArray[np.float64]

_ANGLE = 1e-3  # rad; rounding to six digits causes smaller differences
_SHIFT = 1e-4  # relative to the largest distance from the origin
_FIELDS = 10  # number of fields in the line of an image


def check_is_model(folder: Path) -> None:
    """Check that a folder has the files of a COLMAP model."""
    missing = missing_model_files(folder)
    if not missing:
        return
    found = f"found a folder without {', '.join(missing)}"
    above = [] if missing_model_files(folder.parent) else [folder.parent]
    models = models_below(folder) or [*folder.glob("*/reconstruction.json")] or above
    if models:
        paths = " or ".join(shown(model) for model in models[:MOST_HINTS])
        more = f" (or {len(models) - MOST_HINTS} more)" if len(models) > MOST_HINTS else ""
        found += f"; try {paths}{more}"
    raise InputError(f"{shown(folder)}: expected a COLMAP model, {found}")


def check_rig_files(folder: Path) -> None:
    """Check that a model has both the rigs file and the frames file, or neither."""
    suffix = _suffix(folder)
    files = [folder / f"{stem}{suffix}" for stem in ("rigs", "frames")]
    there = [file.name for file in files if file.is_file()]
    if len(there) == 1:
        raise InputError(
            f"{shown(folder)}: expected rigs{suffix} and frames{suffix}, or neither, found "
            f"{there[0]} alone"
        )


def lacks_keypoint_lines(folder: Path) -> str | None:
    """Return file and line of an image record found where a line of keypoints is expected."""
    path = folder / "images.txt"
    if not is_text_model(folder):
        return None
    before = False
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            words = line.split()
            if words[:1] and words[0].startswith("#") and not before:
                continue
            is_image = len(words) >= _FIELDS and not _is_number(words[_FIELDS - 1])
            if is_image and before:
                return f"{shown(path)}:{number}"
            before = is_image
    return None


def note_contradiction(folder: Path, image_poses: _Poses, poses: _Poses) -> None:
    """Warn about images whose own poses differ from those of frames and rigs.

    ``image_poses``: (num_images, 7) poses in the images file. ``poses``: (num_images, 7) poses by
    frames and rigs; these are used.
    """
    angle, shift, spread = pose_differences(poses, image_poses)
    other = (angle > _ANGLE) | (shift > _SHIFT * spread)
    if not other.any():
        return
    suffix, count = _suffix(folder), int(other.sum())
    images = "1 image has" if count == 1 else f"{count} images have"
    warnings.warn(
        f"{shown(folder)}: {images} in images{suffix} another pose than in frames{suffix} and "
        f"rigs{suffix} (up to {np.degrees(angle.max()):.3g} degrees and {shift.max():.3g} units); "
        "the frames are used, as in COLMAP",
        NoteWarning,
        stacklevel=4,
    )


def _suffix(folder: Path) -> str:
    return ".txt" if is_text_model(folder) else ".bin"


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
