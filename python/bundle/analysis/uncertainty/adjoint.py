"""Derivatives of an adjustment: how functions of the minimum change with the data.

At the minimum the gradient F(x, d) of the cost by the unknowns x vanishes for any data d. For a
function L(x, d) with the cotangent y = dL/dx, the implicit function theorem gives

    dL/dd = -F_d^T a + L_d,        H a = y,        H = F_x, the exact Hessian.

With r = prediction - measurement of an observation, its sigma s, its cost 1/2 w rho(|r|^2 / s^2) at
w = 1, and the rows r~ = sqrt(rho') r / s, v = sqrt(rho') (J a) / s, b = 2 rho'' / rho'^2, which
``core/covariance/adjoint.h`` computes,

    by the pixels      (sqrt(rho') / s) (v + b r~ (r~ . v)),
    by the weight w    -v . r~,
    by the sigma s     (2 / s) (1 + b |r~|^2 / 2) (v . r~).

A prior on numbers m with the information L L^T has r = L^T (m - mean). With u = v + b r~ (r~ . v),

    by the mean        sqrt(rho') L u,
    by a sigma s_k     (2 / s_k) (v_k r~_k + b / 2 r~_k^2 (v . r~)),    L diagonal.

A constant camera parameter k has the derivative dL/dk - d/de F_k(x + e a).

Solution of H a = y. J~^T J~ lacks r d2r and the second derivative of the loss: a few percent of H
without a loss, most of it with one, so that Gauss-Newton alone may have wrong signs. The core
factorises H itself, with the points eliminated, and one product H p shows the solution. What the
factor lacks, second derivatives of factors, rigs and ties, and factors that couple points, such as
scale bars, follows by conjugate gradients with it as preconditioner. The r d2r of a product is a
central difference of J~ along e p (``core/covariance/adjoint.h``). The residuals move by about
``REACH`` sigmas: even directions that are hardly determined, which bend over a hundredth of a
sigma, are then exact to 1e-7, and rounding is as small.

Gauge. H has the free motions N of the world as null space, y must not change along them. The part
of y that does is removed, y - E N N^T y (``core/covariance/free_gauge.h``), with a warning. The
products are projected, too: off its minimum H has no null space.

Polish. A solve stops some thousandths of a sigma off the minimum, which is an error of 1e-4 of the
derivatives. Newton steps with a factor continue until the next one has sqrt(F^T G F), with the
inverse G of the factor, below ``POLISHED`` sigmas. |F| has no meaning: its units differ.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_by_input import (
    at_control_points,
    refuse_huge,
    request_at,
)
from bundle.base.arrays import Array, FrozenArrays, as_declared, as_flag, freeze
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.errors import InputError
from bundle.georeference.scale_bars import FoundBars
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.io.files import Source
from bundle.model.estimates import with_estimates
from bundle.model.problem import Problem
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

_Floats = NDArray[np.float64]

REACH = 3e-6  # movement of the residuals, in sigmas, over which Jacobians are differenced

POLISHED, CONVERGED, NEWTON_STEPS = 1e-10, 1e-7, 20
"""Length of the next step, in sigmas, at which Newton steps end, and that counts as a minimum if
they end earlier; largest number of factors on the way."""

VERIFIED, TOLERANCE, PRODUCTS = 3e-7, 1e-8, 300
"""Relative residual up to which the factor's own solution is taken, as differences in products are
wrong by a third of it; that at which conjugate gradients stop; largest number of products."""

GAUGE_SHARE = 1e-6
"""Share of a cotangent along free motions of the world that is taken for rounding."""


class NotConvergedWarning(UserWarning):
    """The derivatives are NaN: there is no minimum, or no solution of the adjoint equations."""


class GaugeWarning(UserWarning):
    """A cotangent changes with the position, the rotation or the scale of a free world."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Derivatives(FrozenArrays, Displayed):
    """Derivatives of a function of the minimum with respect to the data of its problem.

    Observations that do not count have derivatives of 0. All are NaN without convergence.

    Attributes:
        pixels: (n, 2) by the measured pixels [1/px].
        weights: (n,) by a factor on the cost of each observation, at 1.
        sigmas: (n,) by the ``observation_sigma``, 1 px if the problem has none [1/px].
        held: (num_cameras, k) by the constant camera parameters; 0 for refined ones. NaN if a
            factor couples those of the camera: a function, or a prior with correlations or a loss.
        prior_means: by the mean of each factor of :attr:`Adjoint.factors`, in its shape; None for
            kinds whose residual is not mean minus value: poses, directions, functions.
        prior_sigmas: likewise by the standard deviations, (k,); None also if the information is not
            diagonal.
        gauge_share: share of the cotangent along free motions of the world, which was removed.
        num_products: products with the exact Hessian; 0 for Gauss-Newton.
        exact: False: with the matrix of Gauss-Newton instead of the Hessian.
        is_converged: False: no numbers.
    """

    pixels: _Floats
    weights: _Floats
    sigmas: _Floats
    held: _Floats
    prior_means: tuple[_Floats | None, ...]
    prior_sigmas: tuple[_Floats | None, ...]
    gauge_share: float
    num_products: int
    exact: bool
    is_converged: bool

    def _display(self) -> Display:
        kind = "exact" if self.exact else "of Gauss-Newton, without second derivatives"
        facts = [
            ("of", plural(len(self.weights), "observation")),
            ("products with the Hessian", str(self.num_products)),
        ]
        if self.gauge_share > GAUGE_SHARE:
            facts.append(("taken out along the gauge", f"{100 * self.gauge_share:.2g} %"))
        if not self.is_converged:
            facts.append(("converged", "no"))
        return Display(title=f"Derivatives, {kind}", facts=tuple(facts))


