r"""Residuals of some images after the projection orthogonal to poses and intrinsics.

An error of a lens or of a motion leaves a field of residuals, and poses and intrinsics have
absorbed a part of it. What remains is orthogonal to their derivatives. A candidate column a (the
derivative of the residuals w.r.t. a missing parameter) must lose the same part before it is
compared: by the theorem of Frisch, Waugh and Lovell the coefficient of a in a joint least-squares
fit with the columns B is that of the regression of (I - P) r on (I - P) a, where P projects onto B.
Here B has the six columns of the pose of each image, and the focal and distortion columns of each
camera. The projections are successive, which is exact: first the poses, image by image, from all
columns, then what remains of the intrinsics, camera by camera. Points are not projected out: their
errors differ from point to point and act as noise.

A column of one image only, a_i, is zero in all other rows. With an orthonormal basis Q of the
intrinsics of a camera and its rows Q_i, a_i^T (I - Q Q^T) a_i = a_i^T a_i - (Q_i^T a_i)^2.

Columns are functions of the projected position, not of the measured one, whose noise would
correlate with the residual. With (x, y) the position from the principal point in halves of the
longer side and rho^2 = x^2 + y^2, the candidate fields of a lens are

    r2 = (x, y) rho^2,  r4 = (x, y) rho^4,  r6 = (x, y) rho^6,
    t1 = (rho^2 + 2 x^2, 2 x y),  t2 = (2 x y, rho^2 + 2 y^2),  a = (x, -y):

further radial terms, tangential distortion (a displaced principal point looks like it, because
rotations absorb the rest), and different focal lengths in x and y. Those of an image are

    s = (x, y),  a = (x, -y),  h = (y, x):

scale, anisotropy and shear, the linear fields without rotation.

At most 100 images with at most 400 observations each take part, spread evenly.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.records import dataclass
from bundle.judging.findings.measured import Measured, principal_points
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import linearize

LENS_TERMS = ("r2", "r4", "r6", "t1", "t2", "a")
IMAGE_TERMS = ("s", "a", "h")
MOST_IMAGES = 100
MOST_PER_IMAGE = 400
LEFT = 0.05  # remaining share of a field below which it counts as absorbed by poses and intrinsics
FEWEST = 30  # clean observations from which an image takes part

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ImageRows:
    """Clean observations of one image."""

    image: int  # index of the image
    camera: int  # index of its camera
    rows: slice  # slice of the arrays of :class:`SystematicResiduals`


class SystematicResiduals:
    """Residuals and candidate fields of the clean observations of some images.

    Attributes:
        problem: the problem.
        images: images that take part, by index.
        num_rows: (m,) number of observations of each image.
        image_of_row: (n,) place in ``images`` of each observation.
        observations: (n,) indices of their observations, sorted by image.
        camera: (n,) index of the camera of each observation.
        xy: (n, 2) projected positions from the principal point, in halves of the longer side.
    """

    def __init__(self, measured: Measured) -> None:
        problem = measured.problem
        chosen, images = _chosen(measured)
        self._selected = problem.select(observations=chosen).problem
        self._order = np.argsort(self._selected.observation_image, kind="stable")
        self._cheirality = measured.options.cheirality
        image = self._selected.observation_image[self._order]
        starts = np.searchsorted(image, images)
        ends = np.searchsorted(image, images, side="right")
        self.problem = problem
        self.images = [
            ImageRows(int(one), int(problem.image_camera[one]), slice(int(start), int(end)))
            for one, start, end in zip(images, starts, ends, strict=True)
        ]
        self.num_rows = ends - starts
        self.image_of_row = np.repeat(np.arange(len(images)), self.num_rows)
        self.observations = np.flatnonzero(chosen)[self._order]
        self.camera = problem.image_camera[image].astype(np.int64)
        self._residuals: Floats = measured.residuals[self.observations]
        projected = problem.observation_xy[self.observations] + self._residuals
        self.xy = _lens_coordinates(problem, self.camera, projected)

    @cached_property
    def _joint(self) -> tuple[Floats, int]:
        """Columns without poses (n, 2, m): intrinsics, fields of lens and image, residual."""
        pose, params = self.derivatives
        x, y = self.xy.T
        image = np.stack([np.stack(one, axis=1) for one in ((x, y), (x, -y), (y, x))], axis=2)
        joint = np.concatenate(
            [params, self.lens_columns, image, self._residuals[:, :, None]], axis=2
        )
        for one in self.images:
            joint[one.rows] = remove(joint[one.rows], pose[one.rows])
        return joint, params.shape[2]

    @cached_property
    def _bases(self) -> Floats:
        """(n, 2, k) orthonormal basis of the intrinsics of each camera; zero columns beyond."""
        joint, count = self._joint
        bases = np.zeros((len(joint), 2, count))
        for own in self._rows_of_cameras:
            basis = orthonormal(joint[own, :, :count])
            bases[own, :, : basis.shape[2]] = basis
        return bases

    @cached_property
    def _rows_of_cameras(self) -> list[Indices]:
        order = np.argsort(self.camera, kind="stable")
        if not len(order):
            return []
        return np.split(order, np.flatnonzero(np.diff(self.camera[order])) + 1)

    def _without_intrinsics(self, columns: Floats) -> Floats:
        left = columns.copy()
        for own in self._rows_of_cameras:
            basis = self._bases[own].reshape(2 * len(own), -1)
            part = columns[own].reshape(2 * len(own), -1)
            left[own] = (part - basis @ (basis.T @ part)).reshape(left[own].shape)
        return left

    @cached_property
    def lens_fields(self) -> Floats:
        """(n, 2, 6) candidate fields of a lens, without poses and intrinsics."""
        joint, first = self._joint
        return self._without_intrinsics(joint[:, :, first : first + len(LENS_TERMS)])

    @cached_property
    def residuals(self) -> Floats:
        """(n, 2) residuals without poses and intrinsics [px]."""
        return self._without_intrinsics(self._joint[0][:, :, -1:])[:, :, 0]

    @cached_property
    def residuals_without_lens(self) -> Floats:
        """(n, 2) residuals without the field that is common to the images of each lens [px]."""
        left = self.residuals.copy()
        for _, rows in self.lenses:
            fields = self.lens_fields[rows]
            remains = is_left(fields, self.lens_columns)
            if remains.any() and 2 * len(fields) > len(LENS_TERMS):
                left[rows] = remove(left[rows][:, :, None], fields[:, :, remains])[:, :, 0]
        return left

    @cached_property
    def lenses(self) -> list[tuple[str, NDArray[np.bool_]]]:
        """Model, and (n,) mask of the observations, of each camera model and image size."""
        problem = self.problem
        found: dict[tuple[str, int, int], list[int]] = {}
        for camera in distinct(self.camera).tolist():
            width, height = problem.camera_sizes[camera].tolist()
            found.setdefault((problem.camera_models[camera], width, height), []).append(camera)
        return [(key[0], np.isin(self.camera, cameras)) for key, cameras in found.items()]

    def explained(self, one: ImageRows, columns: Floats) -> float:
        """Return the sum of squares of an image's residuals that columns (rows, 2, m) explain."""
        fields = remove(columns, self.derivatives[0][one.rows])
        residual = self.residuals_without_lens[one.rows][:, :, None]
        return float((residual**2).sum() - (remove(residual, fields) ** 2).sum())

    @cached_property
    def lens_columns(self) -> Floats:
        """(n, 2, 6) candidate fields of a lens."""
        x, y = self.xy.T
        square = x * x + y * y
        outwards = np.stack([x, y], axis=1)
        radial = [outwards * square[:, None] ** power for power in (1, 2, 3)]
        tangential = [
            np.stack([square + 2 * x * x, 2 * x * y], axis=1),
            np.stack([2 * x * y, square + 2 * y * y], axis=1),
        ]
        return np.stack([*radial, *tangential, np.stack([x, -y], axis=1)], axis=2)

    @cached_property
    def image_fields(self) -> Floats:
        """(n, 2, 3) fields of an image without its pose."""
        joint, first = self._joint
        first += len(LENS_TERMS)
        return joint[:, :, first : first + len(IMAGE_TERMS)]

    @cached_property
    def image_normals(self) -> Floats:
        """(m, 3, 3) products of the fields of each image without intrinsics."""
        normals = np.zeros((len(self.images), len(IMAGE_TERMS), len(IMAGE_TERMS)))
        for place, one in enumerate(self.images):
            flat = self.image_fields[one.rows].reshape(-1, len(IMAGE_TERMS))
            lost = self._bases[one.rows].reshape(len(flat), -1).T @ flat
            normals[place] = flat.T @ flat - lost.T @ lost
        return normals

    def sums(self, values: Floats) -> Floats:
        """Return the sums (m, ...) of values (n, ...) over the rows of each image."""
        starts = np.cumsum(self.num_rows) - self.num_rows
        last = np.zeros((1, *values.shape[1:]))  # for images without rows at the end
        found: Floats = np.add.reduceat(np.concatenate([values, last]), starts)
        found[self.num_rows == 0] = 0.0
        return found

    @cached_property
    def derivatives(self) -> tuple[Floats, Floats]:
        """(n, 2, 6) by the pose, and (n, 2, k) by focal lengths and distortion."""
        found = linearize(self._selected, self._cheirality)
        width = self.problem.camera_params.shape[1]
        free = np.zeros((self.problem.num_cameras, width), bool)
        for camera in distinct(self.camera).tolist():
            kinds = param_kinds(self.problem.camera_models[camera])
            free[camera, : len(kinds)] = [kind in ("focal", "extra") for kind in kinds]
        params = found.d_params[self._order] * free[self.camera][:, None, :]
        return found.d_pose[self._order], params[:, :, free.any(axis=0)]


