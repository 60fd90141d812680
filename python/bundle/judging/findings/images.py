r"""Images whose residuals are systematic or large: motion, a rolling shutter, weak images.

Motion during the exposure, and a rolling shutter, which exposes row after row, displace each image
in its own way, so that no lens explains it. After the pose, the intrinsics and the field of the
lens are removed (systematic.py), each image i is fitted by scale, anisotropy and shear: b_i with
the sandwich covariance V_i.

Motion. For anisotropy and shear, Q = sum_i (b_i - mean)^2 / V_i is chi^2 with m - 1 degrees of
freedom if all m images agree. DerSimonian and Laird (1986) estimate the variance between images:

    tau^2 = (Q - (m - 1)) / (sum w - sum w^2 / sum w),  w = 1 / V_i.

Thresholds: Q / (m - 1) > 4, Q > d + 6 sqrt(2 d) + 20 with d = m - 1, over at least 6 images, and
tau > 0.45 scales at the image border. Poses and points absorb a lens field differently from image
to image, which looks like motion of 3 to 7 times the field that is left, and a mean of motions
looks like a lens. So tau must also exceed 8 times the size of the lens field (lens_terms.py);
otherwise it is the lens. It is also the lens if a larger one explains at least as much as
velocities, by Akaike's criterion (larger_lens.py): lenses per image hide the field that they share.
Row shifts of four times the noise reach 1.5 scales, real models with motion 0.6 to 1.6.

Rows against columns. Linear fields cannot distinguish them: rotation has absorbed the difference.
The derivatives D of the pose can: a velocity times the row y gives the columns y D, times the
column x gives x D. With S(y), S(x) and S(x, y) the sums of squares that these explain, rows explain
S(x, y) - S(x) beyond columns, and columns S(x, y) - S(y) beyond rows. A direction is named if its
part is 1.5 times the other. A rolling shutter is proposed if these velocities explain at least half
of what the linear fields explain; it is read by rows unless columns are named.

Price. Velocities make the cameras less certain. Let C0 and C1 be the covariances of the centres in
the present model and in that with velocities, for the same noise, D = C1 - C0, and d the movement
of the centres in the first step with velocities beyond that of the present model. Motion has moved
the present centres by b: their error is b + e, that with velocities u + e, and d = u - b. u is
independent of e and has the covariance D (Hausman 1978). So velocities change the sum of squares by

    L = |u + e|^2 - |b + e|^2 = 2 (u + e)^T d - |d|^2,    E L = E (2 tr D - |d|^2).

This estimate of L has an error of zero mean and of the variance E 4 (d^T C1 d + tr D^2), for any b.
A shutter is suggested if L is negative by 1.28 of these deviations, the normal quantile of 90 %:
few directions make most of tr D, so that |d|^2 is often much larger by chance. The suggestion does
harm if L > 0 nevertheless: in simulations of 1 to 41 directions in at most 4.8 % of the cases, for
any b. It does not share lenses that differ: ``shared_lens`` decides on that afterwards.

Single images. Without motion in general, an image has systematic residuals if b_i^T V_i^-1 b_i >
3 + 6 sqrt(6) + 20 + 2 log m and its field has an rms of half a scale. It is weak if its scale is
1.75 times the median of all, which is 3 times the spread of the logarithms and 5 times their
standard error, 0.72 / sqrt(n), and if its errors without the linear field are 1.5 times as large.
Huber's loss at 2.5 times the noise reduces the weight of such images and costs the good ones
nearly nothing; cauchy's at 1 px costs them more than weak images do. But least squares is no worse
than the best weights by more than the share q of these images in the sum of squares explains: a
parameter of all images has at most 1 / (1 - q) of its best variance, and the images' own positions
gain nothing. At q = 0.3 (two images of 20 with 3 times the noise), the loss changes positions by a
factor of 0.99 on average, between 0.84 and 1.3 by chance (30 scenes); at q = 0.73, by 0.71 (24
scenes). So q >= 2/3 is needed for a command. At a weak joint, few points cause most errors of
positions, and a loss changes these errors at random; then no command is given.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import median
from bundle.base.records import dataclass
from bundle.base.words import few, noun, number
from bundle.errors import InputError, shown
from bundle.interface.finding import Finding
from bundle.judging.findings.larger_lens import MOST_WORK, Step, explains_more
from bundle.judging.findings.lens_terms import LensField
from bundle.judging.findings.measured import Measured, median_by_group
from bundle.judging.findings.systematic import SystematicResiduals
from bundle.model.shutter_motion import can_roll

RATIO, SIZE, LENS_SIZES = 4.0, 0.45, 8.0
ROWS_AGAINST_COLUMNS = 1.5
EXPLAINED = 0.5
FEWEST_IMAGES = 6
FIELD = 0.5
WEAK, WEAK_WITHOUT_FIELD = 1.75, 1.5
WEAK_SPREADS, WEAK_ERRORS = 3.0, 5.0
GAIN = 1.28
"""Least decrease of the squared errors, in its standard deviations, to suggest a shutter."""
MOST_SQUARES = 2 / 3  # least share of weak images in the sum of squares to suggest a loss
HUBER = 2.5  # scale of a loss for weak images, by the noise
NAMED = 3
LEFT = 0.01  # share of a field that must be left for a test
_ORDERS = {
    "": "the direction is not clear",
    "rows": "along the rows' order, as a rolling shutter does",
    "columns": "along the columns' order, as a rolling shutter of a turned camera does",
}

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ImageFits:
    """Linear fields of the images that take part; arrays have one entry per image."""

    coefficients: Floats  # (m, 3) of scale, anisotropy and shear [px at the border]
    variances: Floats  # (m, 3) their variances; infinite where the field is not left
    chi2: Floats  # (m,) statistic of all three
    sizes: Floats  # (m,) rms of the field, in scales
    medians: Floats  # (m,) median error without the field [px]


def motion(
    measured: Measured, found: SystematicResiduals, fits: ImageFits, fields: Sequence[LensField]
) -> Finding | None:
    """Return the finding about motion or a rolling shutter, or None."""
    ratios, sizes, is_varied = variation(measured.scale, fits, fields)
    if not is_varied:
        return None
    rows, columns, explained = direction(found)
    named = named_order(rows, columns)
    order = named or "rows"
    moved = [found.images[k].image for k in np.argsort(-fits.sizes, kind="stable")[:NAMED].tolist()]
    worst = max(ratios, key=lambda name: ratios[name])
    if _is_lens(measured, order):
        return None
    gain = gain_of_shutter(measured, order) if explained > EXPLAINED else np.nan
    shutter = order if gain > GAIN else ""
    return Finding(
        kind="motion",
        sentence=f"Motion or a rolling shutter: the {worst} of the residuals differs from image to "
        f"image by {sizes[worst] * measured.scale:.2g} px at its border (standard deviation; "
        f"noise subtracted; {_ORDERS[named]}). "
        f"Keep one lens: a lens per image would absorb it and move the cameras.{price_of(gain)}",
        command=measured.command.refine("--rolling-shutter", shutter) if shutter else "",
        evidence={
            "chi2_per_dof": ratios,
            "sizes": sizes,
            "rows": rows,
            "columns": columns,
            "explained": explained,
            "shutter": shutter,
            "gain": gain,
            "image_ids": [int(found.problem.image_ids[image]) for image in moved],
        },
    )


def variation(
    scale: float, fits: ImageFits, fields: Sequence[LensField]
) -> tuple[dict[str, float], dict[str, float], bool]:
    """Return chi^2/dof and tau (in scales) of anisotropy and shear, and whether these vary."""
    ratios, sizes = {}, {}
    least = max(SIZE, LENS_SIZES * max((field.size for field in fields), default=0.0))
    is_varied = False
    for name, column in (("anisotropy", 1), ("shear", 2)):
        ratio, tau, excess = between_images(fits.coefficients[:, column], fits.variances[:, column])
        ratios[name], sizes[name] = ratio, tau / scale
        is_varied |= ratio > RATIO and excess > 0 and tau > least * scale
    return ratios, sizes, is_varied


def named_order(rows: float, columns: float) -> str:
    """Return the order of reading that the parts of :func:`direction` name; "": neither."""
    if rows > ROWS_AGAINST_COLUMNS * columns:
        return "rows"
    return "columns" if columns > ROWS_AGAINST_COLUMNS * rows else ""


def price_of(gain: float) -> str:
    """Return a sentence if a rolling shutter can be added but hardly improves the model."""
    if not gain <= GAIN:
        return ""
    return " It is uncertain that a rolling shutter removes more errors than it adds."


def image_residuals(
    measured: Measured, found: SystematicResiduals, fits: ImageFits, *, is_general: bool,
    is_jointed: bool,
) -> Finding | None:  # fmt: skip
    """Return the finding about single images, or None; general motion would hide it."""
    problem, images = measured.problem, found.images
    limit = 3.0 + 6.0 * np.sqrt(6.0) + 20.0 + 2.0 * np.log(max(len(images), 1))
    systematic = np.flatnonzero((fits.chi2 > limit) & (fits.sizes > FIELD) & (not is_general))
    chosen = {images[k].image: "systematic" for k in systematic.tolist()}
    weak, ratio = _weak(measured, found, fits)
    chosen.update(dict.fromkeys(weak.tolist(), "weak"))
    if not chosen or 3 * len(systematic) > len(images) or 3 * len(weak) > problem.num_images:
        return None
    order = sorted(chosen, key=lambda image: -ratio[image])
    names = {k: shown(problem.image_names[k]) or f"image {problem.image_ids[k]}" for k in order}
    words = few((f"{names[k]} ({chosen[k]}, {ratio[k]:.2f} times)" for k in order), NAMED)
    squares = np.bincount(problem.observation_image, minlength=problem.num_images) * ratio**2
    share = float(squares[order].sum() / squares.sum())
    gains = measured.options.loss == "trivial" and not is_jointed and share >= MOST_SQUARES
    huber = ("--loss", "huber", "--loss-scale", f"{HUBER * measured.scale:.2g}")
    return Finding(
        kind="image_residuals",
        sentence=f"{len(order)} {noun(len(order), 'image has', 'images have')} larger or "
        f"systematic residuals (noise relative to the median image): {words}. "
        f"They have {number(100 * share)} % of the sum of squares.",
        command=measured.command.refine(*huber) if gains else "",
        evidence={
            "image_ids": [int(problem.image_ids[image]) for image in order],
            "systematic": [int(problem.image_ids[images[k].image]) for k in systematic.tolist()],
            "weak": [int(problem.image_ids[image]) for image in weak.tolist()],
            "noise_ratio": [float(ratio[image]) for image in order],
            "share": share,
        },
    )


def image_fits(found: SystematicResiduals, scale: float) -> ImageFits:
    """Fit scale, anisotropy and shear of each image."""
    count, image = found.num_rows, found.image_of_row
    raw = np.sqrt(found.sums((found.xy**2).sum(axis=1)))
    normal = found.image_normals
    left = np.diagonal(normal, axis1=1, axis2=2) > (LEFT * raw[:, None]) ** 2
    inverse = np.linalg.pinv(np.where(left[:, :, None] & left[:, None, :], normal, 0.0))
    fields, residual = found.image_fields, found.residuals_without_lens
    fields = np.where(left[image, None, :], fields, 0.0)  # what is not left may be infinite
    product = found.sums(np.einsum("nka,nk->na", fields, residual))
    coefficients = np.einsum("mab,mb->ma", inverse, product)
    field = np.einsum("nka,na->nk", fields, coefficients[image])
    rest = residual - field
    medians, _ = median_by_group(np.hypot(*rest.T), image, len(count))
    scores = np.einsum("nka,nk->na", fields, rest)
    spread = found.sums(scores[:, :, None] * scores[:, None, :])
    spread *= (count / np.maximum(count - 6, 1))[:, None, None]
    covariance = inverse @ spread @ inverse
    weight = np.linalg.pinv(covariance, hermitian=True)
    return ImageFits(
        coefficients=coefficients,
        variances=np.where(left, np.diagonal(covariance, axis1=1, axis2=2), np.inf),
        chi2=np.einsum("ma,mab,mb->m", coefficients, weight, coefficients),
        sizes=np.sqrt(found.sums((field**2).sum(axis=1)) / np.maximum(2 * count, 1)) / scale,
        medians=np.where(count > 0, medians, 0.0),
    )


def between_images(values: Floats, variances: Floats) -> tuple[float, float, float]:
    """Return Q / (m - 1), the standard deviation tau between images, and Q minus its limit."""
    known = np.isfinite(variances) & (variances > 0)
    values, weight = values[known], 1.0 / variances[known]
    dof = len(values) - 1
    if len(values) < FEWEST_IMAGES:
        return 0.0, 0.0, -np.inf
    mean = float((weight * values).sum() / weight.sum())
    statistic = float((weight * (values - mean) ** 2).sum())
    spread = float(weight.sum() - (weight**2).sum() / weight.sum())
    tau = float(np.sqrt(max(statistic - dof, 0.0) / spread)) if spread > 0 else 0.0
    return statistic / dof, tau, statistic - (dof + 6.0 * np.sqrt(2.0 * dof) + 20.0)


def direction(found: SystematicResiduals) -> tuple[float, float, float]:
    """Return how well velocities times rows or columns explain the residuals.

    Returns:
        Sum of squares that rows explain beyond columns, that of columns beyond rows, and what the
        better of both explains as a share of what the linear fields explain.
    """
    by_row, by_column, by_both, by_fields = 0.0, 0.0, 0.0, 0.0
    for one in found.images:
        pose, xy = found.derivatives[0][one.rows], found.xy[one.rows][:, None, :]
        row, column = pose * xy[:, :, 1:], pose * xy[:, :, :1]
        by_row += found.explained(one, row)
        by_column += found.explained(one, column)
        by_both += found.explained(one, np.concatenate([row, column], axis=2))
        by_fields += found.explained(one, found.image_fields[one.rows])
    explained = max(by_row, by_column) / by_fields if by_fields > 0 else 0.0
    return by_both - by_column, by_both - by_row, explained


def _weak(
    measured: Measured, found: SystematicResiduals, fits: ImageFits
) -> tuple[NDArray[np.int64], Floats]:
    """Return the weak images and the ratio of each image's scale to their median."""
    scale = measured.image_scale
    known = np.isfinite(scale)
    ratio = np.where(known, scale / median(scale[known]) if known.any() else 1.0, 1.0)
    count = np.bincount(measured.problem.observation_image, minlength=len(scale))
    logarithm = np.log(np.maximum(ratio, 1e-12))
    spread = 1.4826 * median(np.abs(logarithm[known])) if known.any() else 0.0
    error = WEAK_ERRORS * 0.72 / np.sqrt(np.maximum(count, 1))
    limit = np.maximum(max(np.log(WEAK), WEAK_SPREADS * spread), error)
    is_weak = known & (logarithm > limit)
    # An image that moved is not weak: its errors are usual without its linear field.
    usual = WEAK_WITHOUT_FIELD * median(fits.medians) if len(fits.medians) else 0.0
    rows = np.array([one.image for one in found.images], np.int64)
    is_weak[rows] &= fits.medians > usual
    return np.flatnonzero(is_weak), ratio


