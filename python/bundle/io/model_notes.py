"""Checks of the files of a COLMAP model: missing files, contradictory poses."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, shown
from bundle.io.atomic.model_files import is_text_model, missing_model_files, models_below
from bundle.io.atomic.replaced_paths import NoteWarning
from bundle.model.rig_arrays import pose_differences

MOST_HINTS = 5
"""Largest number of models inside a folder that an error lists."""

_Poses = NDArray[np.float64]

_ANGLE = 1e-3  # rad; rounding to six digits causes smaller differences
_SHIFT = 1e-4  # relative to the largest distance from the origin
_FIELDS = 10  # number of fields in the line of an image


def check_is_model(folder: Path) -> None:
    """Check that a folder has the files of a COLMAP model.

    Raises:
        InputError: files are missing; the message names them, and models in folders below.
    """
    missing = missing_model_files(folder)
    if not missing:
        return
    found = f"found a folder without {', '.join(missing)}"
    models = models_below(folder)
    if models:
        paths = " or ".join(shown(model) for model in models[:MOST_HINTS])
        more = f" (or {len(models) - MOST_HINTS} more)" if len(models) > MOST_HINTS else ""
        found += f"; try {paths}{more}"
    raise InputError(f"{shown(folder)}: expected a COLMAP model, {found}")


def check_rig_files(folder: Path) -> None:
    """Check that a model has both the rigs file and the frames file, or neither.

    Raises:
        InputError: one of the two files is missing.
    """
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

    Args:
        folder: folder of the model.
        image_poses: (num_images, 7) poses in the images file.
        poses: (num_images, 7) poses by frames and rigs; these are used.
    """
    angle, shift, spread = pose_differences(poses, image_poses)
    other = (angle > _ANGLE) | (shift > _SHIFT * spread)
    if not other.any():
        return
    suffix, count = _suffix(folder), int(other.sum())
    images = "1 image is" if count == 1 else f"{count} images are"
    warnings.warn(
        f"{shown(folder)}: {images} elsewhere in images{suffix} than frames{suffix} and "
        f"rigs{suffix} say, by up to {np.degrees(angle.max()):.3g} degrees and {shift.max():.3g} "
        "units; the frames count, as for COLMAP",
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
