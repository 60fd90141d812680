"""Reliability of an adjustment: which errors of the measurements the others would show.

With the residuals r of observations in sigmas, weighted by the loss, and R = I - J C J^T
(``core/covariance/reliability.h``), the redundancy of a component is r_i = R_ii: the share of an
error that its own residual shows. Residuals have the covariance R, so that

    w_i = residual_i / sqrt(R_ii)

has the standard deviation 1. An error of b sigmas shifts w_i by b sqrt(R_ii). A test of w at the
level 0.1 % (limit 3.29) finds an error with the power 80 % if it shifts w by ``delta0`` = 4.13 (W.
Baarda, 1968). In both coordinates of an observation, the error that shows least is along the
eigenvector u of the least eigenvalue l of the 2 x 2 block of R. Its minimal detectable size is
delta0 sigma / sqrt(l), and it moves any function of the unknowns by at most delta0 sqrt((1 - l) /
l) of its sigmas. ``delta0`` is that of a test of one number, along u, as in Baarda's B-method.

Below a redundancy of :data:`NOT_CHECKABLE`, an error is so large before it is seen that the linear
theory no longer holds: planted errors of 98 px shifted w by 0.8 instead of 4.13. Such
measurements therefore have no numbers. A point with two rays has four residuals and three
coordinates: along the epipolar line it follows any error, and l = 0 for both observations, although
their components may have redundancies of 0.5.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_by_input import (
    AT_MINIMUM,
    at_control_points,
    refuse_huge,
    request_at,
)
from bundle.analysis.uncertainty.reliability_result import (
    CONTROL_POINT,
    DOWNWEIGHTED,
    NUM_WORST,
    WEAK,
    ImageReliability,
    PriorReliability,
    Reliability,
    WeakObservation,
)
from bundle.base.arrays import freeze
from bundle.base.words import named, not_converged, plural
from bundle.errors import InputError
from bundle.interface import option_fields
from bundle.interface.analysis_options import DELTA0, NOT_CHECKABLE, SCALES
from bundle.interface.finding import Finding
from bundle.interface.option_class import takes_options
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.io.files import Source
from bundle.model.problem import Problem
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

_Floats = NDArray[np.float64]


@takes_options(SolveOptions)
def reliability(
    problem: Source | Result,
    options: SolveOptions | None = None,
    *,
    delta0: float = DELTA0,
    scale: str = "unit",
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    **changes: Any,
) -> Reliability:
    """Compute the redundancy of every measurement, and which of its errors would go unnoticed.

    All numbers are those of the linearisation at the problem's values, which should be a minimum of
    a solve with the same options. They do not depend on a gauge. Under a loss, they hold for its
    weights: a large error already has a small weight, so that no test finds it.

    Args:
        problem: problem, its path, or a pycolmap.Reconstruction. For a :class:`Result`, its refined
            problem and its options are used.
        options: refined and constant parameters, and the loss, as in :func:`bundle.solve`; the
            gauge has no effect.
        delta0: shift of a standardised residual that a test has to find: 4.13 for the level 0.1 %
            and the power 80 %.
        scale: "unit": residuals have sigma 1 px, or ``observation_sigma`` if available; "sigma0":
            these times sigma0, estimated from the residuals. Priors keep their redundancies.
        factors: factors in addition to the observations, as in :func:`bundle.solve`.
        priors: measured positions and control points, likewise.
        align: likewise.
        bounds: bounds of camera parameters; a parameter at an active bound is constant.
        constraints: rules, as in :func:`bundle.solve`.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: an argument is wrong, or as :func:`bundle.covariance`.
        OSError: the path cannot be read.

    Example:
        >>> found = bundle.reliability("sparse/0")
        >>> found.images[0].share, found.worst[0].minimal_detectable_error
    """
    request = request_at(
        problem, options, changes, "reliability", factors=factors, priors=priors, align=align,
        bounds=bounds, constraints=constraints,
    )  # fmt: skip
    return reliability_of(prepare(request), delta0, scale)


def reliability_of(prepared: Prepared, delta0: float = DELTA0, scale: str = "unit") -> Reliability:
    """Compute the reliability at the start of a prepared request; see :func:`reliability`."""
    delta0 = option_fields.number("delta0", delta0, above=0.0)
    scale = choice("scale", scale, SCALES)
    prepared = at_control_points(prepared)
    start, layout, given = prepared.start, prepared.layout, prepared.request.problem
    if not given.num_observations:
        raise InputError("problem: expected observations, found 0")
    refuse_huge(start)
    out = _core.reliability(
        start,
        layout.options.asdict(),
        layout.limits,
        layout.core_factors(),
        NOT_CHECKABLE,
        NUM_WORST,
    )
    dof = out["num_residuals"] - out["num_parameters"] + out["gauge_degrees"]
    sigma0 = float(np.sqrt(out["weighted_squares"] / dof)) if dof > 0 else float("nan")
    if scale == "sigma0" and not dof > 0:
        raise InputError(
            f"scale: expected degrees of freedom to estimate sigma0 from, found {dof}; use unit"
        )
    rows = _Rows(start, out, delta0, sigma0 if scale == "sigma0" else 1.0)
    loss = layout.options.loss
    priors = _priors(prepared, out)
    images, lengths = _images(start, rows), rows.count(start.observation_point, start.num_points)
    of_two = rows.uncontrolled & (lengths[start.observation_point] == 2)
    total = float(np.nansum(rows.redundancy)) + sum(
        one.redundancy for one in priors if np.isfinite(one.redundancy)
    )
    notes = [*notes_of(prepared, out)]
    if of_two.any():
        notes.append(
            "The two observations of a point with two rays are never checked along the epipolar "
            "line; a third ray checks all."
        )
    downweighted = int((rows.used & (rows.weight < DOWNWEIGHTED)).sum())
    if loss != "trivial":
        notes.append(
            f"All numbers hold with the weights of the loss {loss}: {downweighted:,} observations "
            f"have a weight below {DOWNWEIGHTED:g} and may be errors."
        )
    n, num_points = given.num_observations, given.num_points
    cameras = start.image_camera[start.observation_image]
    return Reliability(
        redundancy=freeze(rows.redundancy[:n]),
        least_redundancy=freeze(rows.least[:n]),
        weakest_direction=freeze(rows.direction[:n]),
        standardized=freeze(rows.standardized[:n]),
        minimal_detectable_error=freeze(rows.detectable[:n]),
        external_bound=freeze(rows.bound[:n]),
        weight=freeze(rows.weight[:n]),
        image_redundancy=freeze(
            rows.total(start.observation_image, start.num_images)[: given.num_images]
        ),
        point_redundancy=freeze(rows.total(start.observation_point, start.num_points)[:num_points]),
        camera_redundancy=freeze(rows.total(cameras, start.num_cameras)),
        sum=total,
        dof=dof,
        num_residuals=out["num_residuals"],
        sigma0=sigma0,
        scale=scale,
        delta0=delta0,
        loss=loss,
        num_used=int(rows.used.sum()),
        num_zero_weight=int((rows.weight == 0).sum()),
        num_downweighted=downweighted,
        num_uncontrolled=int(rows.uncontrolled.sum()),
        num_two_view=int(of_two.sum()),
        num_points_at_infinity=len(out["null_points"]),
        images=images,
        priors=priors,
        worst=_worst(start, rows, out["worst"]),
        findings=tuple(_findings(images, priors)),
        notes=tuple(notes),
    )


def notes_of(prepared: Prepared, out: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the warnings of the core, and whether the problem is not at a minimum."""
    cost, decrease = 0.5 * out["weighted_squares"], out["predicted_decrease"]
    if not decrease > AT_MINIMUM * cost > 0:
        return tuple(out["warnings"])
    is_plain = prepared.layout.options.loss == "trivial"
    return (*out["warnings"], not_converged(100 * decrease / cost, is_plain))


