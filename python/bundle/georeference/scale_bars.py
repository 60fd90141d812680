r"""Known lengths between control points or images: priors, file, factors, and their test.

A bar of length d and standard deviation s, between a and b, adds to the cost

    1/2 rho(r^2),    r = (|a - b| - d) / s,    dr = u^T (da - db) / s,    u = (a - b) / |a - b|.

The centre c = -R^T t of an image whose pose moves to (R, t) Exp(w, v) moves by c x w - v. A bar
couples two points, which only Ceres can solve.

Test. Let S be the covariance of the lengths l by all other measurements, in any gauge, D =
diag(s^2), c the control bars and k a check bar. At the minimum, v = l - d has the covariances

    D M D,    M = (S_cc + D)^-1,        S_kk - S_kc M S_ck + s_k^2,

so that w = v / (s^2 sqrt(M_ii)), and s^2 M_ii is the redundancy. If nothing else fixes the scale,
it has any value: with N = M, M loses N l l^T N / (l^T N l), and the second covariance gains
(l_k - l^T N S_ck)^2 / (l^T N l) (kriging with an unknown trend; N. Cressie, 1993). A single bar
sets the scale and is not checked; of two, both w are equal; three name the wrong one.

A line of a file has the two names, metres, and optionally the standard deviation and "check"::

    gcp02 gcp07 1.2005 0.0003
    left.jpg right.jpg 0.35 check
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display
from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.base.tails import chi2_tail
from bundle.base.words import number as in_words
from bundle.base.words import plural
from bundle.errors import InputError, brief, nearest, shown
from bundle.georeference.control_point import ROLES, End, Key, ScaleBar
from bundle.georeference.measurements import FoundPriors, KnownPriors, MeasurementErrors, Solved
from bundle.georeference.point_check import BarCheck
from bundle.georeference.similarity import Similarity
from bundle.interface.analysis_options import NOT_CHECKABLE
from bundle.interface.georeference_options import ROBUST_SCALES, SCALE_BAR_SIGMA

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.model.problem import Problem

Array = NDArray[np.float64]
LEVEL = 0.01
SAME_TEST = 1e-3
"""Relative difference of |w| below which bars share one test, which cannot tell them apart."""
MOST_TESTED = 8  # bars whose covariance is computed, by a factorisation for each pair


@dataclass(frozen=True)
class ScaleBars(KnownPriors):
    """Scale bars that were read for a problem."""

    priors: tuple[ScaleBar, ...]

    def errors_of(self, result: Solved) -> ScaleBarErrors | None:
        """Return the errors in a result; None if it is not at a minimum."""
        checks = result.survey_checks
        return ScaleBarErrors(checks.bars) if checks is not None and checks.bars else None


def read_scale_bars(
    problem: Problem,
    *,
    scale_bars: str | os.PathLike[str],
    scale_bar_sigma: float = SCALE_BAR_SIGMA,
    gcp: Any = None,
    prior_loss: str = "trivial",
    prior_loss_scale: float = ROBUST_SCALES[1],
) -> ScaleBars:
    """Read the bars of a file, between images of a problem or points of a list.

    Args:
        problem: problem of the images.
        scale_bars: path of the file; the module has its form.
        scale_bar_sigma: metres, for bars without their own.
        gcp: path of the control points that bars may name.
        prior_loss: robust loss of each bar.
        prior_loss_scale: sigmas beyond which the loss is robust.

    Raises:
        InputError: a line is wrong, names an unknown place, or a pair of places has two lines.
        OSError: a file cannot be read.
    """
    from bundle.georeference.gcp_list import given_control_points
    from bundle.georeference.text_lines import content_lines, parse_number

    path = as_path(scale_bars, "scale_bars")
    targets = [point.name for point in given_control_points(gcp, problem)[0]]
    known = dict.fromkeys([*targets, *problem.image_names])
    bars, lines = [], dict[frozenset[str], int]()
    for line, words in content_lines(path):
        place = f"{shown(path)}: line {line}"
        role = "check" if words[-1] == "check" else "control"
        words = words[: len(words) - (role == "check")]
        if not 3 <= len(words) <= 4:
            raise InputError(
                f"{place}: expected A B distance [sigma] [check], found {len(words)} words"
            )
        for word in words[:2]:
            if word not in known:
                what = "an image of the model" if gcp is None else "a control point or an image"
                raise InputError(
                    f"{place}: expected the name of {what}, found {brief(word)}"
                    f"{nearest(word, known)}"
                )
        pair = frozenset(words[:2])
        if pair in lines:
            raise InputError(
                f"{place}: expected each bar once, found {' '.join(words[:2])} again (first in "
                f"line {lines[pair]})"
            )
        lines[pair] = line
        values = [parse_number(place, "distance", word) for word in words[2:]]
        for what, value in zip(("distance", "sigma"), values, strict=False):
            if not value > 0:
                raise InputError(f"{place}: {what}: expected metres above 0, found {value:g}")
        sigma = values[1] if len(values) > 1 else scale_bar_sigma
        if len(pair) < 2:
            raise InputError(f"{place}: expected two places, found {brief(words[0])} twice")
        robust = {"loss": prior_loss, "loss_scale": prior_loss_scale}
        bars.append(ScaleBar(words[0], words[1], values[0], sigma, role, **robust))  # type: ignore[arg-type]
    if not bars:
        raise InputError(f"{shown(path)}: expected lines of A B distance [sigma], found 0")
    return ScaleBars(tuple(bars))


@dataclass(frozen=True)
class _Residual:
    """Function of a factor: the residual of a bar, and its Jacobians."""

    bar: ScaleBar

    def __call__(self, values: list[Array]) -> tuple[Array, list[Array]]:
        from bundle.model.rigid_motions import cross_matrices, quaternion_inverse, quaternion_rotate

        places, moves = [], []
        for value in values:
            if len(value) == 3:
                places.append(value)
                moves.append(np.eye(3))
                continue
            center = -quaternion_rotate(quaternion_inverse(value[None, :4]), value[None, 4:])
            places.append(center[0])
            moves.append(np.hstack([cross_matrices(center)[0], -np.eye(3)]))
        along = places[0] - places[1]
        length = np.linalg.norm(along)
        sigma = self.bar.sigma
        unit = along / length / sigma
        jacobians = [(sign * unit @ by)[None] for sign, by in zip((1, -1), moves, strict=True)]
        return np.array([(length - self.bar.distance) / sigma]), jacobians


@dataclass(frozen=True)
class FoundBars(FoundPriors):
    """Bars of a solve, and the keys of their ends in its problem."""

    priors: tuple[ScaleBar, ...]
    keys: tuple[tuple[Key, ...], ...] = ()

    moves = True

    @staticmethod
    def make(problem: Problem, priors: Sequence[ScaleBar]) -> FoundBars:  # noqa: ARG004
        """Refuse two bars between the same places; :meth:`beside` finds these."""
        pairs = [frozenset((bar.a, bar.b)) for bar in priors]
        for place, pair in enumerate(pairs):
            if pair in pairs[:place]:
                raise InputError(f"priors: {priors[place].name}: expected each bar once")
        return FoundBars(tuple(priors))

    def beside(self, problem: Problem, groups: Sequence[FoundPriors]) -> FoundBars:
        """Return the bars with their control points, images and points."""
        targets: Any = next((one for one in groups if one.adds_points), None)
        names: dict[End, Key] = {}
        for name, image_id in zip(problem.image_names, problem.image_ids.tolist(), strict=True):
            names[name] = ("image", image_id)
        for used, point_id in zip(targets.used, targets.point_ids, strict=True) if targets else ():
            names[used.point.name] = ("point", point_id)
        ids = {"image": problem.image_ids, "point": problem.point_ids}

        def key(bar: ScaleBar, end: End) -> Key:
            if end in names:
                return names[end]
            if isinstance(end, tuple) and end[1] in ids.get(end[0], ()):
                return end
            raise InputError(
                f"priors: {bar.name}: expected an image, a point, or a control point in at least 2 "
                f"images, found {brief(end)}"
            )

        keys = tuple((key(bar, bar.a), key(bar, bar.b)) for bar in self.priors)
        return replace(self, keys=keys)

    def placement(self, problem: Problem) -> Similarity | None:
        """Return the scale of the model about the middle of the cameras; None of check bars."""
        lengths = self.lengths(problem)
        weights = np.array([(bar.role == "control") / bar.sigma**2 for bar in self.priors])
        if not weights.any():
            return None
        distances = np.array([bar.distance for bar in self.priors])
        scale = float((weights * lengths * distances).sum() / (weights * lengths**2).sum())
        return Similarity(scale, np.eye(3), (1 - scale) * problem.projection_centers.mean(axis=0))

    def factors(self, problem: Problem) -> list[Factor]:
        """Return a factor for each control bar, in order."""
        from bundle.graphs.factors.factors import FunctionFactor

        self.lengths(problem)
        found: list[Factor] = []
        for bar, keys in zip(self.priors, self.keys, strict=True):
            if bar.role == "control":
                robust = {"loss": bar.loss, "loss_scale": bar.loss_scale}
                factor = FunctionFactor(keys, _Residual(bar), **robust)  # type: ignore[arg-type]
                factor.__dict__["name"] = bar.name
                found.append(factor)
        return found

    @staticmethod
    def owns(factor: Factor) -> bool:
        """Return True for a factor of a bar."""
        return isinstance(getattr(factor, "function", None), _Residual)

    def lengths(self, problem: Problem) -> Array:
        """Return the (n,) lengths in a problem."""
        ends = _places(problem, self.keys)
        lengths: Array = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        for bar, length in zip(self.priors, lengths, strict=True):
            if not length > 0:
                raise InputError(f"priors: {bar.name}: expected places apart, found them at one")
        return lengths

    def gradient(self, problem: Problem, row: int) -> tuple[Array, Array]:
        """Return the derivatives of a length w.r.t. (w, t) of images (R to Exp(w) R) and points."""
        from bundle.model.rigid_motions import center_jacobians

        images, points = np.zeros((problem.num_images, 6)), np.zeros_like(problem.points)
        a, b = _places(problem, self.keys[row : row + 1])[0]
        unit = (a - b) / np.linalg.norm(a - b)
        for (kind, key), sign in zip(self.keys[row], (1, -1), strict=True):
            if kind == "point":
                points[problem.point_ids == key] += sign * unit
            else:
                at = problem.image_ids == key
                images[at] += sign * unit @ center_jacobians(problem.cam_from_world[at])[0]
        return images, points

    def checks(
        self, problem: Problem, covariance: Array | None, is_free: bool
    ) -> tuple[BarCheck, ...]:
        """Test all bars at a minimum.

        ``covariance``: (n, n) of the lengths by all other measurements; None: unknown. ``is_free``:
        True if nothing else fixes the scale.
        """
        lengths = self.lengths(problem)
        v = lengths - [bar.distance for bar in self.priors]
        variances = np.array([bar.sigma**2 for bar in self.priors])
        used = np.array([bar.role == "control" for bar in self.priors])
        own, redundancy = np.full(len(v), np.nan), np.full(len(v), np.nan)
        if covariance is not None and (used.any() or not is_free):
            u, s, cross = lengths[used], covariance[used][:, used], covariance[used][:, ~used]
            m = np.linalg.inv(s + np.diag(variances[used]))
            own[~used] = np.diag(covariance)[~used] - np.einsum("ik,ij,jk->k", cross, m, cross)
            if is_free:
                along, total = m @ u, u @ m @ u
                own[~used] += (lengths[~used] - along @ cross) ** 2 / total
                m -= np.outer(along, along) / total
            redundancy[used] = variances[used] * np.diag(m)
            own[used] = variances[used] * redundancy[used]
            own[~used] += variances[~used]
            redundancy[~used] = 1.0
        known = redundancy >= NOT_CHECKABLE
        w = v / np.sqrt(np.where(own > 0, own, np.inf))
        largest = float(np.max(np.abs(w), initial=0.0, where=known))
        is_wrong = chi2_tail(largest**2, 1) < LEVEL / len(v)
        suspect = is_wrong & (np.abs(w) > (1 - SAME_TEST) * largest)
        numbers = (lengths, np.where(known, w, np.nan), redundancy, suspect)
        rows = zip(*(one.tolist() for one in numbers), strict=True)
        return tuple(BarCheck(bar, *one) for bar, one in zip(self.priors, rows, strict=True))


def _places(problem: Problem, keys: Sequence[tuple[Key, ...]]) -> Array:
    """Return the (n, 2, 3) points, or centres of images, at both ends of bars."""
    of = {
        "image": (problem.image_ids, problem.projection_centers),
        "point": (problem.point_ids, problem.points),
    }
    found = [[of[kind][1][of[kind][0] == key][0] for kind, key in pair] for pair in keys]
    return np.array(found)


@dataclass(frozen=True)
class ScaleBarErrors(MeasurementErrors):
    """Residuals and tests of the bars in a result."""

    bars: tuple[BarCheck, ...]

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of the JSON report."""
        found = [{**asdict(one.bar), **asdict(one), "residual": one.residual} for one in self.bars]
        bars = [{k: v for k, v in one.items() if k != "bar"} for one in found]
        return {"scale_bars": {"bars": bars}}

    @property
    def sentences(self) -> list[str]:
        """Root mean squares of the residuals by role."""
        said = []
        for role in ROLES:
            found = [one.residual for one in self.bars if one.bar.role == role]
            if found:
                what = "scale bar" if role == "control" else "check bar"
                rms = float(np.sqrt(np.mean(np.square(found))))
                said.append(f"{plural(len(found), what)}: RMS {in_words(1000 * rms)} mm.")
        return said

    @property
    def warnings(self) -> list[str]:
        """The bars that are probably wrong."""
        wrong = [one for one in self.bars if one.is_suspect]
        if not wrong:
            return []
        names = " or ".join(one.bar.words for one in wrong)
        sizes = f"{wrong[0].residual:+.4g} m, {wrong[0].w:+.1f} sigmas"
        return [
            f"Scale bar {names} is probably wrong ({sizes}): mark its line as check, or drop it."
        ]

    @property
    def displays(self) -> list[Display]:
        """A table of the bars."""
        rows = tuple(
            (
                one.bar.words, one.bar.role, f"{one.bar.distance:.6g}", f"{one.residual:+.2g}",
                f"{one.bar.sigma:.2g}", "-" if np.isnan(one.w) else f"{one.w:+.1f}",
            )
            for one in self.bars
        )  # fmt: skip
        head = ("scale bar", "role", "length [m]", "model minus length", "sigma", "w")
        return [Display(title="Scale bars", head=head, rows=rows, left=2)]


def bars_among(groups: Iterable[FoundPriors]) -> FoundBars | None:
    """Return the bars of a solve; None without any."""
    return next((one for one in groups if isinstance(one, FoundBars)), None)
