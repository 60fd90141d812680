"""The part of a problem that moves when only some images do (COLMAP's local bundle adjustment).

The named images and all points that they see are refined. Other images that see one of these points
take part, held, so that a point stays where they see it; what none of the named images sees does
not reach the solver. Intrinsics are refined of cameras that took a named image, held of others: a
camera that also took held images changes their projections, which the record of the part says.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.round_record import PartRecord
from bundle.rounds.filtering import subset

if TYPE_CHECKING:
    from bundle.graph import Factor

__all__ = ["LocalPart", "touched_ids"]

_Indices = NDArray[np.int64]


class LocalPart:
    """A problem of its own for some images, and the way back.

    Args:
        whole: the problem.
        image_ids: of the images that are refined, all of them in the problem.
        factors: whose variables have to be in the part; held, where they are nothing to the images.

    Attributes:
        problem: what goes to the solver.
        record: what that is, for reports.
        named_ids: of the images that are refined, in the order of the problem.
    """

    def __init__(
        self, whole: Problem, image_ids: Iterable[int], factors: Iterable[Factor] = ()
    ) -> None:
        self._whole = whole
        self.named_ids = list(image_ids)
        named = with_frames(whole, np.isin(whole.image_ids, self.named_ids))
        self.named_ids = whole.image_ids[named].tolist()
        seen = np.zeros(whole.num_points, bool)
        seen[whole.observation_point[named[whole.observation_image]]] = True
        self._observations = np.flatnonzero(seen[whole.observation_point])
        images = named.copy()
        images[whole.observation_image[self._observations]] = True
        points, refined_cameras = seen.copy(), np.zeros(whole.num_cameras, bool)
        refined_cameras[whole.image_camera[named]] = True
        touched = touched_ids(factors)
        images |= np.isin(whole.image_ids, touched["image"])
        points |= np.isin(whole.point_ids, touched["point"])
        cameras = np.isin(whole.camera_ids, touched["camera"])
        cameras[whole.image_camera[images]] = True
        self._images, self._points, self._cameras = map(np.flatnonzero, (images, points, cameras))
        self._named, self._seen = named[self._images], seen[self._points]
        self._refined_cameras = refined_cameras[self._cameras]
        self._take_rigs()
        self.problem = self._extract()
        shared = np.unique(whole.image_camera[~named])
        self.record = PartRecord(
            num_images=int(named.sum()),
            num_images_held=int(images.sum() - named.sum()),
            num_points=int(seen.sum()),
            num_observations=len(self._observations),
            shared_camera_ids=tuple(whole.camera_ids[shared[refined_cameras[shared]]].tolist()),
        )

    def options(self, options: SolveOptions) -> SolveOptions:
        """Return the options of a solve of the part: all that does not belong to it is held."""
        part, whole = self.problem, self._whole
        return options.replace(
            fixed_image_ids=_held(
                "fixed_image_ids", options, whole.image_ids, part.image_ids, self._named
            ),
            fixed_camera_ids=_held(
                "fixed_camera_ids",
                options,
                whole.camera_ids,
                part.camera_ids,
                self._refined_cameras,
            ),
            fixed_point_ids=_held(
                "fixed_point_ids", options, whole.point_ids, part.point_ids, self._seen
            ),
            # To move a sensor on its rig is to move images of every frame.
            refine_sensor_from_rig=False,
            fixed_sensors=(),
        )

    @property
    def refined_ids(self) -> dict[str, set[int]]:
        """Ids of the cameras, images and points that are refined."""
        part = self.problem
        return {
            "camera": set(part.camera_ids[self._refined_cameras].tolist()),
            "image": set(part.image_ids[self._named].tolist()),
            "point": set(part.point_ids[self._seen].tolist()),
        }

    def bounds(self, bounds: Mapping[Any, Any] | None) -> Mapping[Any, Any] | None:
        """Return the bounds without those of cameras that are not in the part."""
        if bounds is None:
            return None
        outside = set(self._whole.camera_ids.tolist()) - set(self.problem.camera_ids.tolist())
        keys = {("camera", camera_id) for camera_id in outside}
        return {key: value for key, value in bounds.items() if key not in keys}

    def merge(self, refined: Problem, observations: _Indices, points: _Indices) -> Problem:
        """Return the whole problem with the values of the part that were refined.

        Args:
            refined: the part, or what is left of it.
            observations: which observations of the part are left.
            points: which points of the part are left.
        """
        whole = self._whole
        pose, params = whole.cam_from_world.copy(), whole.camera_params.copy()
        xyz = whole.points.copy()
        pose[self._images[self._named]] = refined.cam_from_world[self._named]
        rigs: dict[str, Any] = {}
        if len(self._frames):
            frames, arms = whole.rig_from_world.copy(), whole.sensor_from_rig.copy()
            frames[self._frames] = refined.rig_from_world
            arms[self._sensors] = refined.sensor_from_rig
            rigs = {"rig_from_world": frames, "sensor_from_rig": arms}
        width = refined.camera_params.shape[1]
        params[self._cameras[self._refined_cameras], :width] = refined.camera_params[
            self._refined_cameras
        ]
        moved = self._seen[points]
        xyz[self._points[points[moved]]] = refined.points[moved]
        values = whole.replace(cam_from_world=pose, camera_params=params, points=xyz, **rigs)
        left = np.ones(whole.num_observations, bool)
        left[self._observations] = False
        left[self._observations[observations]] = True
        stays = np.ones(whole.num_points, bool)
        stays[self._points] = False
        stays[self._points[points]] = True
        return subset(values, left, stays)

    def _extract(self) -> Problem:
        whole = self._whole
        image_row = np.zeros(whole.num_images, np.int32)
        image_row[self._images] = np.arange(len(self._images))
        camera_row = np.zeros(whole.num_cameras, np.int32)
        camera_row[self._cameras] = np.arange(len(self._cameras))
        point_row = np.zeros(whole.num_points, np.int32)
        point_row[self._points] = np.arange(len(self._points))
        seen, sigma = self._observations, whole.observation_sigma
        return Problem(
            cam_from_world=whole.cam_from_world[self._images],
            image_ids=whole.image_ids[self._images],
            image_names=tuple(whole.image_names[index] for index in self._images.tolist()),
            image_camera=camera_row[whole.image_camera[self._images]],
            camera_ids=whole.camera_ids[self._cameras],
            camera_models=tuple(whole.camera_models[index] for index in self._cameras.tolist()),
            camera_params=whole.camera_params[self._cameras],
            camera_sizes=whole.camera_sizes[self._cameras],
            points=whole.points[self._points],
            point_ids=whole.point_ids[self._points],
            observation_image=image_row[whole.observation_image[seen]],
            observation_point=point_row[whole.observation_point[seen]],
            observation_xy=whole.observation_xy[seen],
            observation_sigma=None if sigma is None else sigma[seen],
            format=whole.format,
            **self._extract_rigs(),
        )

    def _take_rigs(self) -> None:
        """Find frames and sensors of the part; sensors of rigs that have a frame in it."""
        whole = self._whole
        self._frames = self._sensors = np.empty(0, np.int64)
        if not whole.num_frames:
            return
        frames = whole.image_frame[self._images]
        self._frames = np.unique(frames[frames >= 0])
        rigs = whole.frame_rig_ids[self._frames]
        self._sensors = np.flatnonzero(np.isin(whole.sensor_rig_ids, rigs))

    def _extract_rigs(self) -> dict[str, Any]:
        whole = self._whole
        if not len(self._frames):
            return {}
        frame_row = np.full(whole.num_frames + 1, -1, np.int32)  # the last for no frame, -1
        frame_row[self._frames] = np.arange(len(self._frames))
        sensor_row = np.full(whole.num_sensors + 1, -1, np.int32)
        sensor_row[self._sensors] = np.arange(len(self._sensors))
        return {
            "rig_from_world": whole.rig_from_world[self._frames],
            "frame_ids": whole.frame_ids[self._frames],
            "frame_rig_ids": whole.frame_rig_ids[self._frames],
            "image_frame": frame_row[whole.image_frame[self._images]],
            "sensor_from_rig": whole.sensor_from_rig[self._sensors],
            "sensor_rig_ids": whole.sensor_rig_ids[self._sensors],
            "sensor_camera_ids": whole.sensor_camera_ids[self._sensors],
            "image_sensor": sensor_row[whole.image_sensor[self._images]],
        }


def with_frames(problem: Problem, images: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the images, and those that share a frame with one of them."""
    if not problem.num_frames:
        return images
    frames = problem.image_frame[images]
    return images | np.isin(problem.image_frame, frames[frames >= 0])


def touched_ids(factors: Iterable[Factor]) -> dict[str, list[int]]:
    """Return the ids of the variables of factors by kind."""
    touched: dict[str, list[int]] = {"image": [], "camera": [], "point": []}
    keys: list[Any] = [key for factor in factors for key in factor.keys]
    for kind, number in keys:
        touched[kind].append(number)
    return touched


def _held(
    name: str,
    options: SolveOptions,
    known: _Indices,
    part: _Indices,
    refined: NDArray[np.bool_],
) -> tuple[int, ...]:
    """Return the ids of the part that are held: those given, and those that are not refined."""
    given = np.array(getattr(options, name), np.int64)
    unknown = ~np.isin(given, known)
    if unknown.any():
        raise InputError(f"{name}: expected ids in the problem, found {given[unknown][0]}")
    return tuple({*part[~refined].tolist(), *given[np.isin(given, part)].tolist()})