class _Rows:
    """Numbers per observation of the core's output."""

    def __init__(
        self, start: Problem, out: Mapping[str, Any], delta0: float, factor: float
    ) -> None:
        self.weight = out["weights"]
        self.used = self.weight > 0
        self._rows = slice(None) if self.used.all() else self.used
        self.redundancy = 1 - out["leverages"][:, ::2]
        self.redundancy[~self.used] = np.nan
        self.direction, self.least = out["along"], out["least"]
        self._sum = (self.redundancy[:, 0] + self.redundancy[:, 1])[self._rows]
        self.uncontrolled = self.least < NOT_CHECKABLE
        sigma = 1.0 if start.observation_sigma is None else start.observation_sigma
        with np.errstate(invalid="ignore", divide="ignore"):
            self.standardized = out["residuals"] / (factor * np.sqrt(self.redundancy))
            self.detectable = delta0 * factor * sigma / np.sqrt(self.weight * self.least)
            self.bound = delta0 * np.sqrt(np.maximum(1 - self.least, 0) / self.least)
        self.standardized[self.redundancy < NOT_CHECKABLE] = np.nan
        for of_checked in (self.detectable, self.bound):
            of_checked[self.uncontrolled] = np.nan
        self.delta0 = delta0

    def count(self, owner: NDArray[Any], size: int) -> NDArray[np.int64]:
        """Return the number of used observations of each owner."""
        return np.bincount(owner[self._rows], minlength=size)

    def total(self, owner: NDArray[Any], size: int) -> _Floats:
        """Return the sum of the redundancies of each owner."""
        return np.bincount(owner[self._rows], self._sum, size).astype(float)


