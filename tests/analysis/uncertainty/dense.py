"""The information of a problem by dense linear algebra: Jacobians by complex steps of formulas.

Columns: (w, t) of every variable pose (images of their own, then frames, then sensors), parameters
of every camera, points. Rows are weighted by sigmas and losses.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.scenes import exp, project


class SingularError(ValueError):
    """More than similarities of the world is free."""


class Dense:
    """J, r and names of the columns: (kind, index, coordinate)."""

    def __init__(self, problem, *, loss="trivial", loss_scale=1.0):
        self.problem = problem
        self.frame = np.append(problem.image_frame, np.full(problem.num_images, -1))
        own = [i for i in range(problem.num_images) if self.frame[i] < 0]
        poses = [("image", i) for i in own]
        poses += [("frame", i) for i in range(len(problem.rig_from_world))]
        poses += [("sensor", i) for i in range(len(problem.sensor_from_rig))]
        self.names = [(kind, i, k) for kind, i in poses for k in range(6)]
        self.names += [
            ("camera", c, j)
            for c in range(problem.num_cameras)
            for j in range(problem.camera_params.shape[1])
        ]
        self.names += [("point", p, k) for p in range(problem.num_points) for k in range(3)]
        self.column = {name: j for j, name in enumerate(self.names)}
        self.starts = {}
        for kind, rows in (
            ("image", problem.cam_from_world),
            ("frame", problem.rig_from_world),
            ("sensor", problem.sensor_from_rig),
        ):
            for i, row in enumerate(rows):
                if (kind, i) in poses:
                    self.starts[kind, i] = Rotation.from_quat(row[:4]).as_matrix(), row[4:]
        self.residual = self.residuals(np.zeros(len(self.names)))
        self.jacobian = np.empty((self.residual.size, len(self.names)))
        for j in range(len(self.names)):
            step = np.zeros(len(self.names), complex)
            step[j] = 1e-30j
            self.jacobian[:, j] = self.residuals(step).imag / 1e-30
        s = (self.residual.reshape(-1, 2) ** 2).sum(axis=1)
        sigma = 1.0 if problem.observation_sigma is None else problem.observation_sigma
        weight = np.sqrt(rho_prime(loss, loss_scale, s / sigma**2)) / sigma
        self.weigh(np.repeat(np.broadcast_to(weight, s.shape), 2))
        # Along the residual a loss counts as rho' + 2 rho'' s, here beside rho'.
        ratio = (loss_scale * sigma) ** 2 / s
        curvature = {
            "trivial": lambda: np.ones_like(s),
            "huber": lambda: (ratio >= 1).astype(float),
            "soft_l1": lambda: ratio / (ratio + 1),
        }
        self.along = curvature[loss]() if loss in curvature else None

    def weigh(self, weight):
        self.residual = self.residual * weight
        self.jacobian = self.jacobian * weight[:, None]

    def pose(self, x, kind, i):
        j = self.column[kind, i, 0]
        rotation, translation = self.starts[kind, i]
        return exp(x[j : j + 3]) @ rotation, translation + x[j + 3 : j + 6]

    def image(self, x, i):
        problem = self.problem
        if self.frame[i] < 0:
            return self.pose(x, "image", i)
        rotation, translation = self.pose(x, "frame", self.frame[i])
        if problem.image_sensor[i] < 0:
            return rotation, translation
        turn, shift = self.pose(x, "sensor", problem.image_sensor[i])
        return turn @ rotation, turn @ translation + shift

    def residuals(self, x):
        problem = self.problem
        result = np.empty((problem.num_observations, 2), x.dtype)
        first = self.column["point", 0, 0]
        points = problem.points + x[first:].reshape(-1, 3)
        width = problem.camera_params.shape[1]
        for i in range(problem.num_images):
            rows = np.flatnonzero(problem.observation_image == i)
            rotation, translation = self.image(x, i)
            camera = problem.image_camera[i]
            j = self.column["camera", camera, 0]
            params = problem.camera_params[camera] + x[j : j + width]
            seen = points[problem.observation_point[rows]] @ rotation.T + translation
            xy = project(problem.camera_models[camera], params, seen)
            result[rows] = xy - problem.observation_xy[rows]
        return result.ravel()

    def add(self, residual, rows):
        """Add rows of a prior, whitened: {column name: coefficients}."""
        jacobian = np.zeros((len(residual), len(self.names)))
        for name, values in rows.items():
            jacobian[:, self.column[name]] = values
        self.residual = np.concatenate([self.residual, residual])
        self.jacobian = np.vstack([self.jacobian, jacobian])

    def _bent(self):
        """J of the second derivatives of the loss."""
        observed = 2 * len(self.along)
        unit = self.residual[:observed].reshape(-1, 2)
        unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
        rows = self.jacobian[:observed].reshape(-1, 2, len(self.names))
        part = np.einsum("ni,nij->nj", unit, rows)
        shrink = np.sqrt(self.along) - 1
        rows = rows + np.einsum("n,ni,nj->nij", shrink, unit, part)
        return np.vstack([rows.reshape(observed, -1), self.jacobian[observed:]])

    def similarities(self):
        """Derivatives of the columns, constant ones included, by the similarities of the world."""
        n = np.zeros((len(self.names), 7))
        for (kind, i), (rotation, translation) in self.starts.items():
            j = self.column[kind, i, 0]
            n[j + 3 : j + 6, 6] = translation
            if kind != "sensor":
                n[j + 3 : j + 6, :3] = -rotation
                n[j : j + 3, 3:6] = -rotation
        for i, point in enumerate(self.problem.points):
            j = self.column["point", i, 0]
            n[j : j + 3, :3] = np.eye(3)
            n[j : j + 3, 3:6] = np.cross(np.eye(3), point).T
            n[j : j + 3, 6] = point
        return n

    def rounding(self, basis, *, sandwich=False, num_priors=0):
        """Relative tolerance of variances: rounding of the sums of squares H and M.

        A sum A^T A in floating point is off by up to eps |A|^T |A|, entry by entry; between two
        inverses of H, which may cancel, that is eps |H^+| |A|^T |A| |H^+|.
        """
        j = (self._bent() if sandwich else self.jacobian) @ basis
        root = _root_of_inverse(j, np.linalg.pinv(basis) @ self.similarities())
        inverse = root @ root.T
        rows = self._scores(basis, num_priors) if sandwich else j
        variance = np.diag(inverse @ (rows.T @ rows) @ inverse)
        sums = (np.abs(rows) @ np.abs(inverse)) ** 2
        return np.finfo(float).eps * (sums.sum(axis=0) / variance).max()

    def _scores(self, basis, num_priors):
        """Rows whose squares sum up to M."""
        observed = len(self.residual) - num_priors
        weighted = (self.jacobian[:observed] @ basis) * self.residual[:observed, None]
        return np.vstack(
            [weighted.reshape(-1, 2, basis.shape[1]).sum(axis=1), self.jacobian[observed:] @ basis]
        )

    def covariance(self, basis, *, sandwich=False, num_priors=0):
        """Return the covariance of all columns; those that are not free have none.

        ``basis``: (columns, unknowns), a column of the identity for each that is free, or sums of
        such. ``num_priors``: last rows, which enter the sandwich by their information.
        """
        j = (self._bent() if sandwich else self.jacobian) @ basis
        root = _root_of_inverse(j, np.linalg.pinv(basis) @ self.similarities())
        inverse = root @ root.T
        if sandwich:
            scores = self._scores(basis, num_priors) @ root
            inverse = root @ (scores.T @ scores) @ root.T
        return basis @ inverse @ basis.T


def _root_of_inverse(jacobian, similarities):
    """A with A A^T the pseudo-inverse of J^T J, by singular values of a J of comparable columns.

    Vectors of small singular values are known to rounding over their distance from zero only, 1e-11
    and less beside a weak mode. The null space is therefore that of the similarities, exactly.
    """
    scale = 1 / np.sqrt((jacobian**2).sum(axis=0))
    _, values, vectors = np.linalg.svd(jacobian * scale)
    values = np.append(values, np.zeros(len(vectors) - len(values)))
    seen = values > 1e-9 * values[0]
    similarities = similarities / np.sqrt((similarities**2).sum(axis=0) + 1e-300)
    _, moved, combinations = np.linalg.svd(jacobian @ similarities)
    degrees = (moved < 1e-9 * moved.max(initial=1e-9 * np.abs(jacobian).max())).sum()
    degrees = len(moved) if moved[0] < 1e-9 * np.abs(jacobian).max() else degrees
    if degrees != (~seen).sum():
        raise SingularError
    null, _ = np.linalg.qr(similarities @ combinations[len(combinations) - degrees :].T)
    root = scale[:, None] * vectors[seen].T / values[seen]
    return root - null @ (null.T @ root)


def rho_prime(loss, scale, s):
    b = scale**2
    with np.errstate(divide="ignore"):
        return {
            "trivial": lambda: np.ones_like(s),
            "huber": lambda: np.where(s <= b, 1, scale / np.sqrt(s)),
            "soft_l1": lambda: 1 / np.sqrt(1 + s / b),
            "cauchy": lambda: 1 / (1 + s / b),
            "arctan": lambda: 1 / (1 + s**2 / b**2),
            "tukey": lambda: np.where(s <= b, (1 - s / b) ** 2, 0),
        }[loss]()
