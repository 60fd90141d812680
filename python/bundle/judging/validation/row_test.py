"""Tests for motion or a rolling shutter: residuals by row, shear of single images.

Held-out errors cannot distinguish a lens per image from motion during the exposure: a lens per
image absorbs part of the motion, predicts better, and moves the cameras. The residuals can. Under a
rolling shutter, an image that moves by (a, b) pixels during the readout has the displacement (a, b)
y, where y is the row. Let x, y be the projections, relative to the centre of the image, in halves
of its longer side, and fit the residuals of each image by the affine field

    r_x = a_0 + a_x x + a_y y,    r_y = b_0 + b_x x + b_y y.

Its four slopes are a rotation (b_x - a_y) / 2, which the pose absorbs, and

    isotropic    (a_x + b_y) / 2    along (x, y): another focal length
    anisotropic  (a_x - b_y) / 2    along (x, -y): another ratio fx / fy
    shear        (a_y + b_x) / 2    along (y, x): in no lens with orthogonal axes.

Each coordinate is regressed on u = (1, x, y): with G = sum u u^T, an observation has the weights
w = G^-1 u, and a_x = sum w_x r_x, b_x = sum w_x r_y and so on. The residuals e of this regression
give the variance of a slope without an assumption on the noise (sandwich; White 1980): that of the
shear is sum ((w_y e_x + w_x e_y) / 2)^2 n / (n - 3). Observations beyond 5 sigma are left out,
sigma = median error / 1.1774. Duplicated points repeat measurements; each counts once.

If all images lack the same lens terms, a slope b_i with variance v_i varies about the weighted
mean of its camera by noise only:

    Q = sum (b_i - mean)^2 / v_i

has a chi-square distribution with d = (images - cameras) degrees of freedom. Points and poses
absorb part of the noise, so Q tends to be smaller. The variance that motion adds is estimated by
(DerSimonian and Laird 1986, "Meta-analysis in clinical trials")

    tau^2 = (Q - d) / C,    C = sum 1/v_i - sum over cameras (sum 1/v_i^2 / sum 1/v_i).

The test fires if the shear is significant (Q beyond the quantile 1 - 1e-4) and not explained by a
lens model that is too small (Q / d > 3; without motion, real models reach 2.6), and if the pattern
is relevant: without noise, anisotropy and shear displace an observation by tau^2 (x^2 + y^2) each
in the mean of squares. A variance is relevant if it raises the RMS by 1 %, the threshold of the
decision. The
anisotropy alone proves no motion: cameras may differ in fx / fy. Last, the shear must also remain
where each image may have its own lens: in the exact test (:mod:`.shear_score`), significant at 5 %
or twice as large as its noise. With few images 5 % may be out of reach.

Motion along the columns shows in the anisotropy only, and with few images neither test is clear.
Where the sum of both Q is beyond the quantile 1 - 1e-4 of 2 d degrees of freedom, motion is
suspected: a rolling shutter is tried (:mod:`.rolling_fits`).

Slopes do not distinguish rows from columns. A motion (a, b) y and a motion (b, -a) x differ by a
rotation and a scale of the image, which the pose absorbs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.tails import chi2_bound, chi2_tail
from bundle.model.cameras import param_kinds
from bundle.model.folds import measurement_numbers
from bundle.model.point_elimination import SINGULAR, eliminate_points, part_of_observations
from bundle.model.problem import Problem
from bundle.model.residuals import linearize

FEWEST_OF_IMAGE = 30  # number of observations that an image needs to take part

_SIGNIFICANT = 1e-4  # probability of a larger chi2 without motion
_CONFIRMED = 0.05  # the same in the exact test
SMALLEST_RATIO = 3.0
RELEVANT = 0.01
CONFIRMED_RATIO = 2.0
_OUTLIER = 5.0  # sigmas
_RAYLEIGH_MEDIAN = 1.17741

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class RowTest:
    """Variation over the images of residual patterns that a shared lens cannot have."""

    # True if motion is found: the shear is significant and the pattern large, or a rolling shutter
    # predicts what lenses per image do
    fires: bool
    is_suspected: bool  # True if anisotropy and shear together are significant
    isotropy: float  # chi2 per degree of freedom of the slope along (x, y); NaN with too few images
    anisotropy: float  # the same along (x, -y)
    shear: float  # the same along (y, x)
    size: float  # relative increase of the RMS by anisotropy and shear
    # (3,) standard deviation over the images of the three slopes beyond their noise [pixels at half
    # the longer side of the image]
    deviations: _Floats
    sigma: float  # noise of a coordinate [pixels]
    # ratio of the exact test for shear (:mod:`.shear_score`), 1 in the mean without motion; NaN if
    # the test above decided
    confirmation: float
    images: NDArray[np.int64]  # (num_images,) index of each image with enough observations
    slopes: _Floats  # (num_images, 3) its slopes [pixels at half the longer side]
    errors: _Floats  # (num_images, 3) their standard errors
    # relative decrease of the score of shared lenses by a rolling shutter, if it explains their
    # residuals: they are then compared beside it; else NaN
    gain: float = math.nan

    @property
    def num_images(self) -> int:
        """Number of images with enough observations."""
        return len(self.images)


def row_test(problem: Problem, residuals: _Floats) -> RowTest:
    """Return the test of one fit.

    ``problem``: the fitted problem: lenses shared as far as possible, with a robust loss. Images
    with their own cameras do not take part. ``residuals``: (num_observations, 2) projection minus
    measurement [pixels]; NaN without a projection.
    """
    rows, sigma = _used(problem, residuals)
    image, r = problem.observation_image[rows], residuals[rows]
    size = problem.camera_sizes[problem.image_camera[image]].astype(float)
    scale = size.max(axis=1, keepdims=True, initial=0) / 2
    if not scale.all():  # images of unknown size: pixels from the principal point, as in BAL
        size, scale = np.zeros_like(size), np.abs(problem.observation_xy).max(initial=1.0)
    # Measured positions contain the noise of r, which would bias the slope along (x, y).
    position = (problem.observation_xy[rows] + r - size / 2) / scale
    images, slopes, variances = _slopes(image, position, r, problem.num_images)
    camera = problem.image_camera[images]
    shared = np.bincount(camera, minlength=problem.num_cameras)[camera] > 1
    images, slopes, variances = images[shared], slopes[shared], variances[shared]
    chi2, tau2, freedom = _variation(camera[shared], slopes, variances)
    ratios = chi2 / freedom if freedom else np.full(3, np.nan)
    added = tau2[1:].sum() * float((position**2).sum(axis=1).mean()) if freedom else 0.0
    growth = math.sqrt(1 + added / (2 * sigma**2)) - 1 if added else 0.0
    is_significant = chi2_tail(chi2[2], freedom) < _SIGNIFICANT
    score = ShearScore(math.nan, 0.0)
    if is_significant and chi2[2] > SMALLEST_RATIO * freedom and growth > RELEVANT:
        score = shear_score(problem, rows, position, r)
    return RowTest(
        fires=_is_confirmed(score),
        is_suspected=chi2_tail(chi2[1] + chi2[2], 2 * freedom) < _SIGNIFICANT,
        isotropy=float(ratios[0]),
        anisotropy=float(ratios[1]),
        shear=float(ratios[2]),
        size=growth,
        deviations=np.sqrt(tau2),
        sigma=sigma,
        confirmation=score.ratio,
        images=images,
        slopes=slopes,
        errors=np.sqrt(variances),
    )


def _used(problem: Problem, residuals: _Floats) -> tuple[NDArray[np.int64], float]:
    """Return the rows of distinct measurements without outliers, and sigma."""
    rows = np.flatnonzero(np.isfinite(residuals).all(axis=1))
    if not len(rows):
        return rows, 0.0
    lengths = np.hypot(*residuals[rows].T)
    sigma = float(np.median(lengths)) / _RAYLEIGH_MEDIAN
    rows = rows[lengths <= _OUTLIER * sigma]
    number = measurement_numbers(problem.observation_image[rows], problem.observation_xy[rows])
    return np.sort(rows[np.unique(number, return_index=True)[1]]), sigma


def _slopes(
    image: NDArray[np.int32], position: _Floats, r: _Floats, num_images: int
) -> tuple[NDArray[np.int64], _Floats, _Floats]:
    """Return images, and their isotropic, anisotropic and shear slopes with variances."""

    def total(values: _Floats) -> _Floats:
        return np.bincount(image, values, num_images).astype(float)

    x, y = position.T
    u = np.stack([np.ones_like(x), x, y], axis=1)
    gram = np.empty((num_images, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            gram[:, i, j] = gram[:, j, i] = total(u[:, i] * u[:, j])
    count = gram[:, 0, 0].copy()
    # Equal positions in an image determine no slope.
    spread = np.linalg.det(gram / np.maximum(count, 1)[:, None, None])
    takes_part = (count >= FEWEST_OF_IMAGE) & (spread > 1e-6)
    gram[~takes_part] = np.eye(3)
    inverse = np.linalg.inv(gram)
    w = np.einsum("nij,nj->ni", inverse[image], u)
    e = np.empty_like(r)
    found = np.empty((num_images, 2, 3))
    for k in range(2):
        found[:, k] = np.stack([total(w[:, i] * r[:, k]) for i in range(3)], axis=1)
        e[:, k] = r[:, k] - (u * found[image, k]).sum(axis=1)
    (_, a_x, a_y), (_, b_x, b_y) = found[:, 0].T, found[:, 1].T
    slopes = np.stack([a_x + b_y, a_x - b_y, a_y + b_x], axis=1) / 2
    along = w[:, 1:] * e
    across = w[:, 2] * e[:, 0] + w[:, 1] * e[:, 1]
    parts = (along[:, 0] + along[:, 1], along[:, 0] - along[:, 1], across)
    variances = np.stack([total((part / 2) ** 2) for part in parts], axis=1)
    variances *= (count / np.maximum(count - 3, 1))[:, None]
    chosen = np.flatnonzero(takes_part & (variances > 0).all(axis=1))
    return chosen, slopes[chosen], variances[chosen]


def _variation(
    camera: NDArray[np.int32], slopes: _Floats, variances: _Floats
) -> tuple[_Floats, _Floats, int]:
    """Return chi-square about the mean of each camera, tau^2, and the degrees of freedom."""
    cameras, group = np.unique(camera, return_inverse=True)
    freedom = len(camera) - len(cameras)
    if not freedom:
        return np.zeros(3), np.zeros(3), 0
    weight = 1 / variances
    chi2, tau2 = np.empty(3), np.empty(3)
    for k in range(3):
        sums = np.bincount(group, weight[:, k])
        mean = np.bincount(group, weight[:, k] * slopes[:, k]) / sums
        chi2[k] = (weight[:, k] * (slopes[:, k] - mean[group]) ** 2).sum()
        scale = (sums - np.bincount(group, weight[:, k] ** 2) / sums).sum()
        tau2[k] = max(chi2[k] - freedom, 0.0) / scale
    return chi2, tau2, freedom


def _is_confirmed(score: ShearScore) -> bool:
    bound = chi2_bound(score.freedom, _CONFIRMED)
    return score.ratio > CONFIRMED_RATIO or score.ratio * score.freedom > bound


# Exact test for shear of single images: with poses, points, and a lens per image free.
#
# Cameras with really different lenses bend the points between them, and so leave some shear in each
# other's residuals. This test measures the shear that remains if every image has its own lens.
#
# Let r be the residuals and J their Jacobian w.r.t. all that is free: poses, points, lenses of the
# fit, and per image the fields of a lens, with x, y from the centre of the image and s = x^2 + y^2:
#
#     (x, y), (s x, s y)               focal length, radial distortion
#     (x, -y)                          ratio fx / fy
#     (2 x y, s + 2 y^2), (s + 2 x^2, 2 x y)   tangential distortion.
#
# The columns of A are the shears (y, x) of the images, of unit length each. With the projection
# P = I - J (J^T J)^-1 J^T, the scores
#
#     g = A^T P r    have the covariance    sigma^2 F,    F = A^T P A,
#
# if no image has a shear. P also removes the effect of any small step of these parameters, so the
# fit need not have converged fully. The locally most powerful test for independent shears of equal
# variance takes |g|^2 (Rao 1973, "Linear statistical inference and its applications", chapter 6e),
# whose mean is then sigma^2 tr F, with sigma^2 = |P r|^2 / (rows - rank). R = |g|^2 / (sigma^2 tr
# F) times d = (tr F)^2 / tr F^2 has about a chi-square distribution with d degrees of freedom
# (Satterthwaite 1946).
#
# Points are eliminated first (:mod:`bundle.model.point_elimination`). Poses and lenses follow by
# their eigenvalues above 1e-12 of the largest; the gauge makes seven of them zero.
#
# Any part of the observations gives a valid test. Large problems are tested on the images that
# share most points with the image of the most observations, and on an even choice of their points.

MOST_IMAGES = 80
MOST_POINTS = 3000

_Rows = NDArray[np.int64]


class ShearScore(NamedTuple):
    """Result of the test."""

    ratio: float  # R, 1 in the mean without shear; NaN if nothing can be tested
    freedom: float  # degrees of freedom d; 0 if nothing can be tested


def shear_score(
    problem: Problem,
    rows: _Rows,
    position: _Floats,
    residual: _Floats,
    refine: tuple[str, ...] = ("focal", "extra"),
) -> ShearScore:
    """Return the test of ascending observations, which have no outliers and no repetitions.

    Positions (rows, 2) are projections relative to the centre of the image, in any unit, residuals
    (rows, 2) projection minus measurement.
    """
    chosen = part_of_observations(problem, rows, MOST_IMAGES, MOST_POINTS)
    rows, position, residual = rows[chosen], position[chosen], residual[chosen]
    if not len(rows):
        return ShearScore(np.nan, 0.0)
    kept = np.zeros(problem.num_observations, bool)
    kept[rows] = True
    part = problem.select(observations=kept).problem
    found = linearize(part)
    lens, d_lens = _lens_columns(part, found.d_params, refine)
    point = np.unique(part.observation_point, return_inverse=True)[1]
    images, image = np.unique(part.observation_image, return_inverse=True)
    x, y = position.T
    s = x**2 + y**2
    own = [(x, y), (s * x, s * y), (x, -y), (2 * x * y, s + 2 * y**2), (s + 2 * x**2, 2 * x * y)]
    fields = np.stack([np.stack(field, axis=1) for field in own], axis=2)
    shear = np.stack([y, x], axis=1)
    lengths = np.sqrt(np.bincount(image, s, len(images)))
    shear = shear / np.where(lengths > 0, lengths, 1.0)[image][:, None]
    width = 6 + len(own)  # free columns of an image
    begin_lens = width * len(images)
    begin = begin_lens + int(lens.max(initial=-1)) + 1
    columns = np.concatenate([found.d_pose, fields, d_lens, shear[:, :, None]], axis=2)
    places = np.concatenate(
        [
            width * image[:, None] + np.arange(width),
            np.where(lens >= 0, begin_lens + lens, -1),
            begin + image[:, None],
        ],
        axis=1,
    )
    order = np.argsort(point, kind="stable")
    normal, square, rank = eliminate_points(
        columns[order],
        places[order],
        found.d_point[order],
        residual[order],
        point[order],
        begin + len(images),
    )
    return _test(normal, square, 2 * len(rows) - rank, begin)


def _lens_columns(
    problem: Problem, d_params: _Floats, refine: tuple[str, ...]
) -> tuple[NDArray[np.int64], _Floats]:
    """Return the number of each refined lens parameter (-1: none), and its derivative."""
    width = d_params.shape[2]
    number = np.full((problem.num_cameras, width), -1)
    count = 0
    for camera in np.unique(problem.image_camera[problem.observation_image]).tolist():
        kinds = param_kinds(problem.camera_models[camera])
        for column in [k for k, kind in enumerate(kinds) if kind in refine]:
            number[camera, column] = count
            count += 1
    lens = number[problem.image_camera[problem.observation_image]]
    return lens, np.where(lens[:, None, :] >= 0, d_params, 0.0)


def _test(normal: _Floats, square: float, freedom: int, begin: int) -> ShearScore:
    """Eliminate poses and lenses, and compare the scores with their covariance."""
    a = normal[:begin, :begin]
    norms = np.sqrt(np.diag(a))
    scale = np.where(norms > 0, 1 / np.where(norms > 0, norms, 1.0), 0.0)
    values, vectors = np.linalg.eigh(a * scale[:, None] * scale)
    kept = values > SINGULAR * values[-1]
    root = (scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])).T
    left = root @ normal[:begin, begin:]
    reduced = normal[begin:, begin:] - left[:, :-1].T @ left
    f, scores = reduced[:, :-1], reduced[:, -1]
    freedom -= int(kept.sum())
    variance = (square - float(left[:, -1] @ left[:, -1])) / max(freedom, 1)
    trace = float(np.trace(f))
    if freedom < 1 or variance <= 0 or trace <= SINGULAR:
        return ShearScore(np.nan, 0.0)
    return ShearScore(
        ratio=float(scores @ scores) / (variance * trace), freedom=trace**2 / float((f**2).sum())
    )