def _is_first(problem: Problem) -> NDArray[np.bool_]:
    """Return the mask of distinct observations: a feature that was detected twice counts once.

    Positions are compared to a tenth of a pixel.
    """
    xy = np.nan_to_num(problem.observation_xy)
    x, y = np.clip(np.rint(xy * 10.0), -(2**20), 2**20 - 1).astype(np.int64).T
    code = (problem.observation_image.astype(np.int64) << 42) + ((x + 2**20) << 21) + (y + 2**20)
    first = np.zeros(len(code), bool)
    first[np.unique(code, return_index=True)[1]] = True
    return first


def is_left(columns: Floats, before: Floats) -> NDArray[np.bool_]:
    """Return the mask of the fields (n, 2, m) of which 5 % or more are left of those before."""
    size, whole = (np.sqrt((one**2).mean(axis=(0, 1))) for one in (columns, before))
    return np.asarray(size > LEFT * whole)


def orthonormal(columns: Floats) -> Floats:
    """Return an orthonormal basis of the space of columns (n, 2, m), without null directions."""
    flat = columns.reshape(-1, columns.shape[2])
    norm = np.linalg.norm(flat, axis=0)
    flat = flat[:, norm > 0] / norm[norm > 0]
    if not flat.size:
        return np.zeros((len(columns), 2, 0))
    left, values, _ = np.linalg.svd(flat, full_matrices=False)
    return left[:, values > 1e-7 * values[0]].reshape(len(columns), 2, -1)


