"""Test of surveyed points after an adjustment, and the estimated offset of positions.

v is the whitened residual L^-1 (X - X0) of the prior of a control point, w the weight of its loss,
and P = L^-1 Cov(X) L^-T the whitened covariance of the adjusted point. All other measurements
predict the point with the residual and its covariance

    d = (I - w P)^-1 v,    C = I + P (I - w P)^-1,    T = d^T C^-1 d = v^T Q^+ v for w = 1,

with Q = I - P, the cofactor of the residual: leave-one-out without another solve (Belsley, Kuh and
Welsch 1980). T has a chi-squared distribution with as many degrees of freedom m as the survey has
coordinates; if the scale of all sigmas is estimated with nu degrees of freedom,

    T (nu - m) / (m (nu - T)) has F(m, nu - m).

The mean of the eigenvalues of I - w P is the redundancy of the point: the share of an error that
its residual shows. Below 0.1 the other measurements do not check the point.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.tails import chi2_tail, f_tail
from bundle.errors import InputError
from bundle.georeference.vector_priors import UNKNOWN
from bundle.graphs.factors.factors import Factor, PositionFactor
from bundle.graphs.factors.image_factors import RotationFactor
from bundle.interface.georeference_options import OFFSET_AXES
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.georeference.control_point import ScaleBar


Array = NDArray[np.float64]
Triple = tuple[float, float, float]

LEAST_REDUNDANCY = 0.1
SMALLEST = 1e-9  # eigenvalue of Q, relative to 1, below which a direction is not checked at all


@dataclass(frozen=True)
class OffsetCheck:
    """Offset of measured positions from the control points.

    Attributes:
        axes: "up" or "all".
        value: (3,) positions minus model, east, north, up [m].
        sigma: (3,) its standard deviations; 0 along axes without an offset.
        statistic: T.
        p: probability of an offset as significant as this one if there is none.
        is_estimated: True if the solve estimated it; False if its model has none.
        focal_lengths: first focal length of the solve, the same with the offset, and its standard
            deviation [px].
    """

    axes: str
    value: Triple
    sigma: Triple
    statistic: float
    p: float
    is_estimated: bool
    focal_lengths: Triple

    LEVEL: ClassVar[float] = 1e-3
    """Probability below which an offset is significant."""

    @property
    def is_significant(self) -> bool:
        """True if an offset is more probable than none."""
        return self.p < self.LEVEL

    def may_explain(self, statistic: float) -> bool:
        """Return True if T is significant by the stated sigmas, and exceeds that of a point."""
        by_sigmas = chi2_tail(self.statistic, 3 if self.axes == "all" else 1)
        return by_sigmas < self.LEVEL and self.statistic > statistic

    @property
    def sentence(self) -> str:
        """The offset with its sigma, such as "Positions lie 45.04 m (+- 0.25) above ..."."""
        east, north, up = self.value
        words = [_along(up, self.sigma[2], "above", "below")]
        if self.axes == "all":
            words = [
                _along(east, self.sigma[0], "east of", "west of"),
                _along(north, self.sigma[1], "north of", "south of"),
                *words,
            ]
        return f"Positions lie {', '.join(words)} the control points"

    @property
    def bends_focal_length(self) -> bool:
        """True if the focal lengths with and without the offset differ significantly."""
        without, with_it, sigma = self.focal_lengths
        return abs(without - with_it) > max(sigma, 1e-3 * abs(with_it)) and sigma > 0

    def asdict(self) -> dict[str, object]:
        """Return the entry of ``georeference.json``."""
        return {
            "value": list(self.value),
            "sigma": list(self.sigma),
            "p": self.p,
            "axes": self.axes,
            "is_estimated": self.is_estimated,
        }


@dataclass(frozen=True)
class PointCheck:
    """Test of a surveyed point against all other measurements.

    Attributes:
        residual: (3,) prediction by all else minus survey, east, north, up [m]; nan if unknown.
        statistic: T.
        freedom: its degrees of freedom.
        redundancy: mean redundancy of its coordinates.
        is_suspect: True if a gross error is likely.
    """

    residual: Triple
    statistic: float
    freedom: int
    redundancy: float
    is_suspect: bool = False

    @property
    def is_checked(self) -> bool:
        """True if other measurements check the point."""
        return self.redundancy >= LEAST_REDUNDANCY

    @staticmethod
    def of(residual: Array, sigma: Array, covariance: Array, weight: float) -> PointCheck:
        """Test a point.

        Args:
            residual: (3,) adjusted minus surveyed position.
            sigma: (3,) standard deviations of the survey; infinite or nan: not surveyed.
            covariance: (3, 3) covariance of the adjusted point.
            weight: weight of the prior in the adjustment; 0: a check point.
        """
        axes = np.isfinite(residual) & np.isfinite(sigma)
        known, scale = residual[axes], sigma[axes]
        v = known / scale
        p = covariance[np.ix_(axes, axes)] / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(0.5 * (p + p.T))
        left = 1 - weight * values
        seen = left > SMALLEST
        # Along the eigenvectors of P all matrices are diagonal.
        d = np.zeros(len(values))
        d[seen] = (vectors.T @ v)[seen] / left[seen]
        c = 1 + np.maximum(values, 0) / np.where(seen, left, np.inf)
        full = np.full(3, np.nan)
        full[axes] = scale * (vectors @ d)
        east, north, up = full.tolist()
        return PointCheck(
            residual=(east, north, up),
            statistic=float((d**2 / c).sum()),
            freedom=len(known),
            redundancy=float(np.clip(left, 0, 1).mean()) if len(known) else 0.0,
        )


@dataclass(frozen=True)
class BarCheck:
    """Test of a bar at a minimum.

    Attributes:
        bar: the bar.
        length: length in the model.
        w: length minus distance over its standard deviation; NaN: nothing checks it.
        redundancy: share of an error of the bar that its residual shows; NaN: unknown.
        is_suspect: True if the bar is probably wrong.
    """

    bar: ScaleBar
    length: float
    w: float
    redundancy: float
    is_suspect: bool

    @property
    def residual(self) -> float:
        """Length in the model minus the known length."""
        return self.length - self.bar.distance


@dataclass(frozen=True)
class SurveyChecks:
    """Tests of measured positions and control points after a solve.

    Attributes:
        offset: offset of the positions from the control points; None: nothing determines it.
        points: the test of each control and check point in use, by name.
        bars: the test of each scale bar, in order.
    """

    offset: OffsetCheck | None
    points: Mapping[str, PointCheck]
    bars: tuple[BarCheck, ...] = ()


def scaled_tail(statistic: float, freedom: int, scale2: float, nu: float) -> float:
    """Return the probability of a larger T if sigmas are right up to a common factor.

    Args:
        statistic: T by the stated sigmas.
        freedom: its degrees of freedom.
        scale2: squared factor on the sigmas; at most 1: the sigmas are right.
        nu: degrees of freedom of its estimate.
    """
    if scale2 <= 1:
        return f_tail(statistic / freedom, freedom, math.inf)
    t = statistic / scale2
    if nu <= freedom or t >= nu:
        return 0.0 if t >= nu > freedom else 1.0
    return f_tail(t * (nu - freedom) / (freedom * (nu - t)), freedom, nu - freedom)


def _along(value: float, sigma: float, plus: str, minus: str) -> str:
    digits = max(0, 1 - math.floor(math.log10(sigma))) if 0 < sigma < math.inf else 3
    return f"{abs(value):.{digits}f} m (+- {sigma:.2g}) {plus if value > 0 else minus}"


# Unknown offset that measured positions have in common, as a variable of a solve.
#
# Heights of GPS are above the ellipsoid, those of control points often above the sea: they differ
# by the same amount everywhere in a block. With the offset o, the antenna at c_i + R_i^T a and the
# measured position p_i,
#
#     r_i = L_i^-1 (c_i + R_i^T a + A o - p_i),    A = diag(0, 0, 1) for "up", I for "all".
#
# o is an unknown like all others: it is the translation of a pose without observations, the last
# image of the solve. The rotation of this pose, and the coordinates that A leaves out, have no
# influence; priors at their start keep them there and cost nothing. Control points, which have no
# offset, determine o.


LARGEST_ID = 2**63 - 1

HELD = 1e16  # information of the rotation: its uncertainty must not show in that of the offset

_IDENTITY = (0.0, 0.0, 0.0, 1.0)
_OF_IMAGES = ("cam_from_world", "image_ids", "image_camera", "image_frame", "image_sensor")


@dataclass(frozen=True)
class PositionOffset:
    """Offset of the positions of a solve."""

    image_id: int  # id of the pose in the solve
    axes: str  # "up" or "all"

    @staticmethod
    def beside(problem: Problem, axes: str) -> PositionOffset:
        """Make an offset whose pose has an unused image id."""
        last = int(problem.image_ids.max(initial=0))
        if last >= LARGEST_ID:
            raise InputError(f"image_ids: an offset of the positions needs ids below {LARGEST_ID}")
        return PositionOffset(last + 1, axes)

    @property
    def key(self) -> tuple[str, int]:
        """Key of the pose."""
        return ("image", self.image_id)

    def added_to(self, problem: Problem, start: NDArray[np.float64]) -> Problem:
        """Return the problem with the pose as its last image, at a start (3,) of the offset."""
        value = np.array(OFFSET_AXES[self.axes]) * start
        fields = {
            "cam_from_world": [*_IDENTITY, *value],
            "image_ids": self.image_id,
            "image_camera": problem.image_camera[0],
            "image_frame": -1,
            "image_sensor": -1,
        }
        has_rigs = len(problem.image_frame) > 0
        changes: dict[str, Any] = {
            name: np.concatenate([getattr(problem, name), np.array([row])])
            for name, row in fields.items()
            if has_rigs or name not in _OF_IMAGES[3:]
        }
        shutter = problem.rolling_shutter
        if shutter is not None:
            frames, neighbours = shutter.frames, shutter.neighbours
            changes["rolling_shutter"] = dataclasses.replace(
                shutter,
                twist=np.concatenate([shutter.twist, np.zeros((1, 6))]),
                frames=None if frames is None else np.append(frames, np.nan),
                neighbours=None
                if neighbours is None
                else np.concatenate([neighbours, np.array([[-1, -1]], np.int32)]),
            )
        return problem.replace(image_names=(*problem.image_names, ""), **changes)

    def taken_from(self, problem: Problem) -> Problem:
        """Remove the pose from a problem of :meth:`added_to` after a solve or filter."""
        has_rigs = len(problem.image_frame) > 0
        names = _OF_IMAGES if has_rigs else _OF_IMAGES[:3]
        changes: dict[str, Any] = {name: getattr(problem, name)[:-1] for name in names}
        shutter = problem.rolling_shutter
        if shutter is not None:
            frames, neighbours = shutter.frames, shutter.neighbours
            changes["rolling_shutter"] = dataclasses.replace(
                shutter,
                twist=shutter.twist[:-1],
                frames=None if frames is None else frames[:-1],
                neighbours=None if neighbours is None else neighbours[:-1],
            )
        return problem.replace(image_names=problem.image_names[:-1], **changes)

    def factors(self) -> list[Factor]:
        """Return priors that fix the unused coordinates at no cost."""
        held: list[Factor] = [RotationFactor(self.key, _IDENTITY, HELD)]
        if self.axes == "up":
            information = np.diag([1.0, 1.0, UNKNOWN**-2])
            held.append(PositionFactor(self.key, (0.0, 0.0, 0.0), information))
        return held

    def of(self, factor: PositionFactor, axes: str) -> PositionFactor:
        """Return the factor of a position that has this offset along `axes`."""
        return dataclasses.replace(factor, offset=self.key, axes=OFFSET_AXES[axes])

    def value_in(self, problem: Problem) -> NDArray[np.float64]:
        """Return the offset (3,) in a problem of :meth:`added_to`: position minus model."""
        value: NDArray[np.float64] = problem.cam_from_world[-1, 4:].copy()
        return value
