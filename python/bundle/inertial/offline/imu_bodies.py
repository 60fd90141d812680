"""Bodies that carry the IMU: the images of a model without rigs, or the frames of its rig."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ImuBodies:
    """Images or frames that carry the IMU, in the order of time.

    Attributes:
        kind: "image" or "frame".
        rows: (n,) indices of the images or frames in the problem.
        stamps: (n,) times in ns.
        body_from_imu: (7,) qx qy qz qw tx ty tz, metres; the body's axes are those of the image's
            camera, or of the rig's reference sensor.
    """

    kind: str
    rows: NDArray[np.intp]
    stamps: NDArray[np.int64]
    body_from_imu: Array

    @staticmethod
    def of(problem: Problem, image_times_ns: Any, camera_from_imu: Any) -> ImuBodies:
        """Return the bodies of a problem.

        Args:
            problem: problem without rigs, or with one rig that has all images.
            image_times_ns: (num_images,) times; equal for the images of a frame.
            camera_from_imu: (7,) of each image, or of the images of the reference sensor.

        Raises:
            InputError: there are several rigs, images beside the rig, no image of the reference
                sensor, or the images of a frame have different times.
        """
        times = np.asarray(image_times_ns, np.int64)
        arm = np.asarray(camera_from_imu, np.float64)
        kind = "image"
        if problem.num_frames:
            kind, times = "frame", _frame_times(problem, times)
        order = np.argsort(times, kind="stable")
        return ImuBodies(kind, order, times[order], arm)

    def __len__(self) -> int:
        return len(self.rows)

    def keys(self, problem: Problem) -> list[tuple[str, int]]:
        """Return the keys of the poses as variables of factors."""
        ids = problem.image_ids if self.kind == "image" else problem.frame_ids
        return [(self.kind, one) for one in ids[self.rows].tolist()]

    def imu_rotations(self, problem: Problem) -> Array:
        """Return the (n, 3, 3) rotations world_from_imu."""
        body_from_imu = rotation_matrices(self.body_from_imu[None, :4])[0]
        turned: Array = self.axes(problem) @ body_from_imu
        return turned

    def centers(self, problem: Problem) -> Array:
        """Return the (n, 3) origins of the bodies in the world."""
        shifts = self._poses(problem)[:, 4:]
        found: Array = -np.einsum("nij,nj->ni", self.axes(problem), shifts)
        return found

    def arms(self, problem: Problem) -> Array:
        """Return the (n, 3) vectors from body to IMU along the axes of the world, in metres."""
        along: Array = self.axes(problem) @ self.body_from_imu[4:]
        return along

    def _poses(self, problem: Problem) -> Array:
        poses = problem.cam_from_world if self.kind == "image" else problem.rig_from_world
        return np.asarray(poses[self.rows])

    def axes(self, problem: Problem) -> Array:
        """Return the (n, 3, 3) rotations world_from_body."""
        rotations: Array = rotation_matrices(self._poses(problem)[:, :4])
        return np.swapaxes(rotations, 1, 2)


def _frame_times(problem: Problem, times: NDArray[np.int64]) -> NDArray[np.int64]:
    frame = problem.image_frame
    beside = int((frame < 0).sum())
    if problem.num_rigs > 1 or beside:
        raise InputError(
            f"imu: expected all images on one rig, found {plural(problem.num_rigs, 'rig')} and "
            f"{plural(beside, 'image')} without a rig"
        )
    if not (problem.image_sensor < 0).any():
        raise InputError(
            "imu: expected images of the rig's reference sensor, whose axes camera_from_imu has, "
            "found 0"
        )
    first = np.zeros(problem.num_frames, np.int64)
    first[frame[::-1]] = times[::-1]
    late = np.flatnonzero(times != first[frame])
    if len(late):
        image = int(late[0])
        raise InputError(
            f"imu: expected one time for the images of a frame, found {int(times[image])} ns of "
            f"image {int(problem.image_ids[image])} and {int(first[frame[image]])} ns"
        )
    return first
