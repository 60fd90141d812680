"""Rigs of several sensors: their sensors and baselines."""

from __future__ import annotations

import numpy as np

from bundle.base.records import dataclass
from bundle.model.problem import Problem
from bundle.model.rig_arrays import reference_cameras, rig_of_image


@dataclass(frozen=True, kw_only=True)
class SensorSummary:
    """Camera of a rig.

    Attributes:
        camera_id: id in the source.
        is_reference: True if the pose of the rig is that of this camera.
        baseline: distance from the rig's origin (the reference sensor) in the reconstruction's
            length unit.
        num_images: number of its images.
        num_observations: observations in these images; a sensor without any is not refined.
    """

    camera_id: int
    is_reference: bool
    baseline: float
    num_images: int
    num_observations: int


@dataclass(frozen=True, kw_only=True)
class RigSummary:
    """Rig of several sensors.

    Attributes:
        rig_id: id in the source.
        num_frames: number of frames with an image.
        num_images: number of images in these frames.
        sensors: the reference sensor first if it has images, then those with a known
            sensor_from_rig.
    """

    rig_id: int
    num_frames: int
    num_images: int
    sensors: tuple[SensorSummary, ...]


def rig_summaries(problem: Problem) -> tuple[RigSummary, ...]:
    """Return the rigs of a problem by id; () if every image has its own pose."""
    if not problem.num_frames:
        return ()
    rig = rig_of_image(problem)
    observed = np.bincount(problem.observation_image, minlength=problem.num_images)
    references = reference_cameras(problem)
    baselines = np.linalg.norm(problem.sensor_from_rig[:, 4:], axis=1)

    def sensor(camera_id: int, row: int, rig_id: int) -> SensorSummary:
        images = (rig == rig_id) & (problem.image_sensor == row)
        return SensorSummary(
            camera_id=camera_id,
            is_reference=row < 0,
            baseline=0.0 if row < 0 else float(baselines[row]),
            num_images=int(images.sum()),
            num_observations=int(observed[images].sum()),
        )

    summaries = []
    for rig_id in np.unique(problem.frame_rig_ids).tolist():
        rows = np.flatnonzero(problem.sensor_rig_ids == rig_id).tolist()
        first = [sensor(references[rig_id], -1, rig_id)] if rig_id in references else []
        others = [sensor(int(problem.sensor_camera_ids[row]), row, rig_id) for row in rows]
        used = np.unique(problem.image_frame[rig == rig_id])
        summaries.append(
            RigSummary(
                rig_id=rig_id,
                num_frames=len(used),
                num_images=int((rig == rig_id).sum()),
                sensors=(*first, *others),
            )
        )
    return tuple(summaries)
