"""A problem as a ``pycolmap.Reconstruction``: the model that is written of it, read by pycolmap.

Information of the source that files lose is added for the records that the problem still has:
images and frames without a pose, and the flags of prior focal lengths.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pycolmap

from bundle import _core
from bundle.model.colmap.model_records import ModelRecords, model_records
from bundle.model.problem_arrays import ProblemArrays
from bundle.model.pycolmap.problem_source import Packed, is_reconstruction, packed, unpacked

__all__ = ["to_pycolmap"]


def to_pycolmap(problem: ProblemArrays) -> pycolmap.Reconstruction:
    """Return a reconstruction: a copy of the source with every edit of the problem in it.

    The errors of the points are recomputed. A problem that did not come from COLMAP gives a new
    reconstruction: the same ids, the rigs of the problem, a trivial rig and frame for each other
    image, keypoints in the order of the problem, and names such as image_000007 for images without
    one.

    Raises:
        InputError: an id that COLMAP cannot hold, or a keypoint index that does not exist or is
            there twice; the message names the field.
    """
    source = vars(problem)["source"]
    records = model_records(problem, source)
    with tempfile.TemporaryDirectory(prefix="bundle-") as folder:
        _core.write_colmap_records(folder, True, records)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    reconstruction: pycolmap.Reconstruction = unpacked(_pack(files, records, source))
    reconstruction.update_point_3d_errors()
    for point_id in records.point_ids[records.track_lengths == 0].tolist():
        reconstruction.point3D(point_id).error = -1.0  # COLMAP's "not known"
    return reconstruction


def _pack(files: dict[str, bytes], records: ModelRecords, source: Any) -> Packed:
    """Return the files of a model, and what they do not hold of its source."""
    if not is_reconstruction(source):
        return Packed(files, [], [], [])
    before = packed(source)
    cameras = set(records.camera_ids.tolist())
    frames = set(records.frames_without_pose)
    return Packed(
        files,
        [frame for frame in before.frames if frame.frame_id in frames],
        [image for image in before.images if image.frame_id in frames],
        [i for i in before.cameras_with_prior_focal_length if i in cameras],
    )
