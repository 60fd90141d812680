r"""Lens model too small: a systematic field of residuals, and the missing term.

Test. The candidate fields (systematic.py) are further radial terms, tangential distortion or a
displaced principal point, and different focal lengths. If poses and intrinsics absorb more than 95
% of a field, the model already has this term. The coefficients theta of all images of one camera
model and size come from one regression r = A theta. The covariance V of theta is a sandwich H^-1 W
H^-1 with H = A^T A: W sums the outer products of the scores of observations, or of images. The Wald
statistic theta^T V^-1 theta is compared with chi^2 of d = dim theta degrees of freedom. In
different images, poses and points absorb different parts of a field. So the statistic by images is
smaller: it needs images that agree. If they do not, the cause is motion.

Thresholds. A statistic by observations above d + 6 sqrt(2 d) + 20 (p below 1e-7 for d = 1 to 6,
enough for a thousand lenses), by images (from 10 on) above d + 3.1 sqrt(2 d) + 5.5 (p = 0.001), and
a field A theta of rms 0.13 scales per coordinate, which makes the RMSE 1 % too large. Real models:
0.005 to 0.06 where the lens is right, 0.10 for a pinhole that is nearly enough, 0.25 to 0.44 where
it is too small.

Model. Take the smallest larger model whose additional terms explain half of the field; the next run
tests the rest. Poses and points turn a part of each field into others: in seeded scenes, a missing
r2 or r4 alone explains 78 to 100 % of it, r6 48 to 74 %, other terms 3 % at most. Terms that are
not needed cost accuracy: where r4 was missing, RADIAL left 0.11 to 0.93 of the position errors,
OPENCV 0.14 to 1.4.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.records import dataclass
from bundle.base.words import named
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.systematic import LENS_TERMS, SystematicResiduals, is_left

SIZE = 0.13
FEWEST_ROWS = 100
FEWEST_IMAGES_FOR_CLUSTERS = 10
EXPLAINED = 0.5

RADIAL, TANGENTIAL, ASPECT = ("r2", "r4", "r6"), ("t1", "t2"), ("a",)
_RADIAL_1, _RADIAL_2 = ("r2",), ("r2", "r4")
_OPENCV = (*_RADIAL_2, *TANGENTIAL, *ASPECT)
LARGER: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "perspective": (
        ("SIMPLE_RADIAL", _RADIAL_1),
        ("RADIAL", _RADIAL_2),
        ("OPENCV", _OPENCV),
        ("FULL_OPENCV", LENS_TERMS),
    ),
    "fisheye": (
        ("SIMPLE_RADIAL_FISHEYE", _RADIAL_1),
        ("RADIAL_FISHEYE", _RADIAL_2),
        ("OPENCV_FISHEYE", (*RADIAL, *ASPECT)),
        ("THIN_PRISM_FISHEYE", LENS_TERMS),
    ),
}
"""Models of a family with their terms, the smallest first."""
START = {
    "SIMPLE_PINHOLE": ("perspective", 0),
    "PINHOLE": ("perspective", 2),
    "SIMPLE_RADIAL": ("perspective", 1),
    "RADIAL": ("perspective", 2),
    "OPENCV": ("perspective", 3),
    "SIMPLE_DIVISION": ("perspective", 1),
    "DIVISION": ("perspective", 2),
    "FOV": ("perspective", 2),
    "SIMPLE_FISHEYE": ("fisheye", 0),
    "FISHEYE": ("fisheye", 2),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", 1),
    "RADIAL_FISHEYE": ("fisheye", 2),
    "OPENCV_FISHEYE": ("fisheye", 3),
    "EUCM": ("fisheye", 2),
}
"""Family of a model, and the first of its members that is larger."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LensField:
    """Field of residuals that is common to the images of one camera model and size."""

    model: str  # camera model
    camera_ids: tuple[int, ...]  # cameras of these images
    terms: tuple[str, ...]  # names of the candidate fields that are left
    columns: Floats  # (n, 2, m) these fields, without poses and intrinsics
    residual: Floats  # (n, 2) residuals, without poses and intrinsics [px]
    field: Floats  # (n, 2) what the candidates explain [px]
    statistic: float  # Wald statistic by observations
    significant: bool  # True if both statistics are above their limits
    size: float  # rms of the field per coordinate, in scales

    def explained(self, terms: tuple[str, ...]) -> float:
        """Return the mean square of the field that these terms alone explain."""
        chosen = [k for k, name in enumerate(self.terms) if name in terms]
        if not chosen:
            return 0.0
        flat = self.columns[:, :, chosen].reshape(-1, len(chosen))
        fitted = flat @ np.linalg.lstsq(flat, self.residual.reshape(-1), rcond=1e-8)[0]
        return float((fitted**2).mean())