_LINEAR = ("vector", "along", "factor_along", "by_params")
"""Rows of a product that are linear in its vector."""


class _System:
    """Core, gauge and factor at one problem; vectors are those of ``core/covariance/adjoint.h``."""

    def __init__(self, prepared: Prepared, exact: bool) -> None:
        start, layout = prepared.start, prepared.layout
        self.factors: tuple[Factor, ...] = () if layout.known is None else layout.known.factors
        apart = [_is_apart(factor) for factor in self.factors]
        core = layout.core_factors()
        eliminated = core
        if not all(apart):
            from bundle.graphs.factors.problem_factors import ProblemFactors  # slow to import

            kept = list(filter(_is_apart, self.factors))
            eliminated = ProblemFactors(start, kept).core() if kept else None
        options = layout.options.asdict()
        self.core = _core.Adjoint(start, options, layout.limits, core, eliminated, exact)
        self.directions, self.sums = self.core.directions()  # N and E N, (d, size)
        if len(self.directions) and not all(apart):
            self._keep_free(apart)
        self.size = self.directions.shape[1]

    def _keep_free(self, apart: list[bool]) -> None:
        """Leave out the motions that the factors outside the preconditioner determine."""
        random = np.random.default_rng(0).standard_normal(self.directions.shape[1])
        columns = []
        for vector in (*self.directions, random / np.linalg.norm(random)):
            rows = self.core.product(vector, REACH)
            begin = rows["factor_begin"]
            ends = zip(apart, begin, begin[1:], strict=False)
            outside = [rows["factor_along"][a:b] for is_apart, a, b in ends if not is_apart]
            columns.append(np.concatenate(outside))
        moved = np.stack(columns[:-1], axis=1)
        _, values, basis = np.linalg.svd(moved)
        rank = int((values > 1e-9 * np.linalg.norm(columns[-1])).sum())
        self.directions, self.sums = basis[rank:] @ self.directions, basis[rank:] @ self.sums

    def projected(self, y: _Floats) -> _Floats:
        """Return the part of a gradient that no free motion changes."""
        found: _Floats = y - (self.directions @ y) @ self.sums
        return found

    def preconditioned(self, y: _Floats) -> _Floats:
        """Return P G y, for a projected y."""
        a = self.core.solve(y)
        found: _Floats = a - (self.sums @ a) @ self.directions
        return found

    def rows_along(self, a: _Floats, length: float) -> dict[str, Any]:
        """Return a as ``vector``, H a, and the rows along a; ``length``: about |J~ a|."""
        return {"vector": a, **self.core.product(a, REACH / length)}

    def rows_of(self, value: float) -> dict[str, Any]:
        """Return the rows along a vector of which all derivatives are 0 or NaN."""
        rows = self.rows_along(np.zeros(self.size), 1.0)
        return {**rows, **{name: np.full_like(rows[name], value) for name in _LINEAR}}

    def solve(self, y: _Floats) -> tuple[dict[str, Any] | None, int]:
        """Return the rows along a with H a = y, y projected, and the number of products.

        None: a direction without curvature, or no convergence.
        """
        rest, p, found = y, self.preconditioned(y), None
        square = first = float(y @ p)
        length = float(np.sqrt(first))
        if length == 0:
            return self.rows_of(0.0), 0
        for count in range(1, PRODUCTS + 1):
            rows = self.rows_along(p, length)
            along = self.projected(rows["product"])
            curvature = float(p @ along)
            if not curvature > 0:
                return None, count
            if found is None:
                share, limit, found = 1.0, VERIFIED, rows
            else:
                share, limit = square / curvature, TOLERANCE
                for name in _LINEAR:
                    found[name] = found[name] + share * rows[name]
            rest = rest - share * along
            z = self.preconditioned(rest)
            last, square = square, float(rest @ z)
            if not square > limit**2 * first:
                return (found if np.isfinite(square) else None), count
            ratio = 0.0 if found is rows else square / last
            p, length = z + ratio * p, float(np.hypot(np.sqrt(square), ratio * length))
        return None, PRODUCTS

    def is_minimum(self) -> bool:
        """Return whether the Hessian is positive definite, by a random vector if not factorised."""
        random = np.random.default_rng(0).standard_normal((self.size,))
        return self.core.is_exact or self.solve(self.projected(random))[0] is not None

    def gradient(self, step: _Floats) -> tuple[_Floats, float]:
        """Return the projected gradient at a displacement, and the length of the next step."""
        gradient = self.projected(self.core.gradient(step))
        square = float(gradient @ self.preconditioned(gradient))
        return gradient, float(np.sqrt(max(square, 0.0)))