def _images(start: Problem, rows: _Rows) -> tuple[ImageReliability, ...]:
    owner = start.observation_image
    counts, sums = rows.count(owner, start.num_images), rows.total(owner, start.num_images)
    found = [
        ImageReliability(
            image_id=int(start.image_ids[i]),
            name=start.image_names[i],
            num_observations=int(counts[i]),
            redundancy=float(sums[i]),
            share=float(sums[i] / (2 * counts[i])),
        )
        for i in np.flatnonzero(counts)
    ]
    return tuple(sorted(found, key=lambda one: one.share))


def _priors(prepared: Prepared, out: Mapping[str, Any]) -> tuple[PriorReliability, ...]:
    """Return the factors that have a value, the least checked first."""
    known, targets = prepared.layout.known, prepared.placed.targets
    if known is None:
        return ()
    names: dict[Any, str] = {}
    if targets is not None:
        used = zip(targets.point_ids, targets.used, strict=True)
        names = {("point", key): target.point.name for key, target in used}
    found = []
    for k, factor in enumerate(known.factors):
        redundancy = float(out["factor_redundancy"][k])
        if not np.isfinite(redundancy):
            continue
        target = names.get(factor.keys[0]) if len(factor.keys) == 1 else None
        found.append(
            PriorReliability(
                name=factor.name if target is None else target,
                kind=factor.kind if target is None else CONTROL_POINT,
                num_residuals=int(out["factor_measurements"][k]),
                redundancy=redundancy,
                least_redundancy=float(out["factor_least"][k]),
                test=float(out["factor_test"][k]),
                degrees=int(out["factor_rank"][k]),
            )
        )
    return tuple(sorted(found, key=lambda one: one.least_redundancy))


def _worst(
    start: Problem, rows: _Rows, found: Iterable[tuple[int, int, float, int, float]]
) -> tuple[WeakObservation, ...]:
    return tuple(
        WeakObservation(
            observation=k,
            image_id=int(start.image_ids[start.observation_image[k]]),
            point_id=int(start.point_ids[start.observation_point[k]]),
            least_redundancy=float(rows.least[k]),
            minimal_detectable_error=float(rows.detectable[k]),
            external_bound=float(rows.bound[k]),
            moved_point_id=None if point < 0 else int(start.point_ids[point]),
            moved_point_sigmas=rows.delta0 * of_point,
            moved_image_id=None if image < 0 else int(start.image_ids[image]),
            moved_image_sigmas=rows.delta0 * of_image,
        )
        for k, point, of_point, image, of_image in found
    )


def _findings(
    images: Iterable[ImageReliability], priors: Iterable[PriorReliability]
) -> Iterable[Finding]:
    """Yield the images and the control points that nothing checks, with what to add."""
    weak = [image for image in images if image.share < WEAK]
    if weak:
        open_ones = [image for image in weak if image.share < NOT_CHECKABLE]
        names = named("image", [image.words for image in weak])
        yield Finding(
            kind="unchecked_images",
            sentence=f"Nothing checks most errors in {names}: {len(open_ones):,} with redundancy "
            f"below {NOT_CHECKABLE:.0%}, the others below {WEAK:.0%}. Add observations of points "
            "that at least two other images see (four points give one check each).",
            evidence={
                "image_ids": [image.image_id for image in weak],
                "redundancy": [image.share for image in weak],
            },
        )
    controls = [one for one in priors if one.kind == CONTROL_POINT]
    alone = [one for one in controls if one.least_redundancy < NOT_CHECKABLE]
    if alone:
        names = named("control point", [one.name for one in alone])
        yield Finding(
            kind="unchecked_control_points",
            sentence=f"An error in the survey of {names} would not be noticed: "
            f"{plural(len(controls), 'control point')} do not check it. Add a control point near "
            "each, or measure them in more images.",
            evidence={
                "control_points": [one.name for one in alone],
                "least_redundancy": [one.least_redundancy for one in alone],
            },
        )
