"""The information of a problem by dense linear algebra: Jacobians by complex steps of formulas.

Columns: (w, t) of every variable pose (images of their own, then frames, then sensors), parameters
of every camera, points. Rows are weighted by sigmas and losses.
"""

import numpy as np
from scipy import optimize
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
        self.prior_sizes = []  # rows of each prior
        self.residual = self.residuals(np.zeros(len(self.names)))
        self.jacobian = self.derivatives()
        s = (self.residual.reshape(-1, 2) ** 2).sum(axis=1)
        sigma = 1.0 if problem.observation_sigma is None else problem.observation_sigma
        self.rho_prime = np.broadcast_to(rho_prime(loss, loss_scale, s / sigma**2), s.shape)
        self.weigh(np.repeat(np.broadcast_to(np.sqrt(self.rho_prime) / sigma, s.shape), 2))
        # Along the residual a loss counts as rho' + 2 rho'' s, here beside rho'.
        self.along = along_residual(loss, s / (loss_scale * sigma) ** 2)

    def derivatives(self):
        """By complex steps, one for a coordinate of all poses, sensors, cameras or points.

        An observation depends on one of each.
        """
        problem, image = self.problem, self.problem.observation_image
        padded = np.append(problem.image_sensor, np.full(problem.num_images, -1))
        frame, sensor = self.frame[image], padded[image]
        of = {
            ("image", "frame"): [
                ("image", i) if f < 0 else ("frame", f) for i, f in zip(image, frame, strict=True)
            ],
            ("sensor",): [
                ("sensor", s) if f >= 0 and s >= 0 else None
                for f, s in zip(frame, sensor, strict=True)
            ],
            ("camera",): [("camera", c) for c in problem.image_camera[image]],
            ("point",): [("point", p) for p in problem.observation_point],
        }
        jacobian = np.zeros((len(image), 2, len(self.names)))
        for kinds, seen in of.items():
            for k in {name[2] for name in self.names if name[0] in kinds}:
                step = np.array([(n[0] in kinds and n[2] == k) * 1e-30j for n in self.names])
                slopes = self.residuals(step).imag.reshape(-1, 2) / 1e-30
                for row, name in enumerate(seen):
                    if name is not None:
                        jacobian[row, :, self.column[(*name, k)]] = slopes[row]
        return jacobian.reshape(-1, len(self.names))

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
        self.prior_sizes.append(len(residual))
        self.residual = np.concatenate([self.residual, residual])
        self.jacobian = np.vstack([self.jacobian, jacobian])

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
        if sandwich:
            _, (rows, residual, by_weights, root, _) = self._sandwich(basis, num_priors)
            rows = scores(rows, residual, by_weights, num_priors)
        else:
            rows, root, _ = self._weights(basis)
        inverse = root @ root.T
        variance = np.diag(inverse @ (rows.T @ rows) @ inverse)
        sums = (np.abs(rows) @ np.abs(inverse)) ** 2
        return np.finfo(float).eps * (sums.sum(axis=0) / variance).max()

    def covariance(self, basis, *, sandwich=False, num_priors=0):
        """Return the covariance of all columns; those that are not free have none.

        ``basis``: (columns, unknowns), a column of the identity for each that is free, or sums of
        such. ``num_priors``: last rows, which enter the sandwich by their information.
        """
        if not sandwich:
            _, root, _ = self._weights(basis)
            return basis @ root @ root.T @ basis.T
        curvature, given = self._sandwich(basis, num_priors)
        of_point = basis[self.column["point", 0, 0] :].any(axis=0)
        whole = scatter(*given, of_point, num_priors, curvature, self.rho_prime)
        project = np.eye(len(whole)) - given[-1] @ given[-1].T
        return basis @ project @ whole @ project @ basis.T

    def _weights(self, basis, curvature=1.0, num_priors=0):
        """J, a root of the inverse of H and a basis of its null space."""
        rows = self.jacobian @ basis
        rows[: len(rows) - num_priors] *= np.sqrt(curvature)
        return rows, *_root_of_inverse(rows, np.linalg.pinv(basis) @ self.similarities())

    def curvature(self, basis):
        """kappa, by the matrices of its equation."""
        if (self.along == 1).all():
            return 1.0
        rows, root, _ = self._weights(basis)
        rest, axes = leverages(rows[: 2 * len(self.along)], root)
        says = rest > 0.01
        with np.errstate(divide="ignore"):
            ratio = np.where(says, np.maximum(1 - rest, 0) / rest, 0)
        k = np.einsum("nij,nj,nkj->nik", axes, ratio, axes)
        r = self.residual[: 2 * len(rest)].reshape(-1, 2)
        unit = r / np.maximum(np.linalg.norm(r, axis=1, keepdims=True), 1e-300)
        d = np.eye(2) + np.einsum("n,ni,nj->nij", self.along - 1, unit, unit)
        found = np.linalg.eigvals(d @ k).real.ravel()
        known = np.maximum(1 - rest, 0)[says].sum()

        def over(kappa, values):
            return (values / (kappa + values)).sum() - known

        for values, least in ((found, -found.min()), (np.maximum(found, 0), 0)):
            grid = 0.95 ** np.arange(135)
            grid = grid[grid > max(least, 1e-3)]
            enough = [kappa for kappa in grid if over(kappa, values) >= 0]
            if enough:
                return optimize.brentq(over, enough[0], enough[0] / 0.95, (values,), xtol=1e-15)
        raise SingularError

    def _sandwich(self, basis, num_priors):
        """Arguments of scores and scatter: J, r, roots of inverses by weights and of H, null."""
        curvature = self.curvature(basis)
        rows, by_weights, _ = self._weights(basis)
        _, root, null = self._weights(basis, curvature, num_priors)
        return curvature, (rows, self.residual, by_weights, root, null)


