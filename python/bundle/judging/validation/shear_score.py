"""Exact test for shear of single images: with poses, points, and a lens per image free.

Cameras with really different lenses bend the points between them, and so leave some shear in each
other's residuals. This test asks for the shear that remains if every image may have its own lens.

Let r be the residuals and J the derivatives by all that is free: poses, points, the lenses of the
fit, and per image the fields of a lens, with x, y from the centre of the image and s = x^2 + y^2:

    (x, y), (s x, s y)               focal length, radial distortion
    (x, -y)                          ratio fx / fy
    (2 x y, s + 2 y^2), (s + 2 x^2, 2 x y)   tangential distortion.

The columns of A are the shears (y, x) of the images, of unit length each. With the projection
P = I - J (J^T J)^-1 J^T, the scores

    g = A^T P r    have the covariance    sigma^2 F,    F = A^T P A,

if no image has a shear. P also removes the effect of any small step of these parameters, so the
fit need not have converged fully. The locally most powerful test for
independent shears of equal variance takes |g|^2 (Rao 1973, "Linear statistical inference and its
applications", chapter 6e), whose mean is then sigma^2 tr F, with sigma^2 = |P r|^2 / (rows - rank).
R = |g|^2 / (sigma^2 tr F) times d = (tr F)^2 / tr F^2 has about a chi-square distribution with d
degrees of freedom (Satterthwaite 1946).

Points are eliminated first (:mod:`bundle.model.point_elimination`). Poses and lenses follow by
their eigenvalues above 1e-12 of the largest; the gauge makes seven of them zero.

Any part of the observations gives a valid test. Large problems are tested on the images that share
most points with the image of the most observations, and on an even choice of their points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.model.cameras import param_kinds
from bundle.model.point_elimination import SINGULAR, eliminate_points, part_of_observations
from bundle.model.problem import Problem
from bundle.model.reprojection import linearize

MOST_IMAGES = 80
MOST_POINTS = 3000

_Floats = NDArray[np.float64]
_Rows = NDArray[np.int64]


class ShearScore(NamedTuple):
    """Result of the test.

    Attributes:
        ratio: R, 1 in the mean without shear; NaN if nothing can be tested.
        freedom: degrees of freedom d; 0 if nothing can be tested.
    """

    ratio: float
    freedom: float


def shear_score(
    problem: Problem,
    rows: _Rows,
    position: _Floats,
    residual: _Floats,
    refine: tuple[str, ...] = ("focal", "extra"),
) -> ShearScore:
    """Return the test of some observations.

    Args:
        problem: the fitted problem.
        rows: observations without outliers and repeated measurements, ascending.
        position: (rows, 2) projections relative to the centre of the image, in any unit.
        residual: (rows, 2) projection minus measurement.
        refine: kinds of lens parameters that the fit refined.
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
        ratio=float(scores @ scores) / (variance * trace),
        freedom=trace**2 / float((f**2).sum()),
    )
