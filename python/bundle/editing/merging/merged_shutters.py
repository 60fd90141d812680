"""Rolling shutters of a merged model.

Cameras and images of both models keep the shutter and the twist of A. Twists of B are those after B
moved into the frame of A. Neighbours become indices of the merged images.
"""

from __future__ import annotations

import math

import numpy as np

from bundle.editing.merging.joined_images import AddedImages
from bundle.errors import InputError
from bundle.model.colmap.model_records import ModelRecords
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import RollingShutter


def shutter_of(problem: Problem) -> RollingShutter:
    """Return the shutters of a problem, global ones if it has none."""
    return problem.rolling_shutter or RollingShutter(
        direction=("global",) * problem.num_cameras, twist=np.zeros((problem.num_images, 6))
    )


def with_shutters(
    merged: Problem,
    a: Problem,
    b: Problem,
    added: AddedImages,
    records: tuple[ModelRecords, ModelRecords],
) -> Problem:
    """Return the merged model with the rolling shutters of A and of what B adds.

    Args:
        merged: the merged model without shutters.
        a: model A.
        b: model B in the frame of A.
        added: shared images, and images and cameras that B adds.
        records: records of A and B.

    Raises:
        InputError: the models have different row times.
    """
    known = [one.rolling_shutter for one in (a, b) if one.rolling_shutter is not None]
    if not known:
        return merged
    if known[0].row_time != known[-1].row_time:
        raise InputError(
            f"b: expected rolling shutters with the row time {known[0].row_time}, as in the first "
            f"model, found {known[-1].row_time}"
        )
    of_a, of_b = records
    images = dict(
        zip(
            [*of_b.image_ids[added.shared[:, 1]], *of_b.image_ids[added.added]],
            [*of_a.image_ids[added.shared[:, 0]], *added.image_ids],
            strict=True,
        )
    )
    cameras = dict(zip(of_b.camera_ids[added.camera_rows], added.camera_ids, strict=True))
    image_at = {one: row for row, one in enumerate(merged.image_ids.tolist())}
    camera_at = {one: row for row, one in enumerate(merged.camera_ids.tolist())}
    direction = ["global"] * merged.num_cameras
    readout = np.full(merged.num_cameras, np.nan)
    twist = np.zeros((merged.num_images, 6))
    frames = np.full(merged.num_images, np.nan)
    neighbours = np.full((merged.num_images, 2), -1, np.int32)
    own = {one: one for one in [*a.image_ids.tolist(), *a.camera_ids.tolist()]}
    for problem, new_image, new_camera in ((b, images, cameras), (a, own, own)):  # A has priority
        shutter = shutter_of(problem)
        for row, camera in enumerate(problem.camera_ids.tolist()):
            if camera in new_camera:
                direction[camera_at[new_camera[camera]]] = shutter.direction[row]
                readout[camera_at[new_camera[camera]]] = shutter.readout[row]
        rows = [image_at[new_image[one]] for one in problem.image_ids.tolist()]
        twist[rows] = shutter.twist
        frames[rows] = np.nan if shutter.frames is None else shutter.frames
        pairs = shutter.neighbours
        neighbours[rows] = -1 if pairs is None else np.append(rows, -1)[pairs]
    rates = [one.frame_rate for one in known if math.isfinite(one.frame_rate)]
    return merged.replace(
        rolling_shutter=RollingShutter(
            direction=tuple(direction),
            readout=readout,
            twist=twist,
            frames=None if np.isnan(frames).all() else frames,
            neighbours=None if (neighbours < 0).all() else neighbours,
            frame_rate=rates[0] if rates else math.nan,
            row_time=known[0].row_time,
        )
    )