def _kinds(factor: Factor) -> list[str]:
    """Return the kinds of a factor's variables, of a problem: "image", "point" and so on."""
    keys: Any = factor.keys
    return [kind for kind, _ in keys]


def _is_apart(factor: Factor) -> bool:
    """True for a factor that the reduced system has: of cameras only, or of one point."""
    has_point = "point" in _kinds(factor)
    return factor.kind != "function" and not (has_point and len(factor.keys) > 1)


def _couples_parameters(factor: Factor) -> bool:
    """True for a factor whose derivative w.r.t. a camera's parameter may depend on another."""
    if factor.kind == "scalar_prior" or "camera" not in _kinds(factor):
        return False
    mean = _mean_of(factor)
    return factor.loss != "trivial" or mean is None or not mean.by_sigma


@takes_options(SolveOptions)
def adjoint(
    problem: Source | Result,
    options: SolveOptions | None = None,
    *,
    exact: bool = True,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    **changes: Any,
) -> Adjoint:
    """Prepare the derivatives of a minimum w.r.t. pixels, sigmas, priors and constant intrinsics.

    The problem is polished by Newton steps, and its Hessian factorised. Each :meth:`Adjoint.vjp`
    takes about three steps of a solve; with free rigs, ties, bars or robust priors, up to ten.

    Args:
        problem: problem, its path, or a pycolmap.Reconstruction, at a minimum. For a
            :class:`Result`, its refined problem, options, factors and priors are used.
        options: refined and constant parameters, and the loss, as in :func:`bundle.solve`; the
            gauge has no effect.
        exact: True for the exact Hessian. False: the matrix of Gauss-Newton, for comparisons; its
            derivatives are wrong by percents, with a loss by multiples.
        factors: factors in addition to the observations, as in :func:`bundle.solve`.
        priors: measured positions and control points, likewise; the problem is in their world.
        bounds: bounds of camera parameters; a parameter at an active bound is constant.
        constraints: rules, as in :func:`bundle.solve`.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: rows of a rolling shutter are those of the measured pixels; ``exact`` is False,
            but a factor is not in the Gauss-Newton matrix; or as :func:`bundle.covariance`.
        OSError: the path cannot be read.

    Example:
        >>> adjoint = bundle.adjoint(bundle.solve("sparse/0"))
        >>> by_point = np.zeros_like(adjoint.problem.points)
        >>> by_point[12] = (0, 0, 1)
        >>> adjoint.vjp(points=by_point).pixels
    """
    exact = as_flag("exact", exact)
    if isinstance(problem, Result) and not factors and not priors:
        factors, priors = problem.factors, problem.priors
    request = request_at(
        problem, options, changes, "adjoint", factors=factors, priors=priors, align=False,
        bounds=bounds, constraints=constraints,
    )  # fmt: skip
    given = request.problem
    if not given.num_observations:
        raise InputError("problem: expected observations, found 0")
    refuse_huge(given)
    shutter = given.rolling_shutter
    if shutter is not None and shutter.row_time == "observed":
        raise InputError(
            "problem: expected rolling shutters with row_time fixed-point, found observed, with "
            "which the residuals are not prediction minus pixel"
        )
    return Adjoint(at_control_points(prepare(request)), exact)


