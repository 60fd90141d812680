r"""Lens model too small: a systematic field of residuals, and the missing term.

Test. The candidate fields (systematic.py) are further radial terms, tangential distortion or a
displaced principal point, and different focal lengths. A field of which poses and intrinsics leave
less than 5 % belongs to the model already. The coefficients theta of all images of one camera model
and size come from one regression r = A theta. The covariance V of theta
is a sandwich H^-1 W H^-1 with H = A^T A: W sums the outer products of the scores of observations,
or of images. The Wald statistic theta^T V^-1 theta is compared with chi^2 of d = dim theta degrees
of freedom. In different images, poses and points absorb different parts of a field. The statistic
by images, for which the images must agree, is therefore smaller. Without agreement, the cause is
motion.

Thresholds. A statistic by observations above d + 6 sqrt(2 d) + 20 (p below 1e-7 for d = 1 to 6,
enough for a thousand lenses), by images (from 10 on) above d + 3.1 sqrt(2 d) + 5.5 (p = 0.001), and
a field A theta of rms 0.13 scales per coordinate, which makes the RMSE 1 % too large. Real models:
0.005 to 0.06 where the lens is right, 0.10 for a pinhole that is nearly enough, 0.25 to 0.44 where
it is too small.

Model. The smallest larger model whose terms explain 85 % of the field.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.words import named
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.systematic import LEFT, LENS_TERMS, SystematicResiduals

__all__ = ["lens_model", "lens_size"]

SIZE = 0.13
FEWEST_ROWS = 100
FEWEST_IMAGES_FOR_CLUSTERS = 10
EXPLAINED = 0.85

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
class _Field:
    """Field of one lens: size and share of its terms in the explained variance."""

    model: str
    camera_ids: tuple[int, ...]
    significant: bool
    statistic: float
    size: float
    percentile: float
    larger: str
    shares: dict[str, float]


def lens_model(measured: Measured, found: SystematicResiduals) -> Finding | None:
    """Return the finding about the lens with the largest field, or None."""
    fields = [
        field for field in _fields(found, measured.scale) if field.significant and field.size > SIZE
    ]
    if not fields:
        return None
    worst = max(fields, key=lambda field: field.size)
    kind, share = max(worst.shares.items(), key=lambda item: item[1])
    command = measured.command.refine("--camera-model", worst.larger) if worst.larger else ""
    return Finding(
        kind="lens_model",
        sentence=f"The lens model {worst.model} of {named('camera', worst.camera_ids)} is too "
        f"small: a field of residuals of {worst.size:.2f} times the noise is common to the images, "
        f"{100 * share:.0f} % of it {kind} ({worst.percentile:.2g} px at its 99th percentile).",
        command=command,
        evidence={
            "camera_ids": list(worst.camera_ids),
            "model": worst.model,
            "larger_model": worst.larger,
            "size": worst.size,
            "chi2": worst.statistic,
            "percentile_99": worst.percentile,
            "shares": worst.shares,
            "num_lenses": len(fields),
        },
    )


def lens_size(found: SystematicResiduals, scale: float) -> float:
    """Return the size of the largest field, significant or not; 0 without one."""
    return max((one.size for one in _fields(found, scale)), default=0.0)


def _fields(found: SystematicResiduals, scale: float) -> Iterator[_Field]:
    before = np.sqrt((found.lens_columns**2).mean(axis=(0, 1))) if len(found.camera) else None
    for model, rows in found.lenses:
        if before is not None and int(rows.sum()) >= FEWEST_ROWS:
            field = _field(scale, found, model, rows, before)
            if field is not None:
                yield field


def _field(
    scale: float, found: SystematicResiduals, model: str, rows: NDArray[np.bool_], before: Floats
) -> _Field | None:
    problem = found.problem
    columns, residual = found.lens_fields[rows], found.residuals[rows]
    left = np.sqrt((columns**2).mean(axis=(0, 1))) > LEFT * before
    if not left.any():
        return None
    columns = columns[:, :, left]
    names = [name for name, is_left in zip(LENS_TERMS, left, strict=True) if is_left]
    image = problem.observation_image[found.observations[rows]]
    theta, statistic, significant = _wald(columns, residual, image)
    field = columns @ theta
    total = float((field**2).mean())
    explained = {
        name: _explained(columns, residual, names, terms) for name, terms in _larger(model)
    }
    enough = [name for name, value in explained.items() if value >= EXPLAINED * total]
    shares = {
        kind: min(_explained(columns, residual, names, terms) / total, 1.0) if total > 0 else 0.0
        for kind, terms in (("radial", RADIAL), ("tangential", TANGENTIAL), ("aspect", ASPECT))
    }
    return _Field(
        model=model,
        camera_ids=tuple(np.sort(problem.camera_ids[distinct(found.camera[rows])]).tolist()),
        significant=significant,
        statistic=statistic,
        size=float(np.sqrt(total)) / scale,
        percentile=float(np.sort(np.hypot(*field.T))[(99 * len(field) - 1) // 100]),
        larger=enough[0] if enough else next(reversed(explained), ""),
        shares=shares,
    )


def _larger(model: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    family, first = START.get(model, ("perspective", len(LARGER["perspective"])))
    return LARGER[family][first:]


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


def _explained(
    columns: Floats, residual: Floats, names: list[str], terms: tuple[str, ...]
) -> float:
    """Return the mean square of the field that these terms alone explain."""
    chosen = [k for k, name in enumerate(names) if name in terms]
    if not chosen:
        return 0.0
    flat = columns[:, :, chosen].reshape(-1, len(chosen))
    fitted = flat @ np.linalg.lstsq(flat, residual.reshape(-1), rcond=1e-8)[0]
    return float((fitted**2).mean())
