"""The exact marginal prior of all that a local adjustment leaves out.

Named images see points; the other images that see one of these points are the neighbours. All
observations of these points take part in the adjustment, with neighbours and their cameras as
unknowns. The rest of the problem, observations of other points and its factors, is linearised at
its present values; everything in it but neighbours and their cameras is eliminated::

    Lambda' = Lambda_bb - Lambda_ba Lambda_aa^-1 Lambda_ab,
    eta'    = eta_b - Lambda_ba Lambda_aa^-1 eta_a

(core/covariance/rest_information.h). That is a Gaussian prior on neighbours and cameras, a few
numbers per image. Minimising over the neighbours as well gives the prior on the refined points that
eliminating everything else would leave, but that one is dense over thousands of points; points that
stay independent can be eliminated one by one, by both backends. To second order the two are the
same; this one also relinearises how the neighbours see the points.

A loss of the rest counts with its weights rho' at the present values.

Where all is free, the problem does not say where the world is: rest and part can turn, move and
scale together. That is counted (what no residual of the part and nothing in the prior sees), and
the neighbours stay where they are on average: of d, what they move, in units of Lambda's diagonal
D^(1/2), the part along these similarities N is zero. As a term of Lambda that is Q Q^T with
Q = D^(1/2) times an orthonormal basis of D^(1/2) N. No residual changes along N: neither the cost
at the minimum nor anything that does not depend on the gauge does.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.base.arrays import freeze
from bundle.base.memory_sizes import SHARE_OF_FREE_MEMORY, format_size
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.problem_keys import touched_ids
from bundle.model.selection import Selection
from bundle.solving.layout import lay_out
from bundle.solving.request import Bounds
from bundle.solving.result import Result
from bundle.solving.round_record import PartRecord, RestRecord
from bundle.solving.rounds.local_part import LocalPart
from bundle.solving.rounds.neighbours import Neighbours

if TYPE_CHECKING:
    from bundle.graphs.factors.linear_prior import LinearPrior

__all__ = ["RestPrior", "marginalize_rest", "without_prior"]

_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]

FREE = 1e-10
"""Information along a similarity of the world beside the sum of that of single unknowns, below
which nothing holds it."""

COPIES = 10
"""Matrices of its size that a prior takes while it is made: eigenvectors, roots, Jacobians."""

FAR = 500.0
"""Sizes of a scene between it and the origin from which on a prior on its poses is refused: a turn
about the origin moves a camera by as many times as much as the scene, and in the information matrix
the square of that hides what the rest knows."""

SMALLEST = 64 * np.finfo(float).eps
"""Rounding of an eigenvalue of the scaled information, relative to its size."""


@dataclass(frozen=True)
class RestPrior:
    """Information of the rest of a problem on a part.

    Attributes:
        factor: None without information.
        holds_gauge: whether there are neighbours, so that no other gauge is needed.
        record: for reports, costs not known yet.
    """

    factor: LinearPrior | None
    holds_gauge: bool
    record: RestRecord


def marginalize_rest(
    whole: Problem, part: LocalPart, options: SolveOptions, bounds: Bounds | None
) -> RestPrior:
    """Marginalise what does not take part in a local adjustment.

    Args:
        whole: the problem.
        part: of it.
        options: of the whole.
        bounds: of camera parameters, as in :func:`bundle.solve`.

    Raises:
        InputError: a factor of the rest couples a point with something else or is a function in
            Python; the prior does not fit into the memory; the origin is far outside the scene.
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
    """Return the result with the factors that were given, and the record with the prior's costs."""
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
    """Raise an InputError if a prior on poses about the origin would be one of rounding errors."""
    if not (whole.num_images and whole.num_points):
        return
    center = np.median(whole.projection_centers, axis=0)
    size = float(np.median(np.linalg.norm(whole.points - center, axis=1)))
    distance = float(np.linalg.norm(center))
    if distance > FAR * size:
        raise InputError(
            f"rest: marginal expects the origin within {FAR:g} times the size of the scene, found "
            f"a scene of size {size:.3g} at {distance:.3g} from it; use fixed, or move the scene "
            "nearer (bundle align)"
        )


def _refuse_too_much(size: int, num_neighbours: int) -> None:
    """Raise an InputError if a prior on so many unknowns does not fit into the memory."""
    needed, free = 8.0 * size * size * COPIES, _core.available_memory()
    if needed > SHARE_OF_FREE_MEMORY * free:
        raise InputError(
            f"rest: marginal needs {format_size(needed)} for a dense prior on {size} unknowns of "
            f"{plural(num_neighbours, 'neighbouring image')} and their cameras, of which this "
            f"machine has {format_size(free)} free; name fewer images, or use fixed"
        )


def _rest_of(whole: Problem, part: LocalPart, options: SolveOptions) -> Selection | None:
    """Return what is not in the part and can say something; None if nothing is."""
    touched = touched_ids(part.factors_of_rest)
    length = np.bincount(whole.observation_point, minlength=whole.num_points)
    # One observation of a free point determines two of its coordinates, and nothing else.
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


def _options_of(selection: Selection, options: SolveOptions) -> SolveOptions:
    """Return the options with the ids that a selection has."""
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
    rest: Selection,
    near: Neighbours,
    part: LocalPart,
    whole: Problem,
    options: SolveOptions,
    bounds: Bounds | None,
    information: _Floats,
    eta: _Floats,
) -> dict[str, int]:
    """Add what the rest knows of the neighbours; return what is gone."""
    # A bound of a camera that takes part is that of the part.
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
    """Hold what nothing holds of the world; return how many degrees of freedom that takes."""
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
    """Return the prior on the variables of which something is known, and its rank."""
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
    # Of what Lambda does not know, rounding is all that eta has.
    vectors = vectors[:, regular]
    eta = root * (vectors @ (vectors.T @ (eta / root)))
    if not regular.any():
        return None, 0
    points = dict(near.values(whole))
    from bundle.graphs.factors.linear_prior import LinearPrior  # brings the gradient checker along

    prior = LinearPrior(
        information,
        eta,
        {key: points[key] for key in kept},
        tuple(kept),
        manifolds={key: "euclidean" if key[0] == "camera" else "se3" for key in kept},
    )
    return prior, int(regular.sum())
