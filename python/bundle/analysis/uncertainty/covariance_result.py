"""Covariances by the ids of images, points and cameras, or of poses of a graph; their file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import FrozenArrays, no_rows
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.errors import InputError, brief
from bundle.interface.option_fields import choice
from bundle.io.atomic import atomic_write as atomic
from bundle.model.problem import Problem
from bundle.model.rigid_motions import center_jacobians

if TYPE_CHECKING:
    import pandas

_AXES = {3: ("x", "y", "z"), 6: ("wx", "wy", "wz", "tx", "ty", "tz")}
_GRAPH_AXES = {3: ("x", "y", "angle"), 6: ("wx", "wy", "wz", "x", "y", "z")}

_Floats = NDArray[np.float64]
_Ids = NDArray[np.int64]


class SavedBlocks(FrozenArrays, Displayed):
    """File of the covariances of any input."""

    def save(self, path: str | Path) -> None:
        """Write all arrays and settings to an .npz file; a failed write leaves no partial file.

        Raises:
            OSError: the file cannot be written.
        """
        with atomic.replace_file(Path(path)) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **self._arrays())

    def _arrays(self) -> dict[str, Any]:
        names = (field.name for field in dataclasses.fields(self))  # type: ignore[arg-type]
        values = {name: getattr(self, name) for name in names if name[0] != "_"}
        return {name: np.asarray(one) for name, one in values.items() if one is not None}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Covariance(SavedBlocks):
    """Marginal covariances of a solution: of each block, with all others estimated as well.

    A pose has (w, t): w [rad] is the left perturbation of cam_from_world, R to Exp(w) R, and t its
    translation in the unit of the model. A pose X (world_from_body) of a graph has d in X Exp(d), a
    right perturbation: in 2D x y angle, in 3D rotation [rad] and then translation, both
    in the frame of the body. Constant poses and points have covariance 0, constant camera
    parameters NaN. Unobserved parameters have NaN. Blocks that were not requested, or that a graph
    does not have, are missing.

    Attributes:
        pose_ids: (n,) ids of images, or of the poses of a graph.
        pose_covariance: (n, d, d) of (w, t), d = 6; for a graph, d = 3 or 6.
        point_ids: (n,) ids of points.
        point_covariance: (n, 3, 3); NaN if the depth of a point along its rays is undetermined.
        camera_ids: (n,) ids of cameras.
        camera_covariance: (n, k, k) over all parameters of the model in COLMAP's order; NaN for
            constant parameters, and for columns beyond the parameters of the model.
        frame_ids: (n,) ids of frames of rigs of several sensors.
        frame_covariance: (n, 6, 6) of rig_from_world, as for poses.
        sensor_ids: (n, 2) ids of rigs and cameras.
        sensor_covariance: (n, 6, 6) of sensor_from_rig, as for poses.
        relative_ids: (m, 2) ids of images, or poses, a and b.
        relative_covariance: (m, d, d) of cam_b_from_cam_a, as for poses; for a graph, of X_a^-1
            X_b, a right perturbation, independent of the gauge.
        cross_covariance: (m, d, d) of d_a with d_b, for a graph.
        twist_covariance: (n, 6, 6) of the twists of images; 0 for global shutters, empty if all are
            global.
        readout_covariance: variance of each camera's readout; NaN for constant ones; empty if all
            shutters are global.
        null_point_ids: ids of points without parallax; they were left out along their undetermined
            direction.
        sigma0: root of the weighted sum of squares of all residuals over their degrees of freedom;
            1 if the assumed sigmas, or the information of the edges, are right. NaN without degrees
            of freedom.
        dof: number of residuals, including those of priors, minus the number of parameters that
            they determine.
        gauge: gauge of the covariance.
        held_pose_ids: constant poses of a graph without a FIX; None for a reconstruction.
        scale: "unit": residuals have the assumed sigmas (1 px by default), edges their information;
            "sigma0": sigmas of observations and edges are multiplied by sigma0.
        robust: "weights" or "sandwich".
        notes: sentences with remarks on the covariance.
        unit: length unit: "m" if measurements determine the scale, "" for that of the model.
    """

    pose_ids: _Ids
    pose_covariance: _Floats
    point_ids: _Ids = no_rows(np.int64)
    point_covariance: _Floats = no_rows(float, 0, 3, 3)
    camera_ids: _Ids = no_rows(np.int64)
    camera_covariance: _Floats = no_rows(float, 0, 0, 0)
    frame_ids: _Ids = no_rows(np.int64)
    frame_covariance: _Floats = no_rows(float, 0, 6, 6)
    sensor_ids: _Ids = no_rows(np.int64, 0, 2)
    sensor_covariance: _Floats = no_rows(float, 0, 6, 6)
    relative_ids: _Ids
    relative_covariance: _Floats
    cross_covariance: _Floats = no_rows(float, 0, 6, 6)
    null_point_ids: _Ids = no_rows(np.int64)
    sigma0: float
    dof: int
    gauge: str
    held_pose_ids: tuple[int, ...] | None = None
    scale: str
    robust: str = "weights"
    notes: tuple[str, ...] = ()
    unit: str = ""
    twist_covariance: _Floats = no_rows(float, 0, 6, 6)
    readout_covariance: _Floats = no_rows(float)
    _relative: Callable[[list[tuple[int, int]]], Covariance] | None = field(
        default=None, repr=False, compare=False
    )

    @property
    def is_of_graph(self) -> bool:
        """True for the poses of a graph, False for a reconstruction."""
        return self.held_pose_ids is not None

    @property
    def lens_sigmas(self) -> tuple[_Floats, float] | None:
        """Standard deviations (n, k) of the parameters of all cameras, and sigma0.

        None if intrinsics were not requested, or if the scale is not that of the residuals.
        """
        if self.scale != "sigma0" or not len(self.camera_ids):
            return None
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.einsum("nii->ni", self.camera_covariance)), self.sigma0

    @property
    def readout_sigmas(self) -> dict[int, float]:
        """Standard deviation of each refined readout, by camera id; empty without any."""
        variances = zip(self.camera_ids.tolist(), self.readout_covariance.tolist(), strict=False)
        return {camera: variance**0.5 for camera, variance in variances if variance >= 0}

    def pose(self, image_id: int) -> _Floats:
        """Return the (d, d) covariance of an image's pose, or of a pose of a graph.

        Raises:
            InputError: the image or the pose does not exist, or poses were not requested.
        """
        noun = "pose" if self.is_of_graph else "image"
        return self._one(noun, self.pose_ids, self.pose_covariance, image_id)

    def point(self, point_id: int) -> _Floats:
        """Return the (3, 3) covariance of a point.

        Raises:
            InputError: the point does not exist, or points were not requested.
        """
        return self._one("point", self.point_ids, self.point_covariance, point_id)

    def camera(self, camera_id: int) -> _Floats:
        """Return the (k, k) covariance of a camera's parameters.

        Raises:
            InputError: the camera does not exist, or intrinsics were not requested.
        """
        return self._one("camera", self.camera_ids, self.camera_covariance, camera_id)

    def relative(self, id_a: int, id_b: int) -> _Floats:
        """Return the (d, d) covariance of cam_b_from_cam_a, or of X_a^-1 X_b of a graph.

        It does not depend on the gauge, except for the length of the translation if the scale is
        undetermined. Pairs of images that were not requested are computed now, which takes about as
        long as a step of a solve.

        Raises:
            InputError: an image does not exist, or the pair of a graph was not requested.
        """
        found = np.flatnonzero((self.relative_ids == (id_a, id_b)).all(axis=1))
        if found.size:
            of_pair: _Floats = self.relative_covariance[found[0]]
            return of_pair
        if self._relative is None:
            raise InputError(
                f"relative: expected a pair of {self.relative_ids.tolist()}, "
                f"found {brief((id_a, id_b))}"
            )
        alone: _Floats = self._relative([(id_a, id_b)]).relative_covariance[0]
        return alone

    def to_dataframe(self, block: str | None = None) -> pandas.DataFrame:
        """Return standard deviations as a pandas.DataFrame; pandas is the extra ``tables``.

        Args:
            block: "points", "poses", "cameras", "frames", "sensors" or "relative"; one row per
                block, with its ids and one column per coordinate, named as in the class. None: the
                poses of a graph, the points of a reconstruction.

        Raises:
            InputError: the block is unknown, or pandas is not installed.
        """
        from bundle.interface.tabular import frame_of  # late: most programs use no tables

        names: tuple[str, ...] = ("points", "poses", "cameras", "frames", "sensors")
        noun, axes_of = "image", _AXES
        if self.is_of_graph:
            names, noun, axes_of = ("poses",), "pose", _GRAPH_AXES
        one = choice("block", block or names[0], (*names, "relative")).removesuffix("s")
        ids = np.asarray(getattr(self, f"{one}_ids"))
        covariance = np.asarray(getattr(self, f"{one}_covariance"))
        with np.errstate(invalid="ignore"):
            sigmas = np.sqrt(np.einsum("nii->ni", covariance))
        columns = {
            "pose": (f"{noun}_id",),
            "relative": (f"{noun}_id_a", f"{noun}_id_b"),
            "sensor": ("rig_id", "camera_id"),
        }.get(one, (f"{one}_id",))
        axes = tuple(f"param_{k}" for k in range(sigmas.shape[1]))
        if one != "camera":
            axes = axes_of[sigmas.shape[1]]
        keys = ids.reshape(len(ids), len(columns)).T
        return frame_of(
            dict(zip(columns, keys, strict=True))
            | {f"sigma_{axis}": sigmas[:, k] for k, axis in enumerate(axes)}
        )

    @staticmethod
    def _one(kind: str, ids: _Ids, values: _Floats, wanted: int) -> _Floats:
        found = np.flatnonzero(ids == wanted)
        if not (_is_id(wanted) and len(found)):
            known = f"one of {plural(len(ids), kind)}" if len(ids) else f"no {kind} (see of=)"
            raise InputError(f"{kind}: expected the id of {known}, found {brief(wanted)}")
        one: _Floats = values[found[0]]
        return one

    def _display(self) -> Display:
        facts = [
            ("gauge", self.gauge.replace("_", " ")),
            ("scale", self.scale),
            ("sigma0", f"{number(self.sigma0)} ({plural(self.dof, 'degree')} of freedom)"),
        ]
        if self.robust == "sandwich":
            facts.append(("robust", "sandwich"))
        counts = ((self.pose_ids, "pose"), (self.point_ids, "point"), (self.camera_ids, "camera"))
        facts += [("of", plural(len(ids), name)) for ids, name in counts if len(ids)]
        if len(self.null_point_ids):
            facts.append(("without parallax", plural(len(self.null_point_ids), "point")))
        return Display(title="Covariance", facts=tuple(facts))


GraphCovariance = Covariance
"""Name of the covariance of a pose graph."""


def rows_of(ids: _Ids, pairs: Iterable[Any], noun: str) -> list[tuple[int, int]]:
    """Return pairs of ids as pairs of positions; refuse unknown ids."""
    place = {key: row for row, key in enumerate(ids.tolist())}
    rows = []
    for k, pair in enumerate(pairs):
        try:
            a, b = pair
        except (TypeError, ValueError):
            a, b = None, None
        if not all(_is_id(end) and int(end) in place for end in (a, b)):
            raise InputError(
                f"relative: expected pairs of {noun} ids, found {brief(pair)} at [{k}]"
            )
        rows.append((place[int(a)], place[int(b)]))
    return rows


def _is_id(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


# Certainty of a reconstruction, as pages and figures show it.
#
# A pose is R, t with x = R X + t; its covariance counts in w and s of R' = Exp(w) R, t' = t + s.
# The centre of the camera is c = -R^T t, hence to first order dc = R^T (w x t) - R^T s, and its
# covariance is J C J^T with J = [-R^T [t]x, -R^T].


@dataclass(frozen=True, eq=False)
class Certainty:
    """Covariance blocks of a problem, by index.

    Attributes:
        problem: the problem.
        covariance: its covariance.
    """

    problem: Problem
    covariance: Covariance

    @cached_property
    def images(self) -> _Ids:
        """Indices (n,) of the images with a covariance."""
        return _indices(self.problem.image_ids, self.covariance.pose_ids)

    @cached_property
    def centers(self) -> _Floats:
        """Covariances (n, 3, 3) of their centres [length unit squared]."""
        jacobian = center_jacobians(self.problem.cam_from_world[self.images])
        found: _Floats = jacobian @ self.covariance.pose_covariance @ np.swapaxes(jacobian, 1, 2)
        return found

    @property
    def position_sigmas(self) -> _Floats:
        """Standard deviation (n,) of each centre in its worst direction [length unit]."""
        sigmas: _Floats = np.sqrt(largest_eigenvalues(self.centers))
        return sigmas

    @property
    def angles(self) -> _Floats:
        """Standard deviation (n,) of each rotation about its least certain axis [degrees]."""
        turns = self.covariance.pose_covariance[:, :3, :3]
        return np.asarray(np.rad2deg(np.sqrt(largest_eigenvalues(turns))))

    @cached_property
    def points(self) -> _Ids:
        """Indices (m,) of the points with a covariance."""
        return _indices(self.problem.point_ids, self.covariance.point_ids)

    @property
    def point_sigmas(self) -> _Floats:
        """Standard deviation (m,) of each point in its worst direction [length unit]."""
        sigmas: _Floats = np.sqrt(largest_eigenvalues(self.covariance.point_covariance))
        return sigmas

    @cached_property
    def cameras(self) -> dict[int, _Floats]:
        """Covariance (k, k) of the parameters by camera index; NaN for constant parameters."""
        rows = _indices(self.problem.camera_ids, self.covariance.camera_ids).tolist()
        return dict(zip(rows, self.covariance.camera_covariance, strict=True))

    def correlations(self, camera: int) -> tuple[_Ids, _Floats]:
        """Return the indices of a camera's refined parameters, and their correlation matrix."""
        covariance = self.cameras[camera]
        free = np.flatnonzero(np.diag(covariance) > 0)
        sigma = np.sqrt(np.diag(covariance)[free])
        return free, covariance[np.ix_(free, free)] / np.outer(sigma, sigma)

    def sigmas(self, camera: int) -> _Floats:
        """Return standard deviations of the parameters of a camera, NaN for constant ones."""
        variance = np.diag(self.cameras[camera]).copy()
        variance[~(variance > 0)] = np.nan
        sigma: _Floats = np.sqrt(variance)
        return sigma


def largest_eigenvalues(covariance: _Floats) -> _Floats:
    """Return the largest eigenvalue of each matrix; NaN for matrices that are not finite."""
    known = np.isfinite(covariance).all(axis=(1, 2))
    values = np.full(len(covariance), np.nan)
    if known.any():
        values[known] = np.linalg.eigvalsh(covariance[known])[:, -1]
    result: _Floats = np.maximum(values, 0.0)
    return result


def _indices(ids: _Ids, wanted: _Ids) -> _Ids:
    order = np.argsort(ids, kind="stable")
    wanted = np.asarray(wanted, np.int64)
    return order[np.searchsorted(ids, wanted, sorter=order)] if len(wanted) else wanted