def lens_model(measured: Measured, fields: Sequence[LensField]) -> Finding | None:
    """Return the finding about the lens with the largest field, or None."""
    fields = [field for field in fields if field.significant and field.size > SIZE]
    if not fields:
        return None
    worst = max(fields, key=lambda field: field.size)
    total = float((worst.field**2).mean())
    larger = {name: worst.explained(terms) for name, terms in larger_models(worst.model)}
    enough = [name for name, value in larger.items() if value >= EXPLAINED * total]
    name = enough[0] if enough else next(reversed(larger), "")
    if "extra" not in measured.options.refine:  # added terms would stay zero
        name = ""
    kinds = (("radial", RADIAL), ("tangential", TANGENTIAL), ("aspect", ASPECT))
    shares = {kind: min(worst.explained(terms) / total, 1.0) for kind, terms in kinds}
    kind, share = max(shares.items(), key=lambda item: item[1])
    sizes = np.sort(np.hypot(*worst.field.T))
    percentile = float(sizes[(99 * len(sizes) - 1) // 100])
    return Finding(
        kind="lens_model",
        sentence=f"The lens model {worst.model} of {named('camera', worst.camera_ids)} is too "
        f"small: all images have the same pattern of residuals, "
        f"{worst.size * measured.scale:.2g} px rms ({percentile:.2g} px at its 99th percentile), "
        f"{100 * share:.0f} % of it {kind}.",
        command=measured.command.refine("--camera-model", name) if name else "",
        evidence={
            "camera_ids": list(worst.camera_ids),
            "model": worst.model,
            "larger_model": name,
            "size": worst.size,
            "chi2": worst.statistic,
            "percentile_99": percentile,
            "shares": shares,
            "num_lenses": len(fields),
        },
    )


def fields_of_lenses(found: SystematicResiduals, scale: float) -> list[LensField]:
    """Return the field of each camera model and size with enough observations."""
    lenses = [(model, rows) for model, rows in found.lenses if int(rows.sum()) >= FEWEST_ROWS]
    fields = [_field(scale, found, model, rows) for model, rows in lenses]
    return [field for field in fields if field is not None]


def _field(
    scale: float, found: SystematicResiduals, model: str, rows: NDArray[np.bool_]
) -> LensField | None:
    problem = found.problem
    columns, residual = found.lens_fields[rows], found.residuals[rows]
    left = is_left(columns, found.lens_columns)
    if not left.any():
        return None
    columns = columns[:, :, left]
    image = problem.observation_image[found.observations[rows]]
    theta, statistic, significant = _wald(columns, residual, image)
    field = columns @ theta
    return LensField(
        model=model,
        camera_ids=tuple(np.sort(problem.camera_ids[distinct(found.camera[rows])]).tolist()),
        terms=tuple(name for name, is_left in zip(LENS_TERMS, left, strict=True) if is_left),
        columns=columns,
        residual=residual,
        field=field,
        statistic=statistic,
        significant=significant,
        size=float(np.sqrt((field**2).mean())) / scale,
    )


def larger_models(model: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the larger models of a family with their further terms, the smallest first."""
    family, first = START.get(model, ("perspective", len(LARGER["perspective"])))
    own = dict(LARGER[family]).get(model, ())
    return tuple(
        (name, tuple(term for term in terms if term not in own))
        for name, terms in LARGER[family][first:]
    )


def _wald(
    columns: Floats, residual: Floats, image: NDArray[np.int32]
) -> tuple[Floats, float, bool]:
    """Return the coefficients, their Wald statistic by observations, and True if significant."""
    count = columns.shape[2]
    flat, values = columns.reshape(-1, count), residual.reshape(-1)
    norm = np.linalg.norm(flat, axis=0)
    inverse = np.linalg.pinv((flat / norm).T @ (flat / norm), rcond=1e-10, hermitian=True)
    theta = inverse @ ((flat / norm).T @ values)
    left = residual - (columns / norm) @ theta
    scores = ((columns / norm) * left[:, :, None]).sum(axis=1)
    _, cluster = np.unique(image, return_inverse=True)
    sums = np.stack([np.bincount(cluster, score) for score in scores.T], axis=1).astype(float)
    statistic = _statistic(theta, inverse, scores)
    root = np.sqrt(2.0 * count)
    significant = statistic > count + 6.0 * root + 20.0
    if len(sums) >= FEWEST_IMAGES_FOR_CLUSTERS:
        significant &= _statistic(theta, inverse, sums) > count + 3.1 * root + 5.5
    return theta / norm, statistic, bool(significant)


def _statistic(theta: Floats, inverse: Floats, scores: Floats) -> float:
    covariance = inverse @ (scores.T @ scores) @ inverse
    return float(theta @ np.linalg.pinv(covariance, hermitian=True) @ theta)
