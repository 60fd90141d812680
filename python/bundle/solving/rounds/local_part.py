"""Local adjustment: refinement of some images of a problem (COLMAP's local bundle adjustment).

The named images and all points that they see are refined. The neighbours are other images that see
one of these points. They take part, so that their observations constrain the points. The rest of
the problem is treated in one of two ways.

"fixed": The neighbours are constant. Points that no named image sees do not reach the solver.
Intrinsics of the cameras of named images are refined, other cameras are constant. If such a
camera also took constant images, their projections change; the record of the part names it.

"marginal": The neighbours and their cameras are unknowns, too. The rest is marginalized to a prior
on them (rest_prior.py). The result contains only the named images, their points and their cameras;
refined values of neighbours are discarded. A factor takes part if one of its variables is refined,
or if all its variables are neighbours and their cameras. Other factors go into the prior.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.problem_keys import touched_ids
from bundle.model.selection import with_frames
from bundle.solving.measured_result import PartRecord
from bundle.solving.request import Bounds

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.rounds.plan import State

_Indices = NDArray[np.int64]
_Mask = NDArray[np.bool_]


class LocalPart:
    """Subproblem of some images, and the merge of its result into the full problem.

    All masks are masks in the full problem.

    Args:
        whole: the full problem.
        image_ids: ids of the images to refine, all of them in the problem.
        factors: factors, whose variables become members of the part. With the rest fixed, variables
            that are unrelated to the images are constant.
        marginal: True to marginalize the rest.

    Attributes:
        problem: the subproblem, the input of the solver.
        record: description of the subproblem for reports.
        named_ids: ids of the refined images, in the order of the problem.
        is_marginal: True if the rest is marginalized.
        factors: factors that take part.
        factors_of_rest: the other factors.
        named: (num_images,) mask of the refined images.
        neighbours: (num_images,) mask of the other images that take part.
        seen: (num_points,) mask of the refined points.
        cameras: (num_cameras,) mask of the cameras that take part.
        selection: the subproblem with its row indices in the full problem.
    """

    def __init__(
        self,
        whole: Problem,
        image_ids: Iterable[int],
        factors: Iterable[Factor] = (),
        *,
        marginal: bool = False,
    ) -> None:
        self._whole, self.is_marginal, self._given = whole, marginal, tuple(factors)
        self.named = with_frames(whole, np.isin(whole.image_ids, list(image_ids)))
        self.named_ids: list[int] = whole.image_ids[self.named].tolist()
        self.seen = np.zeros(whole.num_points, bool)
        self.seen[whole.observation_point[self.named[whole.observation_image]]] = True
        refined_cameras = np.zeros(whole.num_cameras, bool)
        refined_cameras[whole.image_camera[self.named]] = True
        self.factors: tuple[Factor, ...] = self._given
        self.factors_of_rest: tuple[Factor, ...] = ()
        if marginal:
            self._split_factors()
        touched = touched_ids(self.factors)
        points = self.seen | np.isin(whole.point_ids, touched["point"])
        if marginal:
            self.seen = points
        observations = self.seen[whole.observation_point]
        images = self._observing(self.seen) | np.isin(whole.image_ids, touched["image"])
        if whole.num_frames:
            frames = np.flatnonzero(np.isin(whole.frame_ids, touched["frame"]))
            images |= np.isin(whole.image_frame, frames)
        self.neighbours = images & ~self.named
        self.cameras = np.isin(whole.camera_ids, touched["camera"])
        self.cameras[whole.image_camera[images]] = True
        self.selection = whole.select(
            images=images, cameras=self.cameras, points=points, observations=observations
        )
        self.problem = self.selection.problem
        self._named = self.named[self.selection.images]
        self._seen = self.seen[self.selection.points]
        self._refined_cameras = refined_cameras[self.selection.cameras]
        # A sensor that moves on its rig moves its images in all frames.
        self._sensors = np.ones(whole.num_sensors, bool)
        if whole.num_frames:
            others = whole.image_sensor[~self.named]
            self._sensors[others[others >= 0]] = False
        self._refined_sensors = self._sensors[self.selection.sensors]
        shared = np.unique(whole.image_camera[~self.named])
        self.record = PartRecord(
            num_images=int(self.named.sum()),
            num_images_held=int(self.neighbours.sum()),
            num_points=int(self.seen.sum()),
            num_observations=len(self.selection.observations),
            num_sensors=int(self._refined_sensors.sum()),
            shared_camera_ids=tuple(whole.camera_ids[shared[refined_cameras[shared]]].tolist()),
        )

    def _observing(self, points: _Mask) -> _Mask:
        """Return the mask of the named images and of all images that see one of the points."""
        whole, images = self._whole, self.named.copy()
        images[whole.observation_image[points[whole.observation_point]]] = True
        return images

    def _split_factors(self) -> None:
        """Split the factors into factors that take part and factors of the rest."""
        whole = self._whole
        near = self._observing(self.seen)
        cameras = set(whole.camera_ids[np.unique(whole.image_camera[near])].tolist())
        of_part = {("camera", key) for key in cameras}
        of_rest = {("camera", key) for key in whole.camera_ids.tolist()}
        kinds = [
            ("image", whole.image_ids, self.named, near),
            ("point", whole.point_ids, self.seen, self.seen),
        ]
        if whole.num_frames:
            refined, in_part = _frames_of(whole, self.named), _frames_of(whole, near)
            kinds.append(("frame", whole.frame_ids, refined, in_part))
        for kind, ids, refined, in_part in kinds:
            of_part |= {(kind, key) for key in ids[in_part & ~refined].tolist()}
            of_rest |= {(kind, key) for key in ids[~refined].tolist()}
        here: list[Factor] = []
        there: list[Factor] = []
        for factor in self.factors:
            keys: set[Any] = set(factor.keys)
            (there if keys <= of_rest and not keys <= of_part else here).append(factor)
        self.factors, self.factors_of_rest = tuple(here), tuple(there)

    def of(self, whole: Problem) -> LocalPart:
        """Return this part of the full problem for other values."""
        return LocalPart(whole, self.named_ids, self._given, marginal=self.is_marginal)

    def check_observed(self) -> None:
        """Raise an InputError if the images see no points."""
        if self.problem.num_observations == 0:
            raise InputError(
                "only_images: expected images that see points, found 0 points in "
                f"{plural(self.record.num_images, 'image')}"
            )

    def options(self, options: SolveOptions) -> SolveOptions:
        """Return options for a solve of the part, in which all other parameters are constant."""
        part, whole = self.problem, self._whole
        if self.is_marginal:
            options = self.whole_frames_fixed(options)
        refined = {
            "image": (whole.image_ids, part.image_ids, self._named),
            "camera": (whole.camera_ids, part.camera_ids, self._refined_cameras),
            "point": (whole.point_ids, part.point_ids, self._seen),
        }
        fixed: dict[str, Any] = {}
        for kind, (known, ids, moves) in refined.items():
            free = np.ones(len(ids), bool) if self.is_marginal else moves
            name = f"fixed_{kind}_ids"
            fixed[name] = _held(name, options, known, ids, free)
        if not (options.refine_sensor_from_rig and self._refined_sensors.any()):
            return options.replace(**fixed, refine_sensor_from_rig=False, fixed_sensors=())
        every = self._sensor_keys(whole)
        unknown = [key for key in options.fixed_sensors if key not in every]
        if unknown:
            raise InputError(f"fixed_sensors: expected sensors in the problem, found {unknown[0]}")
        held = {
            key for key, free in zip(self._sensor_keys(part), self._refined_sensors, strict=True)
            if not free or key in options.fixed_sensors
        }  # fmt: skip
        return options.replace(**fixed, fixed_sensors=tuple(sorted(held)))

    def _sensor_keys(self, problem: Problem) -> list[tuple[int, int]]:
        rigs, cameras = problem.sensor_rig_ids.tolist(), problem.sensor_camera_ids.tolist()
        return list(zip(rigs, cameras, strict=True))

    def whole_frames_fixed(self, options: SolveOptions) -> SolveOptions:
        """Return the options with all images of a frame constant if one of them is."""
        whole = self._whole
        held = with_frames(whole, np.isin(whole.image_ids, options.fixed_image_ids))
        ids = {*options.fixed_image_ids, *whole.image_ids[held].tolist()}
        return options.replace(fixed_image_ids=tuple(sorted(ids)))

    @property
    def refined_ids(self) -> dict[str, set[int]]:
        """Ids of the cameras, images and points that are refined."""
        part = self.problem
        return {
            "camera": set(part.camera_ids[self._refined_cameras].tolist()),
            "image": set(part.image_ids[self._named].tolist()),
            "point": set(part.point_ids[self._seen].tolist()),
        }

    def bounds(self, bounds: Bounds | None) -> Bounds | None:
        """Return the bounds of the cameras in the part."""
        if bounds is None:
            return None
        outside = set(self._whole.camera_ids.tolist()) - set(self.problem.camera_ids.tolist())
        keys = {("camera", camera_id) for camera_id in outside}
        return {key: value for key, value in bounds.items() if key not in keys}

    def merge(self, refined: Problem, state: State | None = None) -> Problem:
        """Return the full problem with the refined values of the part.

        ``state``: state of the rounds, with masks of the remaining rows; None: nothing was removed.
        """
        whole, part = self._whole, self.selection
        left = self.observation_mask(state)
        stays = np.ones(whole.num_points, bool)
        if state is not None:
            stays[part.points] = state.point_mask
            part = part.restricted(state.observation_mask, state.point_mask)
        values = part.put_back(
            whole,
            refined,
            images=self._named,
            frames=_frames_of(whole, self.named)[part.frames] if len(part.frames) else None,
            cameras=self._refined_cameras,
            points=self.seen[part.points],
            sensors=self._refined_sensors,
        )
        return values.select(points=stays, observations=left).problem

    def observation_mask(self, state: State | None) -> _Mask | None:
        """Return the mask of the remaining observations of the full problem; None: all."""
        if state is None or state.observation_mask.all():
            return None
        left = np.ones(self._whole.num_observations, bool)
        left[self.selection.observations] = state.observation_mask
        return left


def _frames_of(problem: Problem, images: _Mask) -> _Mask:
    """Return the frames of images as a mask."""
    frames = np.zeros(problem.num_frames, bool)
    of_images = problem.image_frame[images]
    frames[of_images[of_images >= 0]] = True
    return frames


def _held(
    name: str,
    options: SolveOptions,
    known: _Indices,
    part: _Indices,
    refined: NDArray[np.bool_],
) -> tuple[int, ...]:
    """Return the constant ids of the part: ids in the options, and ids that are not refined."""
    given = np.array(getattr(options, name), np.int64)
    unknown = ~np.isin(given, known)
    if unknown.any():
        raise InputError(f"{name}: expected ids in the problem, found {given[unknown][0]}")
    return tuple({*part[~refined].tolist(), *given[np.isin(given, part)].tolist()})
