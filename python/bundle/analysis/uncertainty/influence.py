"""Influence of the measurements on a quantity: derivatives w.r.t. pixels, and values without some.

With the gradient g of a quantity q, one adjoint solve a = C g gives all derivatives dq/dz = (J a)_i
sqrt(rho') / sigma by the measured pixels. The squares of (J~ a)_i sum up to the variance of q, so
that they are shares of it. Without an observation, or without a point, q changes by the rank
formula of ``core/covariance/influence.h``; without an image, by one step of Gauss-Newton of the
smaller problem, which is the same to first order and takes a factorisation each. Changes of one
sigma are predicted to a few percent of it. The weights of a loss stay as they are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_by_input import (
    at_control_points,
    length_unit,
    refuse_huge,
    request_at,
)
from bundle.analysis.uncertainty.quantity import Quantity, lacking, quantity_of
from bundle.analysis.uncertainty.reliability import notes_of
from bundle.base.arrays import FrozenArrays, freeze
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number
from bundle.errors import InputError
from bundle.interface.analysis_options import GAUGE, WITHOUT
from bundle.interface.option_class import takes_options
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.interface.tabular import Tabular
from bundle.io.files import Source
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.model.problem import Problem
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

MOST = 20
"""Number of listed measurements."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """Value of the quantity without some measurements."""

    what: str  # the measurements, such as "image a.jpg" or "image a.jpg, point 12"
    share: float  # their share of the variance
    value: float  # value without them
    sigmas: float  # change in sigmas


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Influence(FrozenArrays, Displayed, Tabular):
    """A quantity, its sigma, and what each measurement contributes.

    Arrays have a row per observation, image or point of the problem. NaN: a measurement that does
    not count or has no value.

    Attributes:
        on: the quantity.
        unit: "" for the unit of the model, "m", "m^3", "px", "degrees" or that of a ratio, "1".
        value: its value.
        sigma: its standard deviation, for residuals of the assumed sigmas.
        sigma0: root of the weighted squares over the degrees of freedom; NaN without any.
        by_observation: (n, 2) derivative with respect to the measured pixel [unit per px].
        share: (n,) share of the observation in the variance.
        share_of_factors: share of priors and other factors in the variance.
        without_image: (num_images,) value without an image; NaN unless requested.
        hangs_on: number of observations that make half of their part of the variance.
        num_observations: number of observations that count.
        without: "observations", "points" or "images", the kind of ``changes``.
        changes: the 20 largest changes by leaving out one of these.
        notes: sentences with remarks.
    """

    on: str
    unit: str
    value: float
    sigma: float
    sigma0: float
    by_observation: NDArray[np.float64]
    share: NDArray[np.float64]
    share_of_factors: float
    without_image: NDArray[np.float64]
    hangs_on: int
    num_observations: int
    without: str
    changes: tuple[Change, ...]
    notes: tuple[str, ...]
    _without: Callable[[str], NDArray[np.float64]]  # by the kind of what is left out

    @cached_property
    def without_observation(self) -> NDArray[np.float64]:
        """(n,) value without an observation, computed at the first access."""
        return self._without("observations")

    @cached_property
    def without_point(self) -> NDArray[np.float64]:
        """(num_points,) value without a point, likewise; NaN of points in the quantity."""
        return self._without("points")

    def __getstate__(self) -> dict[str, Any]:
        self.without_observation, self.without_point  # noqa: B018
        return vars(self) | {"_without": None}

    @property
    def entries(self) -> dict[str, Any]:
        """Fields other than arrays, for JSON."""
        names = [field.name for field in dataclasses.fields(self) if field.name != "_without"]
        values = {name: getattr(self, name) for name in names}
        return {name: one for name, one in values.items() if not isinstance(one, np.ndarray)}

    @property
    def sentences(self) -> tuple[str, ...]:
        """The answer in at most four sentences."""
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        said = [
            f"{self.on}: {number(self.value)}{unit}, sigma {number(self.sigma)}{unit}.",
            f"{self._most} from {self.hangs_on:,} of {self.num_observations:,} observations.",
        ]
        if self.changes:
            most = self.changes[0]
            said.append(
                f"Without {most.what} it is {number(most.value)}{unit} ({most.sigmas:+.2g} sigmas)."
            )
        return tuple(said)

    @property
    def _most(self) -> str:
        percent = 100 * self.share_of_factors
        if percent < 1:
            return "Half of its variance comes"
        return f"{percent:.0f} % of its variance comes from priors, half of the rest"

    def _display(self) -> Display:
        rows = tuple(
            (one.what, f"{100 * one.share:.1f} %", number(one.value), f"{one.sigmas:+.2g}")
            for one in self.changes
        )
        return Display(
            title=f"Influence: {self.sentences[0]}",
            facts=tuple(("", sentence) for sentence in self.sentences[1:]),
            head=("without", "share of variance", "value", "sigmas"),
            rows=rows,
        )


@takes_options(SolveOptions)
def influence(
    problem: Source | Result,
    on: str,
    options: SolveOptions | None = None,
    *,
    without: str = WITHOUT[0],
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    **changes: Any,
) -> Influence:
    """Find the measurements that determine a quantity of a solution.

    The derivatives are those of Gauss-Newton at the problem's values, which should be a minimum of
    a solve with the same options. They do not depend on the gauge.

    Args:
        problem: problem, its path, or a pycolmap.Reconstruction. For a :class:`Result`, its refined
            problem and its options are used.
        on: ``distance A B``, ``height A B`` (z of B minus z of A), ``angle A B C`` (at B, degrees),
            ``volume A B C D``, ``baseline I J`` or a camera's parameter, such as ``f 1``. A point
            is an id, the name of a control point, or ``image:NAME`` for a projection centre; an
            image of a baseline an id or a name. Two quantities with `` / `` between them are a
            ratio, which needs no datum.
        options: refined and constant parameters, and the loss, as in :func:`bundle.solve`; the
            gauge has no effect.
        without: what ``changes`` leave out: "observations", "points" or "images"; the last takes a
            factorisation for each image.
        factors: factors in addition to the observations, as in :func:`bundle.solve`.
        priors: measured positions and control points, likewise.
        align: likewise.
        bounds: bounds of camera parameters; a parameter at an active bound is constant.
        constraints: rules, as in :func:`bundle.solve`.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: the quantity is unknown, undetermined, constant or without a datum; or as
            :func:`bundle.covariance`.
        OSError: the path cannot be read.

    Example:
        >>> found = bundle.influence("sparse/0", "distance 12 87 / baseline 1 8")
        >>> found.sigma, found.hangs_on
    """
    without = choice("without", without, WITHOUT)
    request = request_at(
        problem, options, changes, "influence", factors=factors, priors=priors, align=align,
        bounds=bounds, constraints=constraints,
    )  # fmt: skip
    return _influence(*differentiate(request, on, without), without)


def differentiate(
    request: SolveRequest, on: str, without: str = ""
) -> tuple[Prepared, Quantity, dict[str, Any]]:
    """Return a prepared request, a quantity and the output of the core about it.

    ``without``: "observations" or "points", of which the output then has the deletions.
    """
    prepared = at_control_points(prepare(request))
    if not prepared.request.problem.num_observations:
        raise InputError("problem: expected observations, found 0")
    refuse_huge(prepared.start)
    quantity = quantity_of(on, prepared.start, names_of_markers(prepared))
    if not quantity.unit and length_unit(prepared):
        quantity = dataclasses.replace(quantity, unit="m^3" if "volume" in on else "m")
    out = _core_influence(prepared, quantity, without)
    start = prepared.start
    if out["gauge_share"] > GAUGE:
        raise InputError(
            f"on: expected a quantity that the measurements determine, found {quantity.text}, "
            f"which changes with the {lacking(quantity, start)} of the world; nothing fixes it: "
            "give control points, positions or fixed images, or a ratio to a baseline"
        )
    for row in np.flatnonzero(quantity.points.any(axis=1)):
        if row in out["null_points"]:
            raise InputError(
                f"on: expected points with parallax, point {start.point_ids[row]} has 0"
            )
    if not out["variance"] > 0:
        raise InputError(f"on: expected a quantity that varies, found {quantity.text}, a constant")
    return prepared, quantity, out


def names_of_markers(prepared: Prepared) -> dict[str, int]:
    """Return the point ids of the control points by name."""
    targets = prepared.placed.targets
    if targets is None:
        return {}
    pairs = zip(targets.used, targets.point_ids, strict=True)
    return {target.point.name: key for target, key in pairs}


def with_observations(start: Problem, keep: NDArray[np.bool_]) -> Problem:
    """Return the problem with some of its observations, and all else as it is."""
    names = ("image", "point", "xy", "keypoint", "sigma")
    arrays = {f"observation_{name}": getattr(start, f"observation_{name}") for name in names}
    return start.replace(**{name: one[keep] for name, one in arrays.items() if one is not None})


def _core_influence(
    prepared: Prepared, quantity: Quantity, without: str = "", keep: Any = None
) -> dict[str, Any]:
    """Return the output of the core, with some of the observations."""
    layout = prepared.layout
    start = prepared.start if keep is None else with_observations(prepared.start, keep)
    return _core.influence(
        start,
        layout.options.asdict(),
        layout.limits,
        layout.core_factors(),
        without,
        quantity.images,
        quantity.cameras,
        quantity.points,
    )


def _influence(
    prepared: Prepared, quantity: Quantity, out: dict[str, Any], without: str
) -> Influence:
    start, given = prepared.start, prepared.request.problem
    dof = out["num_residuals"] - out["num_parameters"] + out["gauge_degrees"]
    sigma = float(np.sqrt(out["variance"]))
    spread = 1.0 if start.observation_sigma is None else start.observation_sigma
    weight = np.where(out["weights"] > 0, out["weights"], np.nan)
    share = np.einsum("ij,ij->i", out["along"], out["along"]) / out["variance"]
    share[~(out["weights"] > 0)] = np.nan
    by_pixel = out["along"] * (np.sqrt(weight) / spread)[:, None]
    value, n, first = quantity.value, given.num_observations, out["without"]

    @cache
    def values_without(kind: str) -> NDArray[np.float64]:
        change = first if kind == without else _core_influence(prepared, quantity, kind)["without"]
        return freeze(value + change[: n if kind == "observations" else given.num_points])

    is_by_image = without == "images"
    of_images = _without_images(prepared, quantity, out if is_by_image else {})
    counted = share[np.isfinite(share)]
    half = 0.5 * counted.sum()
    most = np.sort(counted[counted * len(counted) >= half])[::-1]  # the others are less than half
    hangs_on = int(np.searchsorted(np.cumsum(most), half) + 1)
    values = of_images if is_by_image else values_without(without)
    return Influence(
        on=quantity.text,
        unit=quantity.unit,
        value=value,
        sigma=sigma,
        sigma0=float(np.sqrt(out["weighted_squares"] / dof)) if dof > 0 else float("nan"),
        by_observation=freeze(by_pixel[:n]),
        share=freeze(share[:n]),
        share_of_factors=float(np.nansum(out["factor_share"]) / out["variance"]),
        without_image=of_images,
        hangs_on=min(hangs_on, len(counted)),
        num_observations=len(counted),
        without=without,
        changes=_changes(prepared, without, values, share, value, sigma),
        notes=notes_of(prepared, out),
        _without=values_without,
    )


def _without_images(
    prepared: Prepared, quantity: Quantity, whole: Mapping[str, Any]
) -> NDArray[np.float64]:
    """Return the value without each image that has observations; NaN if ``whole`` is empty."""
    start = prepared.start
    values = np.full(start.num_images, np.nan)
    used = np.flatnonzero(quantity.points.any(axis=1))
    for image in np.unique(start.observation_image) if whole else ():
        keep = start.observation_image != image
        if not keep.any() or quantity.images[image].any():
            continue
        try:
            out = _core_influence(prepared, quantity, keep=keep)
        except InputError:
            continue  # without the image, something is undetermined
        if np.isin(used, out["null_points"]).any() or out["gauge_share"] > GAUGE:
            continue
        values[image] = quantity.value + out["step"] - whole["step"]
    return freeze(values[: prepared.request.problem.num_images].copy())


def _changes(
    prepared: Prepared,
    without: str,
    values: NDArray[np.float64],
    share: NDArray[np.float64],
    value: float,
    sigma: float,
) -> tuple[Change, ...]:
    """Return the largest changes by one observation, point or image."""
    start, sizes = prepared.start, share
    if without != "observations":
        owner = start.observation_point if without == "points" else start.observation_image
        sizes = np.bincount(owner, np.nan_to_num(share), len(values)).astype(float)
    change = np.nan_to_num(np.abs(values - value), nan=-1)
    least = np.partition(change, -MOST)[-MOST] if len(change) > MOST else -1
    rows = np.flatnonzero(change >= least)
    rows = rows[np.argsort(-change[rows], kind="stable")][:MOST]

    def words(row: int) -> str:
        if without == "points":
            return f"point {start.point_ids[row]}"
        image = row if without == "images" else start.observation_image[row]
        name = f"image {start.image_names[image] or start.image_ids[image]}"
        if without == "images":
            return name
        return f"the observation of point {start.point_ids[start.observation_point[row]]} in {name}"

    return tuple(
        Change(
            what=words(int(row)),
            share=float(sizes[row]),
            value=float(values[row]),
            sigmas=float((values[row] - value) / sigma),
        )
        for row in rows
        if change[row] >= 0
    )