def leverages(rows, root):
    """Eigenvalues (n, 2) and eigenvectors of I - h, h = J A A^T J^T, of every observation."""
    seen = (rows @ root).reshape(-1, 2, root.shape[1])
    return np.linalg.eigh(np.eye(2) - np.einsum("nik,njk->nij", seen, seen))


def scores(rows, residual, by_weights, num_priors):
    """Rows whose squares sum up to M: shares of corrected residuals, and the rows of priors."""
    observed = len(rows) - num_priors
    rest, axes = leverages(rows[:observed], by_weights)
    with np.errstate(invalid="ignore", divide="ignore"):
        factors = np.where(rest > 0.01, 1 / np.sqrt(rest), 0)
    r = residual[:observed].reshape(-1, 2)
    r = np.einsum("nij,nj,nkj,nk->ni", axes, factors, axes, r)
    shares = np.einsum("nij,ni->nj", rows[:observed].reshape(len(r), 2, -1), r)
    return np.vstack([shares, rows[observed:]])


def scatter(
    rows, residual, by_weights, root, null, of_point, num_priors=0, curvature=1.0, rho_prime=None
):
    """Covariance of cameras by their scatter and of points given the cameras, unconstrained.

    ``by_weights`` and ``root``: A with A A^T = H^+, without and with the curvature; ``null``: basis
    of its null space; ``of_point``: columns.
    """
    observed = len(residual) - num_priors
    of_scores, inverse = scores(rows, residual, by_weights, num_priors), root @ root.T
    points, cameras = np.flatnonzero(of_point), np.flatnonzero(~of_point)
    own, _ = np.linalg.qr(null[cameras])
    without = np.eye(len(cameras)) - own @ own.T
    of_cameras = (inverse @ of_scores.T @ of_scores @ inverse)[np.ix_(cameras, cameras)]
    bent = rows.copy()
    bent[:observed] *= np.sqrt(curvature)
    h = bent.T @ bent
    solved = np.zeros((len(points), len(points)))
    for k in range(0, len(points), 3):
        block = h[np.ix_(points[k : k + 3], points[k : k + 3])]
        solved[k : k + 3, k : k + 3] = np.linalg.pinv(block, rcond=1e-12, hermitian=True)
    weights = np.ones(observed // 2) if rho_prime is None else rho_prime
    counts = weights > 0
    rest = leverages(rows[:observed], by_weights)[0].sum(axis=1)[counts].sum()
    squares = (residual[:observed].reshape(-1, 2) ** 2).sum(axis=1) * weights
    variance = squares.sum() / rest if rest > 0.01 else 1.0
    plain = rows[:observed, points].reshape(len(counts), 2, -1)[counts]
    plain = plain / np.sqrt(weights[counts])[:, None, None]
    expected = variance * np.einsum("nij,nik->jk", plain, plain)
    expected += rows[observed:, points].T @ rows[observed:, points]
    lift = np.zeros((len(of_point), len(cameras)))
    lift[cameras] = np.eye(len(cameras))
    lift[points] = -solved @ h[np.ix_(points, cameras)]
    whole = lift @ without @ of_cameras @ without @ lift.T
    whole[np.ix_(points, points)] += solved @ expected @ solved
    return whole


def _root_of_inverse(jacobian, similarities):
    """A with A A^T the pseudo-inverse of J^T J, by singular values of a J of comparable columns,
    and an orthonormal basis of its null space.

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
    return root - null @ (null.T @ root), null


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


def along_residual(loss, u):
    """(rho' + 2 rho'' s) / rho' by u = s / scale^2; 1 where rho' = 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return {
            "trivial": lambda: np.ones_like(u),
            "huber": lambda: (u <= 1).astype(float),
            "soft_l1": lambda: 1 / (1 + u),
            "cauchy": lambda: (1 - u) / (1 + u),
            "arctan": lambda: 1 - 4 * u**2 / (1 + u**2),
            "tukey": lambda: np.where(u < 1, 1 - 4 * u / (1 - u), 1),
        }[loss]()
