"""The part of a problem that moves when only some images do (COLMAP's local bundle adjustment).

The named images and all points that they see are refined. Other images that see one of these
points, the neighbours, take part, so that a point stays where they see it. What becomes of the rest
is one of two choices.

"fixed": neighbours are held, and what none of the named images sees does not reach the solver.
Intrinsics are refined of cameras that took a named image, held of others: a camera that also took
held images changes their projections, which the record of the part says.

"marginal": neighbours and their cameras are unknowns, too, under the prior that all else leaves
when it is marginalised (rest_prior.py). What they become is not part of the result: only named
images, their points and their cameras are. A factor takes part if it touches one of these, or
nothing but neighbours and their cameras; other factors go into the prior.
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
from bundle.solving.request import Bounds
from bundle.solving.round_record import PartRecord

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.rounds.run_state import State

__all__ = ["LocalPart"]

_Indices = NDArray[np.int64]
_Mask = NDArray[np.bool_]


class LocalPart:
    """A problem of its own for some images, and the way back.

    Args:
        whole: the problem.
        image_ids: of the images that are refined, all of them in the problem.
        factors: whose variables have to be in the part; with the rest fixed, those that are nothing
            to the images are held.
        marginal: whether the rest is marginalised.

    Attributes:
        problem: what goes to the solver.
        record: what that is, for reports.
        named_ids: of the images that are refined, in the order of the problem.
        is_marginal: whether the rest is marginalised.
        factors: that take part.
        factors_of_rest: the others.
        named: (num_images,) mask in the whole, as all others: the images that are refined.
        neighbours: other images that take part.
        seen: (num_points,) points that are refined.
        cameras: (num_cameras,) cameras that take part.
        selection: the problem of the part, with its rows in the whole.
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
        shared = np.unique(whole.image_camera[~self.named])
        self.record = PartRecord(
            num_images=int(self.named.sum()),
            num_images_held=int(self.neighbours.sum()),
            num_points=int(self.seen.sum()),
            num_observations=len(self.selection.observations),
            shared_camera_ids=tuple(whole.camera_ids[shared[refined_cameras[shared]]].tolist()),
        )

    def _observing(self, points: _Mask) -> _Mask:
        """Return the named images, and all that see one of these points."""
        whole, images = self._whole, self.named.copy()
        images[whole.observation_image[points[whole.observation_point]]] = True
        return images

    def _split_factors(self) -> None:
        """Leave the factors that touch what is refined, or nothing but neighbours."""
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
        """Return the same part of the whole at other values."""
        return LocalPart(whole, self.named_ids, self._given, marginal=self.is_marginal)

    def check_observed(self) -> None:
        """Raise an InputError if the images see no points."""
        if self.problem.num_observations == 0:
            raise InputError(
                f"only_images: expected images that see points, found none in "
                f"{plural(self.record.num_images, 'image')}"
            )

    def options(self, options: SolveOptions) -> SolveOptions:
        """Return the options of a solve of the part: all that does not belong to it is held."""
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
        # To move a sensor on its rig is to move images of every frame.
        return options.replace(**fixed, refine_sensor_from_rig=False, fixed_sensors=())

    def whole_frames_fixed(self, options: SolveOptions) -> SolveOptions:
        """Return the options with all images of a frame held where one is."""
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
        """Return the bounds without those of cameras that are not in the part."""
        if bounds is None:
            return None
        outside = set(self._whole.camera_ids.tolist()) - set(self.problem.camera_ids.tolist())
        keys = {("camera", camera_id) for camera_id in outside}
        return {key: value for key, value in bounds.items() if key not in keys}

    def merge(self, refined: Problem, state: State | None = None) -> Problem:
        """Return the whole problem with the values of the part that were refined.

        Args:
            refined: the part, or what is left of it.
            state: of the rounds, whose masks say what is left; None: all is.
        """
        whole, part = self._whole, self.selection
        left = np.ones(whole.num_observations, bool)
        stays = np.ones(whole.num_points, bool)
        if state is not None:
            left[part.observations] = state.observation_mask
            stays[part.points] = state.point_mask
            part = part.restricted(state.observation_mask, state.point_mask)
        values = part.put_back(
            whole,
            refined,
            images=self._named,
            frames=_frames_of(whole, self.named)[part.frames] if len(part.frames) else None,
            cameras=self._refined_cameras,
            points=self.seen[part.points],
        )
        return values.select(points=stays, observations=left).problem


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
    """Return the ids of the part that are held: those given, and those that are not refined."""
    given = np.array(getattr(options, name), np.int64)
    unknown = ~np.isin(given, known)
    if unknown.any():
        raise InputError(f"{name}: expected ids in the problem, found {given[unknown][0]}")
    return tuple({*part[~refined].tolist(), *given[np.isin(given, part)].tolist()})
