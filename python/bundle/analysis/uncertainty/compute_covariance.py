"""Covariances of a reconstruction at its own values.

Distant points dominate the gauge under inner constraints. The constraints require N^T x = 0 over
all unknowns x, with N the changes by moving, rotating and scaling the world
(core/covariance/free_gauge.h). For a point at a distance d from the centre, the rows of N for
rotation and scale are about d, and their weight is d^2. A point a thousand scene sizes away has the
weight of a million points. If a few such points outweigh all others together, poses are as
uncertain as the direction of these points. This follows from the definition, but users rarely want
it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_result import Covariance, rows_of
from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.base.words import not_converged, plural
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.solving.request import Rules

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""


def intrinsics_covariance(
    problem: Problem, options: SolveOptions, constraints: Rules = ()
) -> Covariance:
    """Return the covariance of the intrinsics, scaled by sigma0, as :func:`covariance` does.

    Sums are doubles also for small models: ten times faster, with fewer digits.
    """
    gauge = "two_cameras"  # intrinsics do not depend on it
    request = SolveRequest(
        problem=problem, options=options.replace(gauge=gauge), constraints=constraints
    )
    recipe = Recipe(request, ("intrinsics",), gauge, "sigma0", "weights", long_sums=False)
    return recipe.compute([])


HARD_TWISTS = (
    "Hard twists ignore that a camera's motion differs from that of its neighbours: standard "
    "deviations are too small, those of readouts by a factor of about 5. Use tied twists."
)


@dataclass(frozen=True)
class Recipe:
    """All inputs of a covariance; supports pickling."""

    request: SolveRequest
    of: tuple[str, ...]
    gauge: str
    scale: str
    robust: str
    long_sums: bool = True

    def compute(self, pairs: list[tuple[int, int]]) -> Covariance:
        """Return the covariance, with the relative poses of these pairs of image ids."""
        given = self.request.problem
        rows = rows_of(given.image_ids, pairs, "image")
        if not given.num_observations:
            raise InputError("problem: expected observations, found 0")
        refuse_huge(given)
        ready = prepare(self.request)
        layout = ready.layout
        factors = layout.core_factors()

        def run(problem: Problem, options: SolveOptions) -> dict[str, Any]:
            return _core.covariance(
                problem,
                options.asdict(),
                layout.limits,
                factors,
                self.gauge == "inner",
                self.robust == "sandwich",
                "points" in self.of,
                rows,
                self.long_sums,
            )

        out = run(ready.start, layout.options)
        dof = out["num_residuals"] - out["num_parameters"] + out["gauge_degrees"]
        if dof < 0:  # a factor of rounding errors is meaningless
            raise InputError(
                "problem: expected at least as many residuals as parameters, found "
                f"{out['num_residuals']} for {out['num_parameters'] - out['gauge_degrees']} "
                "(bundle diagnose names the undetermined parameters)"
            )
        sigma0 = float(np.sqrt(out["weighted_squares"] / dof)) if dof > 0 else float("nan")
        notes = list(out["warnings"])
        if layout.options.twists == "hard":
            notes.append(HARD_TWISTS)
        if out["gauge_degrees"] > 0 and (
            far := note_on_far_points(ready.start, out["null_points"])
        ):
            notes.append(far)
        cost = 0.5 * out["weighted_squares"]
        # Control points start at the intersection of their rays, not at the result of a solve.
        if ready.placed.targets is None and out["predicted_decrease"] > AT_MINIMUM * cost:
            share = 100 * out["predicted_decrease"] / cost if cost > 0 else float("inf")
            notes.append(not_converged(share, layout.options.loss == "trivial"))
        factor = 1.0
        if self.scale == "sigma0":
            if not dof > 0:
                raise InputError(
                    f"scale: expected degrees of freedom to estimate sigma0 from, found {dof} "
                    f"({out['num_residuals']} residuals); use unit"
                )
            if factors is None:
                factor = sigma0 * sigma0
            else:
                out = run(*_scaled(ready.start, layout.options, sigma0))
        return self._result(out, pairs, dof, sigma0, factor, tuple(notes))

    def _result(
        self,
        out: dict[str, Any],
        pairs: list[tuple[int, int]],
        dof: int,
        sigma0: float,
        factor: float,
        notes: tuple[str, ...],
    ) -> Covariance:
        problem = self.request.problem
        refuse_rounding(problem, out)
        num_points = problem.num_points  # control points of the start follow them

        def some(part: str, ids: NDArray[Any], values: NDArray[Any]) -> tuple[Any, Any]:
            count = len(ids) if part in self.of else 0
            scaled = values[:count] if factor == 1 else freeze(values[:count] * factor)
            return freeze(np.array(ids[:count], np.int64)), scaled

        points = out.get("points", np.zeros((0, 3, 3)))
        sensors = np.stack([problem.sensor_rig_ids, problem.sensor_camera_ids], axis=1)
        names = {
            "pose": some("poses", problem.image_ids, out["poses"][: problem.num_images]),
            "frame": some("poses", problem.frame_ids, out["frames"]),
            "sensor": some("poses", sensors, out["sensors"]),
            "camera": some("intrinsics", problem.camera_ids, out["cameras"]),
            "point": some("points", problem.point_ids, points),
        }
        shutters: dict[str, Any] = {
            f"{name}_covariance": out[f"{name}s"]
            if factor == 1
            else freeze(out[f"{name}s"] * factor)
            for name, part in (("twist", "poses"), ("readout", "intrinsics"))
            if f"{name}s" in out and part in self.of
        }
        null = out["null_points"]
        relative = out["relative"]
        return Covariance(
            **{f"{name}_ids": ids for name, (ids, _) in names.items()},
            **{f"{name}_covariance": values for name, (_, values) in names.items()},
            relative_ids=freeze(np.array(pairs, np.int64).reshape(-1, 2)),
            relative_covariance=relative if factor == 1 else freeze(relative * factor),
            null_point_ids=freeze(np.array(problem.point_ids[null[null < num_points]], np.int64)),
            sigma0=sigma0,
            dof=dof,
            gauge=self.gauge,
            scale=self.scale,
            robust=self.robust,
            notes=notes,
            **shutters,
            _relative=replace(self, of=("poses",)).compute,
        )


def _scaled(problem: Problem, options: SolveOptions, sigma0: float) -> tuple[Problem, SolveOptions]:
    """Return a problem with sigmas multiplied by sigma0; a loss keeps its weights."""
    old = problem.observation_sigma
    sigmas = np.full(problem.num_observations, sigma0) if old is None else sigma0 * old
    if options.loss != "trivial":
        options = options.replace(loss_scale=options.loss_scale / sigma0)
    return problem.replace(observation_sigma=sigmas), options


LARGEST = 1e50
"""Limit of coordinates; gauges need fourth powers, which would exceed the range of doubles."""

FAR = 100.0
"""Multiple of the median distance of points from the median of the cameras."""

MOST_NAMED = 5


def note_on_far_points(problem: Problem, null_points: NDArray[np.int32]) -> str:
    """Return a sentence if distant points dominate the inner constraints; else "".

    ``null_points``: rows of points without parallax, which take no part.
    """
    takes_part = np.bincount(problem.observation_point, minlength=problem.num_points) > 0
    takes_part[null_points] = False
    rows = np.flatnonzero(takes_part)
    if not len(rows):
        return ""
    center = np.median(problem.projection_centers, axis=0)
    distances = np.linalg.norm(problem.points[rows] - center, axis=1)
    weights = (distances / max(float(distances.max()), 1e-300)) ** 2
    is_far = distances > FAR * np.median(distances)
    if not weights[is_far].sum() > weights[~is_far].sum():
        return ""
    ids = problem.point_ids[rows[is_far]].tolist()
    named = ", ".join(map(str, ids[:MOST_NAMED])) + (", ..." if len(ids) > MOST_NAMED else "")
    return (
        f"{plural(len(ids), 'point')} more than {FAR:g} times as far away as most (ids {named}) "
        "dominate the inner constraints: sigmas are relative to these. Use two_cameras, or leave "
        "them out."
    )


def refuse_huge(problem: Problem) -> None:
    """Refuse coordinates whose powers exceed the range of doubles; the error names the first."""
    for kind, ids, coordinates in (
        ("point", problem.point_ids, problem.points),
        ("image", problem.image_ids, problem.cam_from_world[:, 4:]),
    ):
        sizes = np.abs(coordinates).max(axis=1, initial=0.0)
        for row in np.flatnonzero(sizes > LARGEST)[:1]:
            raise InputError(
                f"{kind} {ids[row]}: expected coordinates of at most {LARGEST:g}, found "
                f"{sizes[row]:g}; covariances need their fourth powers"
            )


def refuse_rounding(problem: Problem, out: dict[str, Any]) -> None:
    """Refuse negative and infinite variances, and NaN variances of images with observations."""
    seen = np.zeros(problem.num_images, bool)
    seen[problem.observation_image] = True
    for kind, ids, blocks, known in (
        ("image", problem.image_ids, out["poses"], seen),
        ("camera", problem.camera_ids, out["cameras"], False),
        ("point", problem.point_ids, out.get("points", np.zeros((0, 3, 3))), False),
    ):
        variances = np.diagonal(blocks, axis1=1, axis2=2)[: len(ids)]
        wrong = (variances < 0) | np.isinf(variances)
        no_number = np.isnan(variances).any(axis=1) & known
        for row in np.flatnonzero(wrong.any(axis=1) | no_number[: len(wrong)])[:1]:
            raise InputError(
                f"{kind} {ids[row]}: expected variances, found {variances[row].min():g}, which is "
                "only a rounding error: the problem is too ill-conditioned; bundle diagnose names "
                "the cause"
            )


def check_same_factors(result: Result, *given: Iterable[Any]) -> None:
    """Refuse a result without the factors of its solve: it is a minimum with them only."""
    count = len(result.factor_costs_after)
    shutter = result.problem.rolling_shutter
    if result.options.twists == "tied" and shutter is not None:
        count -= int(shutter.tied(result.problem).sum())  # from the options
    if count and not any(_is_given(one) for one in given):
        raise InputError(
            "problem: expected the factors, priors or constraints of the solve "
            f"({count}) together with its result"
        )


def _is_given(values: Iterable[Any]) -> bool:
    return not (isinstance(values, tuple | list) and not values)


def newton_step(
    problem: Problem,
    options: SolveOptions,
    functions: NDArray[np.float64] | None = None,
    *,
    of_poses: bool = False,
) -> dict[str, Any]:
    """Return the Newton step of the observations alone, with all refined variables free.

    The keys are "predicted_decrease" of the cost, "steps" (num_images, 6) of the poses as (w, t),
    "weighted_squares", "num_residuals", "num_parameters" and "gauge_degrees". The residuals have
    the loss's weights.

    ``functions``: (m, num_images, 6 + width) linear functions of the pose (w, t) and of the camera
    parameters of each image; "functions" (m, m) is their covariance in the inner gauge.
    ``of_poses``: True for "poses" (num_images, 6, 6), their covariances in this gauge.
    """
    return _core.covariance(
        problem,
        options.replace(gauge="none", num_threads=1).asdict(),
        None,
        None,
        inner=True,
        sandwich=False,
        of_points=False,
        relative=[],
        long_sums=False,
        of_images=of_poses,
        functions=np.zeros(0) if functions is None else functions,
    )
