"""Unknowns of the reduced camera system, by cameras and images, and counts of its equations.

An observation gives two equations. A point seen by two images has three unknowns, an image six, a
camera one per refined parameter. Seven unknowns of a component belong to the gauge. If there are
fewer equations than other unknowns, the current positions of the images are not determined. Two
images that merely happen to have the same position are then not a panorama.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import WeakMode
from bundle.analysis.diagnosis.track_table import TrackTable
from bundle.base.records import dataclass
from bundle.base.words import named, plural, sorted_ids
from bundle.model.cameras import camera_models, param_kinds, project
from bundle.model.problem import Problem

_IMAGE, _FRAME, _SENSOR, _CAMERA = range(4)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CameraPart:
    """Effect of a direction on a parameter of a camera.

    Attributes:
        camera: index of the camera.
        parameter: index of the parameter in the model.
        amount: change of the parameter, in its unit.
        pixels: resulting motion in pixels at the rim of the camera's observations.
    """

    camera: int
    parameter: int
    amount: float
    pixels: float


class Unknowns:
    """Columns of the reduced camera system, and directions in them.

    Args:
        problem: problem with the cameras and images.
        found: result of `_core.reduced_spectrum`.
    """

    def __init__(self, problem: Problem, found: dict[str, Any]) -> None:
        self.problem = problem
        self.kind, self.index, self.coordinate = np.asarray(found["unknowns"]).reshape(-1, 3).T
        self.scale: Floats = found["scale"]
        self.unseen: NDArray[np.bool_] = found["unseen"].astype(bool)
        self._rims: dict[int, Floats] = {}

    @property
    def of_camera(self) -> NDArray[np.bool_]:
        """Mask of the unknowns that are camera parameters."""
        return np.asarray(self.kind == _CAMERA)

    @property
    def of_pose(self) -> NDArray[np.bool_]:
        """Mask of the unknowns that are entries of a pose."""
        return np.asarray(self.kind <= _SENSOR)

    def entities(self) -> NDArray[np.int64]:
        """Return a number for each unknown, equal for all unknowns of one pose or camera."""
        _, numbers = np.unique(np.stack([self.kind, self.index]), axis=1, return_inverse=True)
        return np.asarray(numbers, np.int64).ravel()

    def images(self, chosen: NDArray[Any]) -> NDArray[np.int64]:
        """Return the images whose poses are among the chosen unknowns, ascending."""
        kind, index = self.kind[chosen], self.index[chosen]
        images = [np.unique(index[kind == _IMAGE])]
        if self.problem.num_frames:
            frames = np.isin(self.problem.image_frame, index[kind == _FRAME])
            sensors = np.isin(self.problem.image_sensor, index[kind == _SENSOR])
            images.append(np.flatnonzero(frames | sensors))
        return np.unique(np.concatenate(images)).astype(np.int64)

    def images_of_cameras(self, cameras: list[int]) -> NDArray[np.int64]:
        """Return the images that these cameras took."""
        return np.flatnonzero(np.isin(self.problem.image_camera, cameras))

    def camera_parts(self, direction: Floats) -> list[CameraPart]:
        """Return the effects of a direction in the scaled unknowns on the cameras."""
        parts = []
        for row in np.flatnonzero(self.of_camera & (direction != 0)):
            camera, parameter = int(self.index[row]), int(self.coordinate[row])
            amount = float(direction[row] * self.scale[row])
            pixels = abs(amount) * float(self._rim(camera)[parameter])
            parts.append(CameraPart(camera, parameter, amount, pixels))
        return parts

    def parameter_name(self, part: CameraPart) -> str:
        """Return COLMAP's name of the parameter."""
        return camera_models()[self.problem.camera_models[part.camera]][part.parameter]

    def parameter_kind(self, part: CameraPart) -> str:
        """Return "focal", "principal_point" or another kind."""
        return param_kinds(self.problem.camera_models[part.camera])[part.parameter]

    def focal(self, camera: int) -> float:
        """Return the mean focal length of a camera in pixels; 1 for models without one."""
        kinds = param_kinds(self.problem.camera_models[camera])
        rows = [j for j, kind in enumerate(kinds) if kind == "focal"]
        return float(self.problem.camera_params[camera, rows].mean()) if rows else 1.0

    def _rim(self, camera: int) -> Floats:
        """Return pixels per unit of each parameter, at the rim of the camera's observations."""
        if camera in self._rims:
            return self._rims[camera]
        problem, model = self.problem, self.problem.camera_models[camera]
        params = problem.camera_params[camera, : len(camera_models()[model])]
        own = problem.image_camera[problem.observation_image] == camera
        rays = np.ones((1, 3))
        if own.any():
            xy = problem.observation_xy[own]
            rays[0, :2] = np.quantile(np.abs(xy - np.median(xy, axis=0)), 0.95, axis=0)
            rays[0, :2] /= self.focal(camera)
        change = project(model, params, rays, jacobians=True).d_params[0]
        size: Floats = np.linalg.norm(np.nan_to_num(change), axis=0)
        self._rims[camera] = size
        return size


_GAUGE = 7


@dataclass(frozen=True)
class _Count:
    equations: int
    unknowns: int
    points: int


class EquationCounts:
    """Counts that tell which components have fewer equations than unknowns.

    Components with frames of rigs, or with a camera of another component, are left out.
    """

    def __init__(self, unknowns: Unknowns, tracks: TrackTable) -> None:
        self._unknowns, self._pieces = unknowns, tracks.pieces
        self._short: dict[int, _Count] = {}
        problem = unknowns.problem
        if problem.num_frames or not problem.num_images:
            return
        size = int(tracks.pieces.max(initial=-1)) + 1
        counted = tracks.lengths[tracks.points] > 1
        images = tracks.images[counted]
        equations = 2 * np.bincount(tracks.pieces[images], minlength=size)
        firsts = np.flatnonzero(np.diff(tracks.points[counted], prepend=-1))
        points = np.bincount(tracks.pieces[images[firsts]], minlength=size)
        poses = unknowns.index[unknowns.of_pose]
        free = 3 * points + np.bincount(tracks.pieces[poses], minlength=size)[:size]
        for camera in np.unique(unknowns.index[unknowns.of_camera]).tolist():
            used = np.unique(tracks.pieces[unknowns.images_of_cameras([camera])])
            own = used[used >= 0]
            if len(own) == 1:
                free[own[0]] += int((unknowns.of_camera & (unknowns.index == camera)).sum())
        for piece in np.flatnonzero(equations < free - _GAUGE).tolist():
            self._short[piece] = _Count(
                int(equations[piece]), int(free[piece]) - _GAUGE, int(points[piece])
            )

    def mode(self, images: np.ndarray, dimension: int) -> WeakMode | None:
        """Return the mode of a deficiency of these images if their component has too few equations.

        Otherwise return None.
        """
        pieces = np.unique(self._pieces[images])
        if len(pieces) != 1 or int(pieces[0]) not in self._short:
            return None
        count = self._short[int(pieces[0])]
        ids = sorted_ids(
            self._unknowns.problem.image_ids, np.flatnonzero(self._pieces == pieces[0])
        )
        return WeakMode(
            kind="underdetermined",
            sentence=f"Underdetermined: {named('image', ids)} with "
            f"{plural(count.points, 'common point')} give {count.equations} equations for "
            f"{count.unknowns} unknowns beyond the gauge. Match more points, or hold intrinsics "
            "(--refine poses,points).",
            image_ids=ids,
            camera_ids=(),
            eigenvalue=0.0,
            dimension=dimension,
        )