def remove(columns: Floats, base: Floats) -> Floats:
    """Return columns (n, 2, m) without their projections onto a base (n, 2, q)."""
    basis = orthonormal(base).reshape(2 * len(base), -1)
    flat = columns.reshape(2 * len(columns), -1)
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(columns.shape))


def _lens_coordinates(problem: Problem, camera: Indices, xy: Floats) -> Floats:
    """Return (n, 2) positions from the principal point, in halves of the longer image side."""
    offset = xy - principal_points(problem, camera)
    half = problem.camera_sizes.max(axis=1) / 2.0
    if not (half > 0).all():  # sizes are unknown in BAL
        half = np.where(half > 0, half, max(float(np.abs(offset).max(initial=0.0)), 1e-9))
    return np.asarray(offset / half[camera][:, None], np.float64)


def _chosen(measured: Measured) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return the mask of the observations and the indices of the images that take part."""
    problem = measured.problem
    usable = measured.is_clean & measured.counted & _is_first(problem)
    count = np.bincount(problem.observation_image[usable], minlength=problem.num_images)
    images = np.flatnonzero(count >= FEWEST)
    if len(images) > MOST_IMAGES:
        images = images[np.linspace(0, len(images) - 1, MOST_IMAGES).astype(np.int64)]
    step = np.zeros(problem.num_images, np.int64)
    step[images] = -(-count[images] // MOST_PER_IMAGE)
    of_observation = step[problem.observation_image]
    # Points are numbered without regard to their places in an image.
    kept = problem.observation_point % np.maximum(of_observation, 1) == 0
    return usable & (of_observation > 0) & kept, images