def gain_of_shutter(measured: Measured, order: str) -> float:
    """Return -L of a rolling shutter in its standard deviations; see the top.

    It is NaN if no shutter can be added, infinite if the model is too large for the step.
    """
    if can_roll(measured.whole) and not _has_step(measured):
        return np.inf
    try:
        rolling, present = _rolling(measured, order), Step(measured.whole, measured.options)
        covariances = [one.position_covariance() * rolling.variance for one in (present, rolling)]
    except InputError:  # no size of images, something is not determined, or the sums overflow
        return np.nan
    return certain_gain(rolling.moves_beyond(present).ravel(), *covariances)


def certain_gain(moved: Floats, present: Floats, rolling: Floats) -> float:
    """Return -L in its standard deviations; d (n,), C0 and C1 (n, n) as defined at the top."""
    added = rolling - present
    deviation = 2.0 * np.sqrt(moved @ rolling @ moved + (added**2).sum())
    return (moved @ moved - 2.0 * np.trace(added)) / deviation if deviation > 0 else np.inf


def _has_step(measured: Measured) -> bool:
    return measured.work <= MOST_WORK and "poses" in measured.options.refine


def _rolling(measured: Measured, order: str) -> Step:
    from bundle.editing.rolling_shutters import with_shutters  # few models move
    from bundle.interface.camera_edit_options import ShutterOptions

    if not can_roll(measured.whole):
        raise InputError("problem: expected cameras to which a rolling shutter can be added")
    shutter = ShutterOptions(rolling_shutter=order)
    return Step(*with_shutters(measured.whole, shutter, measured.options))


def _is_lens(measured: Measured, order: str) -> bool:
    """Return True if a larger lens explains the residuals better than a shutter."""
    try:
        return _has_step(measured) and explains_more(measured, _rolling(measured, order))
    except InputError:
        return False
