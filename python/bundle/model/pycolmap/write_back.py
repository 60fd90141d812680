"""Conversion of a problem to a ``pycolmap.Reconstruction``.

The problem's COLMAP files are written and then read by pycolmap. Source information that files
lose is added afterwards, if the problem still has the records: images and frames without a pose,
and the flags of prior focal lengths.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pycolmap

import bundle._core as _core
from bundle.model.colmap.model_records import ModelRecords, model_records
from bundle.model.problem_arrays import ProblemArrays
from bundle.model.pycolmap.problem_source import Packed, is_reconstruction, packed, unpacked


def to_pycolmap(problem: ProblemArrays) -> pycolmap.Reconstruction:
    """Return a reconstruction: a copy of the source with every edit of the problem applied.

    The errors of the points are recomputed. A problem that does not come from COLMAP gives a new
    reconstruction with the same ids and rigs. Each image without a rig gets a trivial rig and
    frame. Keypoints are in the order of the problem. Images without a name get names such as
    image_000007.

    Raises:
        InputError: COLMAP cannot hold an id, or a keypoint index does not exist or occurs twice;
            the message names the field.
    """
    source = vars(problem)["source"]
    records = model_records(problem, source)
    with tempfile.TemporaryDirectory(prefix="bundle-") as folder:
        _core.write_colmap_records(folder, True, records)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    reconstruction: pycolmap.Reconstruction = unpacked(_pack(files, records, source))
    reconstruction.update_point_3d_errors()
    for point_id in records.point_ids[records.track_lengths == 0].tolist():
        reconstruction.point3D(point_id).error = -1.0  # COLMAP's value for "unknown"
    return reconstruction


def _pack(files: dict[str, bytes], records: ModelRecords, source: Any) -> Packed:
    """Return the files of a model, with the source information that files lose."""
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
