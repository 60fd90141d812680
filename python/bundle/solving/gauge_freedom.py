"""Gauge freedom of a problem, counted from its structure.

Images that share free points determine a rigid piece of the world up to a similarity. The piece
may move by d = (a, b, s), X' = X + a + b x X + s X. Its reprojections do not change if image i,
R X + t, moves by local coordinates (R' = Exp(phi) R, t' = t + tau)

    phi = -R b,    tau = s t - R a,

and the translation v of its twist, if its shutter rolls, by s v.

An image with its own pose can make this motion. An image of a rig, R = R_s R_f, t = R_s t_f + t_s,
moves with its frame and its sensor:

    phi = R_s phi_f + phi_s,    tau = R_s tau_f + phi_s x (R_s t_f) + tau_s.

For the images of a frame these equations are M_f u_f = D d - M_s u_s. A constant frame has no u_f.
Let P be the projection onto the complement of the range of M_f. The possible (d, u_s) are the null
space of these rows:

    P [D, -M_s]           for every frame,
    a + b x X + s X = 0   for every constant point X,
    L^T J                 for every factor; J: motion in the coordinates of its variables,
                          L L^T: its information. Points on planes and lines move from their feet,
                          because distances that are not zero would count as known lengths.

The gauge freedom is the dimension of this null space. It is 7 for images without factors, 6 if a
fixed baseline gives the scale, and 0 with priors that determine the world. It is larger if the
problem has pieces that nothing connects.

The count misses the further freedom of special geometry: critical configurations, and pieces that
only few points connect.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.components import component_roots
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem
from bundle.model.rigid_motions import cross_matrices, rotation_matrices
from bundle.solving.constraints.ends import HELD_POSITION, HELD_ROTATION, KnownPrior
from bundle.solving.request import place_at_priors

if TYPE_CHECKING:
    from typing import Unpack

    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.interface.option_keywords import SolveKeywords
    from bundle.solving.constraints.ends import Applied, Flatness
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

RANK_TOLERANCE = 1e-9
"""Threshold for zero singular values of columns that had norm 1 before the projection."""

_Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GaugeFreedom(Displayed):
    """Gauge freedom of the observations and factors of a problem.

    Attributes:
        degrees: number of degrees of freedom that nothing determines.
        num_pieces: number of pieces of the world that no free point connects.
        num_loose: number of these degrees that move sensors against their rigs while no image
            moves.
    """

    degrees: int
    num_pieces: int
    num_loose: int

    @property
    def sentence(self) -> str:
        """Describe the gauge freedom in words."""
        if self.degrees == 0:
            return "nothing is free: position, rotation and scale of the world are given"
        named = {6: " (position and rotation; the scale is given)", 7: " (a similarity)"}
        words = plural(self.degrees, "degree") + " of freedom"
        if self.num_pieces == 1 and not self.num_loose:
            words += named.get(self.degrees, "")
        pieces = f" of {self.num_pieces} pieces" if self.num_pieces > 1 else ""
        loose = f", {self.num_loose} of them of sensors on their rigs" if self.num_loose else ""
        return words + pieces + loose

    def _display(self) -> Display:
        return Display(title=f"Gauge freedom: {self.sentence}", facts=())


@takes_options(SolveOptions)
def gauge_freedom(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    constraints: Constraints | Iterable[str | Rule] = (),
    **changes: Unpack[SolveKeywords],
) -> GaugeFreedom:
    """Count the degrees of freedom of a solve that no observation, factor or fixed id determines.

    With ``gauge="none"`` only the damping of the trust region controls these degrees. The count
    assumes that intrinsics are determined.

    Args:
        problem: the problem, which is not changed; also the path of one, or a
            pycolmap.Reconstruction.
        options: options that say which parameters are refined and fixed; ``gauge`` has no effect.
        factors: factors in addition to the observations, as in :func:`bundle.solve`.
        priors: measured positions and attitudes of images, and control points.
        constraints: rules, as in :func:`bundle.solve`.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: an option, a factor or a rule is wrong.
        OSError: the path cannot be read.

    Example:
        >>> bundle.gauge_freedom("stereo_rig").degrees
        6
    """
    options = SolveOptions.of(options, changes, "gauge_freedom")
    from bundle.solving.constraints.resolve import apply  # slow to import

    placed = place_at_priors(as_problem(problem), tuple(factors), tuple(priors), None)
    start, applied = apply(constraints, placed.problem, options)
    held = () if applied is None else applied.fixed_point_ids
    options = options.replace(fixed_point_ids=(*options.fixed_point_ids, *held))
    return gauge_freedom_of(start, options, placed.factors, applied)


def gauge_freedom_of(
    problem: Problem, options: SolveOptions, factors: Iterable[Factor], applied: Applied | None
) -> GaugeFreedom:
    """Count the degrees of freedom of a solve, with all its factors."""
    return _counted(problem, options, factors, applied).result()


def can_shrink(
    problem: Problem, options: SolveOptions, factors: Iterable[Factor], applied: Applied
) -> bool:
    """Return True if points lie on planes and lines, and no factor determines the scale.

    The distances of a smaller world are smaller, so that other factors have to determine its scale.
    """
    return _counted(problem, options, factors, applied).can_scale()


def _counted(
    problem: Problem, options: SolveOptions, factors: Iterable[Factor], applied: Applied | None
) -> _Count:
    from bundle.solving.constraints.resolve import factor_of  # slow to import

    of_rules = set() if applied is None else set(map(id, applied.factors))
    others = [factor for factor in factors if id(factor) not in of_rules]
    count = _Count(problem, options)
    count.add_frames()
    count.add_held_points()
    if applied is not None:
        for prior, factor in zip(applied.priors, applied.factors, strict=True):
            if prior.normals:
                count.add_foot(prior)
            elif prior.flatness is not None:
                count.add_plane(prior.flatness)
            else:
                others.append(factor)
        held = (
            (HELD_ROTATION, "rotation", problem.cam_from_world),
            (HELD_POSITION, "position", problem.projection_centers),
        )
        for key, parts in applied.held_poses.items():
            for bit, name, values in held:
                if parts & bit:
                    value = tuple(values[problem.image_ids == key][0].tolist())
                    others.append(factor_of(KnownPrior(0, ("image", key), name, value, (1.0,) * 3)))
    if others:
        count.add_factors(others)
    return count


class _Count:
    """Rows and columns of the equations above: 7 columns per piece, then 6 per refined sensor."""

    def __init__(self, problem: Problem, options: SolveOptions) -> None:
        self._problem = problem
        self._find_free(options)
        self._find_pieces()
        poses = problem.cam_from_world
        self._rotations = rotation_matrices(poses[:, :4])
        seen = self._piece >= 0
        centers = problem.projection_centers[seen]
        middle = centers.mean(axis=0) if len(centers) else np.zeros(3)
        spread = np.sqrt(((centers - middle) ** 2).sum(axis=1).mean()) if len(centers) else 0.0
        if not spread > 0 and problem.num_points:
            spread = np.abs(problem.points - middle).max()
        self._middle, self._size = middle, float(spread) or 1.0
        # Poses in a world that is centred and scaled to size 1.
        moved = np.einsum("nij,j->ni", self._rotations, middle)
        self._translations = (poses[:, 4:] + moved) / self._size
        self._points = (problem.points - middle) / self._size
        self._width = 7 * self._num_pieces + 6 * int(self._sensor_is_free.sum())
        self._sensor_column = 7 * self._num_pieces + 6 * (np.cumsum(self._sensor_is_free) - 1)
        self._norms = np.zeros(self._width)
        self._triangle: _Matrix = np.zeros((0, self._width))
        self._waiting: list[_Matrix] = []

    def _find_free(self, options: SolveOptions) -> None:
        problem = self._problem
        fixed = np.isin(problem.image_ids, options.fixed_image_ids)
        self._image_is_free = ~fixed & ("poses" in options.refine)
        self._point_is_free = ~np.isin(problem.point_ids, options.fixed_point_ids) & (
            "points" in options.refine
        )
        observed = np.zeros(problem.num_images, bool)
        observed[problem.observation_image] = True
        self._observed = observed
        self._sensor_is_free = np.zeros(problem.num_sensors, bool)
        if not problem.num_frames:
            return
        frame = problem.image_frame
        held = np.zeros(problem.num_frames + 1, bool)  # the last entry: images without a frame
        held[frame[~self._image_is_free]] = True
        self._image_is_free = np.where(frame >= 0, ~held[frame], self._image_is_free)
        if not options.refine_sensor_from_rig:
            return
        references = observed & (frame >= 0) & (problem.image_sensor < 0)
        with_reference = problem.frame_rig_ids[frame[references]]
        seen = distinct(problem.image_sensor[observed & (problem.image_sensor >= 0)])
        self._sensor_is_free[seen] = True
        self._sensor_is_free &= np.isin(problem.sensor_rig_ids, with_reference)
        for rig, camera in options.fixed_sensors:
            self._sensor_is_free &= (problem.sensor_rig_ids != rig) | (
                problem.sensor_camera_ids != camera
            )

    def _find_pieces(self) -> None:
        """Number the pieces, which are sets of images that free points connect."""
        problem = self._problem
        free = np.flatnonzero(self._point_is_free[problem.observation_point])
        free = free[np.argsort(problem.observation_point[free], kind="stable")]
        images, points = problem.observation_image[free], problem.observation_point[free]
        starts = np.flatnonzero(np.diff(points, prepend=-1))
        roots = component_roots(images, starts, problem.num_images)
        self._piece = np.full(problem.num_images, -1)
        used, numbers = np.unique(roots[self._observed], return_inverse=True)
        self._piece[self._observed] = numbers
        self._num_pieces = len(used)
        self._piece_of_point = np.full(problem.num_points, -1)
        self._piece_of_point[points[starts]] = self._piece[images[starts]]

    def add_frames(self) -> None:
        """Add the equations of every frame and of every image with its own pose."""
        problem = self._problem
        images = np.flatnonzero(self._observed)
        frame = problem.image_frame if problem.num_frames else np.full(problem.num_images, -1)
        groups: dict[int, list[int]] = {}
        for image in images.tolist():
            key = int(frame[image])
            groups.setdefault(key if key >= 0 else -1 - image, []).append(image)
        for key, members in groups.items():
            wanted = np.vstack([self._image_rows(image) for image in members])
            self._norms += (wanted**2).sum(axis=0)
            if self._image_is_free[members[0]]:
                reached = np.vstack([self._frame_map(image, key >= 0) for image in members])
                basis = np.linalg.qr(reached)[0]
                wanted = wanted - basis @ (basis.T @ wanted)
                wanted = wanted - basis @ (basis.T @ wanted)
            self._add(wanted)

    def add_held_points(self) -> None:
        """Add the equations of constant points: the pieces that observe one cannot move it."""
        problem = self._problem
        held = ~self._point_is_free[problem.observation_point]
        pairs = np.stack(
            [self._piece[problem.observation_image[held]], problem.observation_point[held]], axis=1
        )
        for piece, point in distinct(pairs, axis=0).tolist():
            rows = np.zeros((3, self._width))
            rows[:, 7 * piece : 7 * piece + 7] = self._point_motion(self._points[point])
            self._norms += (rows**2).sum(axis=0)
            self._add(rows)

    def add_factors(self, factors: list[Factor]) -> None:
        """Add the equations of factors: their linearized residuals under the motions."""
        from bundle.graphs.factors.problem_factors import ProblemFactors  # slow to import

        for factor in factors:
            keys, information = ProblemFactors(self._problem, [factor]).information()
            motion = np.vstack([self._motion(kind, index, size) for kind, index, size in keys])
            values, vectors = np.linalg.eigh(information)
            seen = values > 1e-12 * max(values.max(), 0.0)
            rows = (np.sqrt(values[seen])[:, None] * vectors[:, seen].T) @ motion
            largest = np.abs(np.sqrt(values[seen])).max(initial=1.0)
            self._norms += ((rows / largest) ** 2).sum(axis=0)
            self._add(rows / largest)

    def add_foot(self, foot: KnownPrior) -> None:
        """Add the equations that keep a point on its plane or line."""
        (row,) = np.flatnonzero(self._problem.point_ids == foot.subject[1])
        place, normals = np.array(foot.value), np.array(foot.normals)
        self._add_points([int(row)], place[None], normals[:, None])

    def add_plane(self, plane: Flatness) -> None:
        """Add the equations that keep points on a plane of their own."""
        rows = np.flatnonzero(np.isin(self._problem.point_ids, plane.points))
        points = self._problem.points[rows]
        along, axes = plane.along(points)
        flat = points - along[:, 2:] * axes[2]
        jacobian = np.stack(plane(flat)[1], axis=1) * plane.sigma
        self._add_points(rows.tolist(), flat, jacobian)

    def _add_points(self, points: list[int], places: _Matrix, jacobian: _Matrix) -> None:
        """Add rows by the coordinates of points, (m, points, 3), which are at these places."""
        rows = np.zeros((len(jacobian), self._width))
        for point, place, by_point in zip(points, places, jacobian.swapaxes(0, 1), strict=True):
            piece = self._piece_of_point[point]
            if piece >= 0 and self._point_is_free[point]:
                moved = self._point_motion((place - self._middle) / self._size)
                rows[:, 7 * piece : 7 * piece + 7] += by_point @ moved
        self._add(rows)
        self._norms += (rows**2).sum(axis=0)

    def can_scale(self) -> bool:
        """Return True if the null space has a motion that scales a piece."""
        self._flush()
        scales = np.arange(6, 7 * self._num_pieces, 7)
        held = np.delete(self._triangle, scales, axis=1), np.delete(self._norms, scales)
        return _nullity(self._triangle, self._norms) > _nullity(*held)

    def result(self) -> GaugeFreedom:
        """Return the count."""
        self._flush()
        num_sensors = self._width - 7 * self._num_pieces
        loose = _nullity(self._triangle[:, self._width - num_sensors :], self._norms[-num_sensors:])
        return GaugeFreedom(
            degrees=_nullity(self._triangle, self._norms),
            num_pieces=self._num_pieces,
            num_loose=loose if num_sensors else 0,
        )

    def _image_rows(self, image: int) -> _Matrix:
        """Return [D, -M_s] of an image, with the rows of rotation first, then translation."""
        rows = np.zeros((6, self._width))
        rotation, translation = self._rotations[image], self._translations[image]
        column = 7 * self._piece[image]
        rows[3:, column : column + 3] = -rotation
        rows[:3, column + 3 : column + 6] = -rotation
        rows[3:, column + 6] = translation
        sensor = self._problem.image_sensor[image] if self._problem.num_frames else -1
        if sensor >= 0 and self._sensor_is_free[sensor]:
            arm = self._problem.sensor_from_rig[sensor, 4:] / self._size
            column = self._sensor_column[sensor]
            rows[:3, column : column + 3] = -np.eye(3)
            rows[3:, column : column + 3] = cross_matrices(translation - arm)
            rows[3:, column + 3 : column + 6] = -np.eye(3)
        return rows

    def _frame_map(self, image: int, is_frame: bool) -> _Matrix:
        """Return M_f of an image; the identity if the image has its own pose."""
        sensor = self._problem.image_sensor[image] if is_frame else -1
        turn = np.eye(3)
        if sensor >= 0:
            turn = rotation_matrices(self._problem.sensor_from_rig[sensor : sensor + 1, :4])[0]
        return np.asarray(np.kron(np.eye(2), turn), np.float64)

    def _motion(self, kind: str, index: int, size: int) -> _Matrix:
        """Return the (size, width) motion of a variable, in its tangent coordinates, per column."""
        problem = self._problem
        if kind == "image" and self._piece[index] >= 0:
            rows = self._image_rows(index)
            rows[:, 7 * self._num_pieces :] = 0  # pieces alone determine the motion of images
            return self._in_frame_of(problem.cam_from_world[index], rows, self._middle)
        if kind == "frame":
            images = np.flatnonzero(self._observed & (problem.image_frame == index)).tolist()
            if images and self._image_is_free[images[0]]:
                wanted = np.vstack([self._image_rows(image) for image in images])
                reached = np.vstack([self._frame_map(image, True) for image in images])
                rows = np.asarray(np.linalg.lstsq(reached, wanted, rcond=None)[0], np.float64)
                return self._in_frame_of(problem.rig_from_world[index], rows, self._middle)
        if kind == "sensor" and self._sensor_is_free[index]:
            column = self._sensor_column[index]
            rows = np.zeros((6, self._width))
            rows[:, column : column + 6] = np.eye(6)
            return self._in_frame_of(problem.sensor_from_rig[index], rows, np.zeros(3))
        motion = np.zeros((size, self._width))
        shutter = problem.rolling_shutter
        if kind == "twist" and shutter is not None and self._piece[index] >= 0:
            motion[3:, 7 * self._piece[index] + 6] = shutter.twist[index, 3:]
            return motion
        if kind == "point" and self._point_is_free[index] and self._piece_of_point[index] >= 0:
            piece = self._piece_of_point[index]
            motion[:, 7 * piece : 7 * piece + 7] = (
                self._point_motion(self._points[index]) * self._size
            )
        return motion

    def _in_frame_of(self, pose: _Matrix, rows: _Matrix, middle: _Matrix) -> _Matrix:
        """Convert local coordinates about the middle to those of X Exp(d), in the problem's unit.

        Let t_m = t + R m be the translation about the middle. Then tau = tau_m - phi x R m and
        d = (R^T phi, R^T tau).
        """
        rotation = rotation_matrices(pose[None, :4])[0]
        turn, shift = rows[:3], self._size * rows[3:]
        shift = shift + cross_matrices(rotation @ middle) @ turn
        return np.vstack([rotation.T @ turn, rotation.T @ shift])

    def _point_motion(self, point: _Matrix) -> _Matrix:
        return np.hstack([np.eye(3), -cross_matrices(point), point[:, None]])

    def _add(self, rows: _Matrix) -> None:
        self._waiting.append(rows)
        if sum(map(len, self._waiting)) > 6 * self._width + 600:
            self._flush()

    def _flush(self) -> None:
        """Reduce the rows by QR to a triangle with the same null space."""
        if self._waiting:
            rows = np.vstack([self._triangle, *self._waiting])
            self._triangle = np.asarray(np.linalg.qr(rows, mode="r"))
            self._waiting = []


def _nullity(rows: _Matrix, squares: _Matrix) -> int:
    """Return the number of columns that depend on the others, after scaling each to norm 1."""
    width = int(rows.shape[1])
    if not width:
        return 0
    scaled = rows / np.sqrt(np.where(squares > 0, squares, 1.0))
    values = np.linalg.svd(scaled, compute_uv=False)
    return width - int((values > RANK_TOLERANCE).sum())