class Adjoint(Displayed):
    """Minimum of a problem, with the factor that its derivatives need; see :func:`adjoint`.

    Attributes:
        problem: the problem at its minimum, polished by Newton steps.
        factors: factors of the cost in addition to the observations: those given, then those of
            priors and rules. Derivatives w.r.t. prior means and sigmas are in this order.
        exact: True for the exact Hessian.
        next_step: length of the next step, in sigmas of the unknowns.
        is_converged: True if that step is negligible; otherwise, all derivatives are NaN.
    """

    def __init__(self, prepared: Prepared, exact: bool) -> None:
        self.exact = exact
        self._prepared = prepared
        self._system = _System(prepared, True)
        self.factors = self._system.factors
        if not exact and not all(map(_is_apart, self.factors)):
            raise InputError(
                "exact: expected True with functions and factors that couple a point with others, "
                "such as scale bars, found False"
            )
        self.next_step = self._polish()
        self.is_converged = self.next_step <= CONVERGED and self._system.is_minimum()
        if not exact:
            self._system = _System(self._prepared, False)
        self.problem: Problem = self._prepared.placed.taken_from(self._prepared.start)

    def _polish(self) -> float:
        """Move the problem to its minimum, and factorise there; return the next step."""
        for _ in range(NEWTON_STEPS):
            system, moved = self._system, np.zeros(self._system.size)
            gradient, length = system.gradient(moved)
            before, is_fast = length, True
            while is_fast and length > POLISHED:
                rows = system.solve(gradient)[0]
                newton = system.preconditioned(gradient) if rows is None else rows["vector"]
                for share in (1, 1 / 4, 1 / 16, 1 / 64):
                    ahead, next_length = system.gradient(moved - share * newton)
                    if next_length < length:
                        break
                else:
                    break
                is_fast = next_length < length / 2
                moved, gradient, length = moved - share * newton, ahead, next_length
            if not moved.any() or length > max(CONVERGED, before / 2):
                break
            arrays = system.core.moved(moved)
            self._prepared = self._prepared.at(with_estimates(self._prepared.start, arrays))
            self._system = _System(self._prepared, True)
            if length <= CONVERGED:
                return min(length, self._system.gradient(np.zeros(system.size))[1])
        return length

    def vjp(
        self,
        points: ArrayLike | None = None,
        poses: ArrayLike | None = None,
        cameras: ArrayLike | None = None,
    ) -> Derivatives:
        """Return the derivatives of a function w.r.t. the data, from those w.r.t. the minimum.

        Args:
            points: (num_points, 3) derivatives w.r.t. the coordinates; None: zeros.
            poses: (num_images, 6) derivatives w.r.t. (w, t): R moves to Exp(w) R, then t is added
                to the translation.
            cameras: (num_cameras, k) derivatives w.r.t. the parameters, as ``camera_params``.

        Raises:
            InputError: an array has another shape, or numbers that are not finite.

        Warns:
            GaugeWarning: the function changes with motions of the world that nothing determines.
                The share of its derivatives along them was removed.
            NotConvergedWarning: all derivatives are NaN.
        """
        problem, system = self.problem, self._system
        given = {
            "points": (points, problem.points.shape),
            "poses": (poses, (problem.num_images, 6)),
            "cameras": (cameras, problem.camera_params.shape),
        }
        parts = {
            name: np.zeros(shape)
            if value is None
            else as_declared(name, value, Array(shape, "finite"))
            for name, (value, shape) in given.items()
        }
        start = self._prepared.start  # control points and offsets follow the problem's own rows
        images = np.zeros((start.num_images, 6))
        images[: problem.num_images] = parts["poses"]
        of_points = np.zeros((start.num_points, 3))
        of_points[: problem.num_points] = parts["points"]
        y = system.core.gather(images, parts["cameras"], of_points)
        rest = system.projected(y)
        size = float(np.linalg.norm(y))
        share = float(np.linalg.norm(y - rest)) / size if size > 0 else 0.0
        if share > GAUGE_SHARE:
            warnings.warn(
                f"{100 * share:.2g} % of the derivatives is along free motions of the world, and "
                "was removed: the function depends on position, rotation or scale. Take ratios "
                "of distances, or fix the world by control points.",
                GaugeWarning,
                stacklevel=2,
            )
        rows, count = None, 0
        failure = "No minimum: the Hessian is not positive definite."
        if self.next_step > CONVERGED:
            failure = (
                f"The next step has {number(self.next_step)} sigmas: use smaller tolerances, or "
                "fix what bundle diagnose finds hardly determined."
            )
        elif self.is_converged and self.exact:
            rows, count = system.solve(rest)
            failure = f"No solution of the adjoint equations after {plural(count, 'product')}."
        elif self.is_converged:
            a = system.preconditioned(rest)
            length = float(np.sqrt(rest @ a))
            rows = system.rows_along(a, length) if length > 0 else system.rows_of(0.0)
        is_converged = rows is not None
        if rows is None:
            text = f"{failure} All derivatives are NaN."
            warnings.warn(text, NotConvergedWarning, stacklevel=2)
            rows = system.rows_of(np.nan)
        return Derivatives(
            **self._derivatives(rows, parts["cameras"]),
            gauge_share=share,
            num_products=count,
            exact=self.exact,
            is_converged=is_converged,
        )

    def _derivatives(self, rows: Mapping[str, Any], of_cameras: _Floats) -> dict[str, Any]:
        system, start, n = self._system, self._prepared.start, self.problem.num_observations
        along, r, bend = rows["along"], rows["residuals"], rows["bends"]
        product = along[:, 0] * r[:, 0] + along[:, 1] * r[:, 1]
        spread = 1.0 if start.observation_sigma is None else start.observation_sigma
        sigmas = 2 / spread * product
        if bend.any():  # not without a loss
            sigmas *= 1 + 0.5 * bend * (r[:, 0] ** 2 + r[:, 1] ** 2)
            along = along + (bend * product)[:, None] * r
        is_held, slope = system.core.held.astype(bool), rows["by_params"]
        held = np.where(is_held, of_cameras, slope) - slope  # NaN with it
        for factor in filter(_couples_parameters, self.factors):
            keys: Any = factor.keys
            cameras = [key for kind, key in keys if kind == "camera"]
            held[np.isin(start.camera_ids, cameras)[:, None] & is_held] = np.nan
        begin = rows["factor_begin"]
        priors = [
            _of_prior(
                factor,
                rows["factor_along"][begin[k] : begin[k + 1]],
                rows["factor_residuals"][begin[k] : begin[k + 1]],
                rows["factor_weights"][k],
                rows["factor_bends"][k],
            )
            for k, factor in enumerate(self.factors)
        ]
        return {
            "pixels": freeze((np.sqrt(rows["weights"]) / spread)[:n, None] * along[:n]),
            "weights": freeze(-product[:n]),
            "sigmas": freeze(sigmas[:n].copy()),
            "held": freeze(held),
            "prior_means": tuple(mean for mean, _ in priors),
            "prior_sigmas": tuple(sigma for _, sigma in priors),
        }

    def _display(self) -> Display:
        facts = (
            ("next step", f"{number(self.next_step)} sigmas"),
            ("Hessian", "exact" if self.exact else "of Gauss-Newton"),
        )
        return Display(title="Adjoint", facts=facts)


