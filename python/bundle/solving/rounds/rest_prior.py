"""Exact marginal prior of the rest of a problem in a local adjustment.

The neighbours are the other images that see a point of a named image. All observations of these
points take part in the adjustment, with neighbours and their cameras as unknowns. The rest of the
problem consists of the observations of other points and of its factors. It is linearized at its
present values, and all its unknowns except neighbours and their cameras are eliminated::

    Lambda' = Lambda_bb - Lambda_ba Lambda_aa^-1 Lambda_ab,
    eta'    = eta_b - Lambda_ba Lambda_aa^-1 eta_a

(core/covariance/rest_information.h). This is a Gaussian prior on neighbours and cameras, with a few
numbers per image. Eliminating the neighbours as well would give an equivalent prior on the refined
points. That prior would be dense over thousands of points. With the neighbours as unknowns the
points stay independent, so that both backends can eliminate them one by one. The two priors agree
to second order. This one also relinearizes the neighbours' observations of the points.

A robust loss of the rest enters with its weights rho' at the present values.

If nothing fixes the gauge, the whole problem can rotate, move and scale. These similarities N
are the motions that change neither a residual of the part nor the prior. The gauge is fixed by
keeping the neighbours in place on average: the displacement d of the neighbours, in units of
Lambda's diagonal D^(1/2), must have no component along N. As a term of Lambda this is Q Q^T with Q
= D^(1/2) times an orthonormal basis of D^(1/2) N. No residual changes along N. Therefore the cost
at the minimum and all gauge-independent results stay the same.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.base.words import SHARE_OF_FREE_MEMORY, format_size, plural
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.problem_keys import parameter_names, touched_ids
from bundle.model.selection import Selection
from bundle.solving.layout import lay_out
from bundle.solving.measured_result import PartRecord, RestRecord
from bundle.solving.request import Bounds
from bundle.solving.result import Result
from bundle.solving.rounds.local_part import LocalPart

if TYPE_CHECKING:
    from bundle.graphs.factors.linear_prior import LinearPrior

_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]

FREE = 1e-10
"""Threshold below which a similarity of the world counts as free: its information, relative to the
sum of the information on single unknowns."""

COPIES = 10
"""Number of matrices of the prior's size that its computation needs: eigenvectors, roots,
Jacobians."""

FAR = 500.0
"""Largest distance of a scene from the origin, in sizes of the scene, for a prior on its poses.

