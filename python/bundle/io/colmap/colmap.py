"""COLMAP models on disk: text or binary, with rigs and frames or from before there were any.

Our own reader, ``bundle.io.colmap.colmap_files``, reads them: pycolmap takes some broken files
without a word, allocates whatever a corrupt count says and never says where an error is. What is
written here is written by pycolmap.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pycolmap

from bundle import _core
from bundle.errors import InputError, first_line
from bundle.io.atomic.model_files import missing_model_files
from bundle.io.colmap import written
from bundle.io.colmap.colmap_files import load, lost
from bundle.model.problem import Problem
from bundle.model.pycolmap.observation_edits import ObservationEdits
from bundle.model.pycolmap.reconstruction import baseline_of, from_pycolmap
from bundle.model.pycolmap.write_back import to_pycolmap, write_back

__all__ = ["check_text", "from_pycolmap", "is_model", "load", "save", "to_pycolmap"]


def is_model(path: str | os.PathLike[str]) -> bool:
    """Tell whether a folder holds cameras, images and points3D, all binary or all text."""
    return not missing_model_files(Path(path))


def save(problem: Problem, folder: Path, binary: bool = True) -> tuple[str, ...]:
    """Write the files of a model into an existing folder.

    Text has 17 digits, enough for every number to be read back as it was.

    Args:
        problem: what to write; see :func:`to_pycolmap`.
        folder: an existing folder, best a fresh one: files of the other format stay in it.
        binary: the format.

    Returns:
        What the files do not hold of the problem and its source, one sentence each.

    Raises:
        OSError: the files could not be written, or not whole.
        InputError: COLMAP cannot represent the problem.
    """
    reconstruction, edits = write_back(problem)
    if not binary:
        _make_fit_for_text(reconstruction)
    try:
        if binary:
            reconstruction.write_binary(folder)
        else:
            reconstruction.write_text(folder)
    except (ValueError, RuntimeError) as error:
        raise written.failure(folder, f"cannot be written: {first_line(error)}") from None
    _check_written(folder, problem)
    return _losses(problem, edits, binary)


def _nameless(image_id: int) -> str:
    return f"image {image_id}: expected a name, which COLMAP's text format needs, found none"


def check_text(problem: Problem) -> None:
    """Raise now what ``save`` would raise for text.

    Raises:
        InputError: an image of a COLMAP model has no name. Others get one when they are written.
    """
    if isinstance(problem.source, pycolmap.Reconstruction) and not all(problem.image_names):
        raise InputError(_nameless(int(problem.image_ids[problem.image_names.index("")])))


def _make_fit_for_text(reconstruction: pycolmap.Reconstruction) -> None:
    """Keep out of text files what COLMAP can write to them but not read back."""
    for image_id in reconstruction.reg_image_ids():
        if not reconstruction.image(image_id).name:
            raise InputError(_nameless(image_id))
    for point in reconstruction.points3D.values():
        if not math.isfinite(point.error):
            point.error = -1.0  # COLMAP's "not known"


def _check_written(folder: Path, problem: Problem) -> None:
    """Look at what arrived on the disk: COLMAP does not notice when a disk is full."""
    if problem.num_images == 0:
        return
    try:
        _core.check_colmap_model(os.fsencode(folder))
    except InputError as error:
        raise written.failure(folder, f"not written whole: {error}") from None
    cut = written.check_text_files(folder)
    if cut is not None:
        raise written.failure(folder, f"not written whole: {cut}")


def _losses(problem: Problem, edits: ObservationEdits, binary: bool) -> tuple[str, ...]:
    losses = []
    if isinstance(problem.source, pycolmap.Reconstruction):
        registered = set(problem.source.reg_image_ids()) | set(problem.image_ids.tolist())
        unregistered = len(set(problem.source.images) - registered)
        if unregistered:
            losses.append(
                f"Images without a pose are not written ({unregistered} of "
                f"{problem.num_images + unregistered}): COLMAP's files hold registered images only."
            )
        new_points = len(np.setdiff1d(problem.point_ids, baseline_of(problem.source).point_ids))
        if new_points:
            losses.append(f"{new_points} points are not in the source and get no colour.")
    if edits.num_renumbered:
        losses.append(
            f"{edits.num_renumbered} keypoints get another index: of images that are not in a "
            "source, only the observed keypoints are known."
        )
    return (*losses, *lost(problem, binary=binary))