class _Mean(NamedTuple):
    """A prior with r = L^T (numbers - mean)."""

    shape: tuple[int, ...]
    root: _Floats  # L
    by_mean: float  # derivative of the mean of r w.r.t. the given one
    by_sigma: bool  # True if sigmas were given, not an information with correlations


def _mean_of(factor: Factor) -> _Mean | None:
    """Return the mean of a factor; None for residuals that are not its difference to numbers."""
    given: Any = factor
    if factor.kind == "scalar_prior":
        scale = 1 / given.value if given.relative else 1.0
        return _Mean((), np.array([[1 / given.sigma]]), scale, True)
    if factor.kind == "function":
        if not FoundBars.owns(factor):
            return None
        return _Mean((), np.array([[1 / given.function.bar.sigma]]), 1.0, True)
    if factor.kind == "prior":
        mean = given.value
        if _kinds(factor)[0] not in ("point", "camera", "readout", "twist"):
            return None  # the residual is a logarithm
    elif factor.kind == "position":
        mean = given.position
    else:
        return None
    size = len(mean)
    information = np.asarray(given.information)
    if information.ndim < 2:
        information = np.eye(size) * information
    is_diagonal = not (information - np.diag(np.diag(information))).any()
    return _Mean((size,), np.linalg.cholesky(information), 1.0, is_diagonal)


def _of_prior(
    factor: Factor, along: _Floats, r: _Floats, weight: float, bend: float
) -> tuple[_Floats | None, _Floats | None]:
    """Return the derivatives w.r.t. the mean and the sigmas of a factor, None where unknown.

    ``r`` and ``along`` are weighted by sqrt(rho').
    """
    mean = _mean_of(factor)
    if mean is None:
        return None, None
    product = float(along @ r)
    by_mean = mean.root @ (along + bend * product * r) * (np.sqrt(weight) * mean.by_mean)
    by_sigma = None
    if mean.by_sigma:
        by_sigma = 2 * np.diag(mean.root) * (along * r + 0.5 * bend * product * r**2)
    return freeze(by_mean.reshape(mean.shape)), None if by_sigma is None else freeze(by_sigma)