A rotation about the origin moves a camera by this ratio more than a rotation about the scene does.
Its square enters the information matrix, where it would hide the information of the rest."""

SMALLEST = 64 * np.finfo(float).eps
"""Rounding error of an eigenvalue of the scaled information, relative to its size."""


@dataclass(frozen=True)
class RestPrior:
    """Information of the rest of a problem on a part."""

    factor: LinearPrior | None  # the prior; None if the rest has no information
    holds_gauge: bool  # True if there are neighbours, so that no other gauge is needed
    record: RestRecord  # record for reports, before the costs are known


def marginalize_rest(
    whole: Problem, part: LocalPart, options: SolveOptions, bounds: Bounds | None
) -> RestPrior:
    """Marginalize the rest of the problem in a local adjustment.

    ``bounds``: bounds of camera parameters, as in :func:`bundle.solve`.
    """
    _refuse_far_origins(whole)
    options = part.whole_frames_fixed(options).replace(
        gauge="none", refine_sensor_from_rig=False, fixed_sensors=()
    )
    rest = _rest_of(whole, part, options)
    near = Neighbours.find(whole, part, options)
    size = near.size(whole)
    _refuse_too_much(size, int(part.neighbours.sum()))
    information, eta = np.zeros((size, size)), np.zeros(size)
    counts = {"num_eliminated": 0, "num_points": 0, "num_null_points": 0}
    if rest is not None:
        counts = _add_information(rest, near, part, whole, options, bounds, information, eta)
    degrees = _hold_gauge(part, near, options, bounds, information)
    factor, rank = _as_factor(whole, near, information, eta)
    others = np.zeros(whole.num_images, bool)
    if rest is not None:
        others[rest.images] = True
    record = RestRecord(
        num_images=int((others & ~part.neighbours).sum()),
        num_points=counts["num_points"],
        num_points_without_parallax=counts["num_null_points"],
        prior_size=0 if factor is None else len(np.asarray(factor.eta)),
        prior_rank=rank,
        prior_bytes=0 if factor is None else 8 * len(np.asarray(factor.eta)) ** 2,
        gauge_degrees=degrees,
    )
    return RestPrior(factor, bool(near.images.any() or near.frames.any()), record)


def without_prior(
    result: Result, record: PartRecord, prior: RestPrior
) -> tuple[Result, PartRecord]:
    """Return the result without the prior's factor, and the record with the prior's costs."""
    rest = prior.record
    if prior.factor is not None:
        before, after = result.factor_costs_before, result.factor_costs_after
        rest = dataclasses.replace(rest, cost_before=float(before[-1]), cost_after=float(after[-1]))
        summary = result.summary
        result = dataclasses.replace(
            result,
            factor_costs_before=freeze(before[:-1].copy()),
            factor_costs_after=freeze(after[:-1].copy()),
            summary=dataclasses.replace(summary, num_factors=summary.num_factors - 1),
        )
    return result, dataclasses.replace(record, rest=rest)


def _refuse_far_origins(whole: Problem) -> None:
    """Raise an InputError if rounding errors would dominate a prior on poses about the origin."""
    if not (whole.num_images and whole.num_points):
        return
    center = np.median(whole.projection_centers, axis=0)
    size = float(np.median(np.linalg.norm(whole.points - center, axis=1)))
    distance = float(np.linalg.norm(center))
    if distance > FAR * size:
        raise InputError(
            f"rest: marginal expects an origin within {FAR:g} scene sizes, found a scene of size "
            f"{size:.3g} at {distance:.3g} from it; use fixed, or move the scene nearer (bundle "
            "align)"
        )


def _refuse_too_much(size: int, num_neighbours: int) -> None:
    """Raise an InputError if a prior on this number of unknowns does not fit into memory."""
    needed, free = 8.0 * size * size * COPIES, _core.available_memory()
    if needed > SHARE_OF_FREE_MEMORY * free:
        raise InputError(
            f"rest: marginal needs {format_size(needed)} for a dense prior on {size} unknowns of "
            f"{plural(num_neighbours, 'neighbouring image')} and their cameras; this machine has "
            f"{format_size(free)} free; name fewer images, or use fixed"
        )


def _rest_of(whole: Problem, part: LocalPart, options: SolveOptions) -> Selection[Problem] | None:
    """Return the observations of the rest that have information; None without any."""
    touched = touched_ids(part.factors_of_rest)
    length = np.bincount(whole.observation_point, minlength=whole.num_points)
    # A single observation of a free point determines two coordinates of the point, nothing else.
    known = np.isin(whole.point_ids, [*options.fixed_point_ids, *touched["point"]])
    known |= "points" not in options.refine
    points = ~part.seen & ((length >= 2) | known)
    observations = points[whole.observation_point]
    images = np.isin(whole.image_ids, touched["image"])
    images[whole.observation_image[observations]] = True
    if whole.num_frames:
        frames = np.flatnonzero(np.isin(whole.frame_ids, touched["frame"]))
        images |= np.isin(whole.image_frame, frames)
    cameras = np.isin(whole.camera_ids, touched["camera"])
    cameras[whole.image_camera[images]] = True
    if not observations.any() and not part.factors_of_rest:
        return None
    return whole.select(images=images, cameras=cameras, points=points, observations=observations)


def _options_of(selection: Selection[Problem], options: SolveOptions) -> SolveOptions:
    """Return the options with the fixed ids that exist in a selection."""
    problem = selection.problem
    fixed = {}
    for kind, ids in (
        ("image", problem.image_ids),
        ("camera", problem.camera_ids),
        ("point", problem.point_ids),
    ):
        given = np.array(getattr(options, f"fixed_{kind}_ids"), np.int64)
        fixed[f"fixed_{kind}_ids"] = tuple(given[np.isin(given, ids)].tolist())
    return options.replace(**fixed)


def _add_information(
    rest: Selection[Problem],
    near: Neighbours,
    part: LocalPart,
    whole: Problem,
    options: SolveOptions,
    bounds: Bounds | None,
    information: _Floats,
    eta: _Floats,
) -> dict[str, int]:
    """Add the information of the rest on the neighbours; return counts of eliminated unknowns."""
    # Bounds of cameras that take part belong to the part.
    gone = set(rest.problem.camera_ids.tolist()) - set(part.problem.camera_ids.tolist())
    own = {key: value for key, value in (bounds or {}).items() if key[1] in gone}
    layout = lay_out(rest.problem, _options_of(rest, options), part.factors_of_rest, own or None)
    found = _core.marginalize_rest(
        rest.problem,
        layout.options.asdict(),
        layout.limits,
        layout.core_factors(),
        *near.rows_in(rest),
    )
    rows = near.coordinates(whole, rest)
    information[np.ix_(rows, rows)] += found["lambda"]
    eta[rows] += found["eta"]
    return {name: found[name] for name in ("num_eliminated", "num_points", "num_null_points")}


def _hold_gauge(
    part: LocalPart,
    near: Neighbours,
    options: SolveOptions,
    bounds: Bounds | None,
    information: _Floats,
) -> int:
    """Fix the free gauge in the information matrix; return the number of fixed degrees."""
    num_poses = int(near.images.sum() + near.frames.sum())
    if num_poses == 0:
        return 0
    layout = lay_out(part.problem, part.options(options), part.factors, part.bounds(bounds))
    images, frames, _ = near.rows_in(part.selection)
    found = _core.free_similarities(
        part.problem,
        layout.options.asdict(),
        layout.limits,
        layout.core_factors(),
        images,
        frames,
        [],
    )
    if found.shape[1] == 0:
        return 0
    poses = slice(0, 6 * num_poses)
    diagonal = np.diag(information)[poses].copy()
    is_known = bool((diagonal > 0).any())
    root = np.sqrt(diagonal) if is_known else np.ones(6 * num_poses)
    _, scales, combinations = np.linalg.svd(root[:, None] * found, full_matrices=False)
    combinations = combinations[scales > 1e-6 * scales[0]].T / scales[scales > 1e-6 * scales[0]]
    basis = found @ combinations  # orthonormal once scaled by the root
    values, vectors = np.linalg.eigh(basis.T @ information[poses, poses] @ basis)
    held = root[:, None] * (root[:, None] * (basis @ vectors[:, values < FREE]))
    information[poses, poses] += held @ held.T
    return int(held.shape[1])


def _as_factor(
    whole: Problem, near: Neighbours, information: _Floats, eta: _Floats
) -> tuple[LinearPrior | None, int]:
    """Return the prior on the variables that have information, and its rank."""
    kept, masks = [], []
    first = 0
    for key, size in near.variables(whole):
        is_known = bool((np.diag(information)[first : first + size] > 0).any())
        masks.append(np.full(size, is_known))
        kept += [key] if is_known else []
        first += size
    if not kept:
        return None, 0
    rows = np.flatnonzero(np.concatenate(masks))
    information, eta = information[np.ix_(rows, rows)], eta[rows]
    diagonal = np.diag(information)
    root = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / root[:, None] / root)
    regular = values > SMALLEST * len(rows) * values[-1]
    # In the null space of Lambda, eta contains rounding errors only.
    vectors = vectors[:, regular]
    eta = root * (vectors @ (vectors.T @ (eta / root)))
    if not regular.any():
        return None, 0
    points = dict(near.values(whole))
    from bundle.graphs.factors.linear_prior import LinearPrior  # also loads the gradient checker

    prior = LinearPrior(
        information,
        eta,
        {key: points[key] for key in kept},
        tuple(kept),
        manifolds={key: "euclidean" if key[0] == "camera" else "se3" for key in kept},
    )
    return prior, int(regular.sum())


@dataclass(frozen=True)
class Neighbours:
    """Masks of the free neighbours of a part in the full problem; images of frames are excluded."""

    images: _Mask
    frames: _Mask
    cameras: _Mask

    @staticmethod
    def find(whole: Problem, part: LocalPart, options: SolveOptions) -> Neighbours:
        """Return the free neighbours of a part."""
        free = part.neighbours & ~np.isin(whole.image_ids, options.fixed_image_ids)
        frames = np.zeros(whole.num_frames, bool)
        if whole.num_frames:
            of_images = whole.image_frame[free]
            frames[of_images[of_images >= 0]] = True
            free = free & (whole.image_frame < 0)
        cameras = part.cameras & ~np.isin(whole.camera_ids, options.fixed_camera_ids)
        return Neighbours(free, frames, cameras)

    def rows_in(self, selection: Selection[Problem]) -> tuple[list[int], list[int], list[int]]:
        """Return the rows of a selection that are neighbours: images, frames and cameras."""
        masks = (self.images, selection.images), (self.frames, selection.frames)
        images, frames, cameras = (
            np.flatnonzero(mask[indices]).tolist() if len(mask) else []
            for mask, indices in (*masks, (self.cameras, selection.cameras))
        )
        return images, frames, cameras

    def variables(self, whole: Problem) -> list[tuple[tuple[str, int], int]]:
        """Return the key and tangent size of each variable: images, then frames, then cameras."""
        found = [(("image", key), 6) for key in whole.image_ids[self.images].tolist()]
        found += [(("frame", key), 6) for key in whole.frame_ids[self.frames].tolist()]
        for row in np.flatnonzero(self.cameras).tolist():
            width = len(parameter_names("rest", whole, row))
            found.append((("camera", int(whole.camera_ids[row])), width))
        return found

    def size(self, whole: Problem) -> int:
        """Return the number of tangent coordinates of all variables."""
        return sum(size for _, size in self.variables(whole))

    def coordinates(self, whole: Problem, selection: Selection[Problem]) -> NDArray[np.int64]:
        """Return the indices of the tangent coordinates of the variables in a selection."""
        images, frames, cameras = self.rows_in(selection)
        problem = selection.problem
        there = {("image", int(problem.image_ids[row])) for row in images}
        there |= {("frame", int(problem.frame_ids[row])) for row in frames}
        there |= {("camera", int(problem.camera_ids[row])) for row in cameras}
        masks = [np.full(size, key in there) for key, size in self.variables(whole)]
        return np.flatnonzero(np.concatenate(masks)) if masks else np.empty(0, np.int64)

    def values(self, whole: Problem) -> list[tuple[tuple[str, int], _Floats]]:
        """Return the key and value of each variable: images, then frames, then cameras."""
        rows = [*whole.cam_from_world[self.images], *whole.rig_from_world[self.frames]]
        for row in np.flatnonzero(self.cameras).tolist():
            width = len(parameter_names("rest", whole, row))
            rows.append(whole.camera_params[row, :width])
        return [(key, value) for (key, _), value in zip(self.variables(whole), rows, strict=True)]
