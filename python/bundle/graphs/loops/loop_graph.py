"""Loop closing: a graph of a drifted model's images, solved with loop closures.

The graph has a node per image, or per frame of a rig. Its edges are the closures, and one edge per
pair of images that share points (:mod:`.covisibility_edges`), which measures the relative pose of
the model. Without rigs, nodes may change their scale (:mod:`.similarity_graph`): a closure measures
a translation in the model's unit around its first image, and no scale.

The information of the model's edges is divided by a variance factor. The error of a drifted model
is larger than its reprojection errors indicate. These do not contain the cause of the drift
(outliers, calibration, a tracker that lost half its points). With the information of reprojection
errors alone, the graph would be so stiff that every closure is rejected. Factors of 1, 10, ... 10^6
are tried in turn.

First the graph is solved with a robust loss on the closures. The factor is the smallest one for
which at least half of the closures end within the 99.95 % quantile of correct closures. The other
closures are rejected. Then the graph is solved from the start without these closures and without a
loss. The factor is the smallest one for which three quarters of the remaining closures fit, because
the stiffest graph stays closest to the model. Rejected closures that now fit are used again, and
the graph is solved once more. (Graduated non-convexity, which is better for pose graphs, starts at
the solution without a loss. In a soft graph, wrong closures have already deformed this solution.)

Then every image has a similarity from the old world to the new one, which moves the points.

Bundle adjustment starts at this result. If the two images of a closure share points, this start is
sufficient. If they share fewer than ``MIN_SHARED`` points, no observation would keep the loop
closed, and the closure is passed to bundle adjustment as a factor.

A point moves to the mean of the positions to which its observing images carry it. Only images whose
observation fits the model are used. If no observation fits, the one with the smallest error is
used. Points without observations, and points of images that do not move, stay in place.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.components import component_roots
from bundle.base.tails import ONE_IN_2000
from bundle.graphs.factors.factors import RelativePoseFactor
from bundle.graphs.loops.covisibility_edges import (
    MIN_SHARED,
    covisibility_edges,
    fitting_observations,
)
from bundle.graphs.loops.loop_closing import (
    Closures,
    LoopClosing,
    LoopClosure,
    as_closures,
    images_of,
)
from bundle.graphs.loops.similarity_graph import Nodes, SimilarityGraph
from bundle.interface.option_fields import choice, number
from bundle.interface.pose_graph_options import LOOP_LOSSES
from bundle.io.files import Source, as_problem
from bundle.model.losses import evaluate_loss
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.model.residuals import reprojection_errors
from bundle.model.rig_arrays import placed
from bundle.model.rigid_motions import (
    cross_matrices,
    inverse_poses,
    multiply_poses,
    quaternion_rotate,
    rotation_matrices,
    unit_poses,
)
from bundle.model.shutter_motion import scaled

Array = NDArray[np.float64]

VARIANCE_FACTORS = tuple(10.0**power for power in range(7))
MOST_FIT = 0.75  # fraction of the correct closures that must fit at the end
ROUGH, FINE = 1e-6, 1e-10


def close_loops(
    problem: Source,
    closures: Closures,
    *,
    loss: str = "cauchy",
    loss_scale: float = 1.0,
) -> LoopClosing:
    """Close the loops of a model before bundle adjustment.

    Bundle adjustment of a model with drift around a loop ends in a wrong local minimum, because it
    starts too far from the correct minimum. A graph of the images' poses, with measured relative
    poses at the ends of the loop, provides a close start. Images without rigs also change their
    scale, because monocular models drift in scale. Images of a rig move with their frame and keep
    their scale.

    Args:
        problem: Problem, path of one, or pycolmap.Reconstruction; not modified.
        closures: a :class:`bundle.PoseGraph` or a g2o file. All its edges are used; its poses are
            ignored. Its ids are ids of images. Edge i j measures the pose of camera j in the frame
            of camera i (camera_i_from_camera_j: x right, y down, z forward; translation in the
            model's length unit around image i).
        loss: robust loss that separates correct from wrong closures: "huber", "soft_l1" or
            "cauchy"; at least half of them must be correct. "trivial" uses all closures. The
            model's own edges have no loss.
        loss_scale: length of a residual in sigmas beyond which the loss is robust. A closure counts
            as correct up to 4.9 times this length, which 99.95 % of correct closures do not exceed.

    Returns:
        Moved problem, and the result for each closure.

    Raises:
        InputError: the image of an edge does not exist, or both images belong to one frame (with
            file and line); the graph is planar or without edges; an information matrix or an option
            is invalid.
        OSError: a path cannot be read.

    Example:
        >>> closed = bundle.close_loops("drifted", "closures.g2o")
        >>> result = bundle.solve(closed.problem, factors=closed.factors)
    """
    problem = as_problem(problem)
    loss = choice("loss", loss, LOOP_LOSSES)
    scale = number("loss_scale", loss_scale, above=0)
    given = as_closures(closures)
    return _Closing(problem, given, loss, scale).result()


class _Closing:
    def __init__(self, problem: Problem, given: PoseGraph, loss: str, scale: float) -> None:
        self.problem, self.given, self.loss, self.scale = problem, given, loss, scale
        self.limit = scale**2 * ONE_IN_2000[6]
        ends = images_of(given, problem)
        self.ends = ends
        self.fitting = fitting_observations(problem)
        model = covisibility_edges(problem, self.fitting)
        cameras = inverse_poses(unit_poses(problem.cam_from_world))
        self.node_of, nodes = _nodes(problem, cameras)
        self.mounts = multiply_poses(inverse_poses(nodes[self.node_of]), cameras)
        pairs = model.pairs
        if problem.num_frames:  # no edges between images of one frame
            between = self.node_of[pairs[:, 0]] != self.node_of[pairs[:, 1]]
        else:
            between = np.ones(len(pairs), bool)
        pairs, known = pairs[between], model.information[between]
        self.num_edges = len(pairs)
        images = np.concatenate([pairs, ends])
        measured = multiply_poses(inverse_poses(cameras[pairs[:, 0]]), cameras[pairs[:, 1]])
        padded = np.zeros((len(ends), 7, 7))
        padded[:, :6, :6] = given.information
        self.start = Nodes(nodes, np.ones(len(nodes)))
        edges = self.node_of[images]
        self.component = component_roots(edges.ravel(), np.arange(0, edges.size, 2), len(nodes))
        self.graph = SimilarityGraph(
            edges=edges,
            mounts=self.mounts[images],
            measurements=np.concatenate([measured, unit_poses(given.measurements)]),
            information=np.concatenate([known, padded]),
            held=self.component == np.arange(len(nodes)),
            has_free_scales=problem.num_frames == 0,
        )
        self.closes = np.arange(len(edges)) >= self.num_edges

    def result(self) -> LoopClosing:
        right = self._right_closures()
        factor, nodes = self._solved(right)
        if (self._fits(nodes) & ~right).any():
            right |= self._fits(nodes)
            factor, nodes = self._solved(right)
        weights = np.where(self.closes, 0.0, 1.0)
        weights[self.closes] = right
        moved, num_carried = carry(
            self.problem, self.node_of, self.mounts, (self.start, nodes), self.fitting
        )
        records = self._records(nodes, weights, self._is_loose())
        graph = self._softened(factor)
        return LoopClosing(
            problem=moved,
            initial_problem=self.problem,
            closures=records,
            factors=self._factors(nodes, records),
            num_nodes=len(self.component),
            num_edges=self.num_edges,
            num_components=int(graph.held.sum()),
            has_free_scales=graph.has_free_scales,
            scale_range=(float(nodes.scales.min()), float(nodes.scales.max())),
            variance_factor=factor,
            cost_before=self._cost(graph.chi2(self.start), weights),
            cost_after=self._cost(graph.chi2(nodes), weights),
            num_carried_points=num_carried,
        )

    def _softened(self, factor: float) -> SimilarityGraph:
        information = self.graph.information.copy()
        information[: self.num_edges] /= factor
        return SimilarityGraph(**{**vars(self.graph), "information": information})

    def _right_closures(self) -> NDArray[np.bool_]:
        """Return the mask (m,) of closures that end within the limit in a solve with the loss."""
        right = np.ones(len(self.ends), bool)
        if self.loss == "trivial":
            return right
        most = -1
        for factor in VARIANCE_FACTORS:
            nodes = self._softened(factor).solve(self.start, self._weigh, ROUGH)
            fits = self._fits(nodes)
            if fits.sum() > most:
                most, right = int(fits.sum()), fits
            if 2 * fits.sum() >= len(fits):
                break
        return right

    def _solved(self, right: NDArray[np.bool_]) -> tuple[float, Nodes]:
        """Return the variance factor, and the nodes with correct closures and no loss."""
        weights = np.where(self.closes, 0.0, 1.0)
        weights[self.closes] = right
        for factor in VARIANCE_FACTORS:
            graph = self._softened(factor)
            nodes = graph.solve(self.start, lambda chi2: (weights * chi2, weights), FINE)
            if (self._fits(nodes) & right).sum() >= MOST_FIT * right.sum():
                break
        return factor, nodes

    def _fits(self, nodes: Nodes) -> NDArray[np.bool_]:
        fits: NDArray[np.bool_] = self.graph.chi2(nodes)[self.closes] <= self.limit
        return fits

    def _weigh(self, chi2: Array) -> tuple[Array, Array]:
        """Return rho and rho' of each edge, with the loss on closures."""
        rho, weights = chi2.copy(), np.ones(len(chi2))
        bent = evaluate_loss(self.loss, self.scale, chi2[self.closes])
        rho[self.closes], weights[self.closes] = bent[:, 0], bent[:, 1]
        return rho, weights

    @staticmethod
    def _cost(chi2: Array, weights: Array) -> float:
        return 0.5 * float((weights * chi2).sum())

    def _is_loose(self) -> NDArray[np.bool_]:
        """Return the mask (m,) of closures whose images share too few points."""
        problem = self.problem
        code = problem.observation_image.astype(np.int64) * problem.num_points
        seen = np.unique(code + problem.observation_point)
        image, point = np.divmod(seen, max(problem.num_points, 1))
        first = np.searchsorted(image, np.arange(problem.num_images + 1))
        shared = [
            len(np.intersect1d(point[first[a] : first[a + 1]], point[first[b] : first[b + 1]]))
            for a, b in self.ends.tolist()
        ]
        return np.array(shared) < MIN_SHARED

    def _records(
        self, nodes: Nodes, weights: Array, is_loose: NDArray[np.bool_]
    ) -> tuple[LoopClosure, ...]:
        before, after = self.graph.residuals(self.start), self.graph.residuals(nodes)
        chi2_before, chi2_after = self.graph.chi2(self.start), self.graph.chi2(nodes)
        used = weights > 0
        ids = self.problem.image_ids
        records = []
        for closure, (a, b) in enumerate(self.ends.tolist()):
            edge = self.num_edges + closure
            record = LoopClosure(
                image_ids=(int(ids[a]), int(ids[b])),
                line=int(self.given.edge_lines[closure]),
                used=bool(used[edge]),
                rotation_before=float(np.degrees(np.linalg.norm(before[edge, :3]))),
                rotation_after=float(np.degrees(np.linalg.norm(after[edge, :3]))),
                translation_before=float(np.linalg.norm(before[edge, 3:6])),
                translation_after=float(np.linalg.norm(after[edge, 3:6])),
                chi2_before=float(chi2_before[edge]),
                chi2_after=float(chi2_after[edge]),
                is_factor=bool(used[edge] and is_loose[closure] and self._is_definite(closure)),
            )
            records.append(record)
        return tuple(records)

    def _is_definite(self, closure: int) -> bool:
        values = np.linalg.eigvalsh(self.given.information[closure])
        return bool(values[0] > 1e-12 * values[-1])

    def _factors(
        self, nodes: Nodes, records: tuple[LoopClosure, ...]
    ) -> tuple[RelativePoseFactor, ...]:
        """Return factors of closures, as cam_b_from_cam_a in the new length unit of image a.

        With B A^-1 = (Z E)^-1, the factor's error Log(Z B A^-1) is -Ad(Z) Log E to first order.
        """
        factors = []
        for closure, record in enumerate(records):
            if not record.is_factor:
                continue
            unit = float(nodes.scales[self.node_of[self.ends[closure, 0]]])
            z = unit_poses(self.given.measurements[closure : closure + 1])
            shrink = np.diag([1.0] * 3 + [1.0 / unit] * 3)
            information = shrink @ self.given.information[closure] @ shrink
            z[:, 4:] *= unit
            turn = rotation_matrices(z[:, :4])[0]
            adjoint = np.zeros((6, 6))
            adjoint[:3, :3] = adjoint[3:, 3:] = turn
            adjoint[3:, :3] = cross_matrices(z[0, 4:]) @ turn
            back = np.linalg.inv(adjoint)
            information = back.T @ information @ back
            a, b = record.image_ids
            factors.append(
                RelativePoseFactor(
                    ("image", a),
                    ("image", b),
                    inverse_poses(z)[0],
                    0.5 * (information + information.T),
                )
            )
        return tuple(factors)


def _nodes(problem: Problem, cameras: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the node of each image, and the poses of nodes (frames, or images without a frame)."""
    if not problem.num_frames:
        return np.arange(problem.num_images), cameras
    own = problem.image_frame < 0
    key = np.where(own, problem.num_frames + np.arange(problem.num_images), problem.image_frame)
    found, first, node_of = np.unique(key, return_index=True, return_inverse=True)
    frames = inverse_poses(unit_poses(problem.rig_from_world))
    poses = cameras[first]
    framed = found < problem.num_frames
    poses[framed] = frames[found[framed]]
    return node_of.astype(np.int64), poses


def carry(
    problem: Problem,
    node_of: NDArray[np.int64],
    mounts: Array,
    nodes: tuple[Nodes, Nodes],
    fitting: NDArray[np.bool_],
) -> tuple[Problem, int]:
    """Return the problem with images and points moved by their nodes.

    ``node_of``: (num_images,) node of each image.
    ``mounts``: (num_images, 7) node_from_camera. ``fitting``: (num_observations,) mask of
    observations that fit the model.

    Returns:
        Moved problem, and the number of moved points.
    """
    before, after = nodes
    cameras = after.of(node_of, mounts)
    node_moved = (after.poses != before.poses).any(axis=1) | (after.scales != before.scales)
    moved = node_moved[node_of]
    poses = np.where(moved[:, None], inverse_poses(cameras.poses), problem.cam_from_world)
    changes: dict[str, Any] = {"cam_from_world": poses}
    if problem.num_frames:
        changes |= _frames(problem, node_of, node_moved, after, poses)
    points, is_carried = _points(problem, cameras, moved, fitting)
    shutter = scaled(problem.rolling_shutter, (after.scales / before.scales)[node_of])
    moved_problem = problem.replace(points=points, rolling_shutter=shutter, **changes)
    return moved_problem, int(is_carried.sum())


def _frames(
    problem: Problem,
    node_of: NDArray[np.int64],
    node_moved: NDArray[np.bool_],
    after: Nodes,
    poses: Array,
) -> dict[str, Any]:
    images = np.flatnonzero(problem.image_frame >= 0)
    found, first = np.unique(problem.image_frame[images], return_index=True)
    of_frame = node_of[images[first]]
    frames = problem.rig_from_world.copy()
    goes = node_moved[of_frame]
    frames[found[goes]] = inverse_poses(after.poses[of_frame[goes]])
    names = ("image_frame", "image_sensor", "sensor_from_rig")
    fields = {name: getattr(problem, name) for name in names}
    changes = {"rig_from_world": frames}
    return changes | {"cam_from_world": placed(fields | changes | {"cam_from_world": poses})}


def _points(
    problem: Problem, cameras: Nodes, moved: NDArray[np.bool_], fitting: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    carriers = _carriers(problem, fitting)
    image, point = problem.observation_image[carriers], problem.observation_point[carriers]
    pose = unit_poses(problem.cam_from_world[image])
    local = quaternion_rotate(pose[:, :4], problem.points[point]) + pose[:, 4:]
    world = quaternion_rotate(cameras.poses[image, :4], local) * cameras.scales[image, None]
    world += cameras.poses[image, 4:]
    total = np.zeros_like(problem.points)
    np.add.at(total, point, world)
    count = np.bincount(point, minlength=problem.num_points)
    goes = np.zeros(problem.num_points, bool)
    goes[point[moved[image]]] = True
    points = problem.points.copy()
    points[goes] = total[goes] / count[goes, None]
    return points, goes


def _carriers(problem: Problem, fitting: NDArray[np.bool_]) -> NDArray[np.int64]:
    point = problem.observation_point
    has = np.zeros(problem.num_points, bool)
    has[point[fitting]] = True
    errors, _ = reprojection_errors(problem)
    order = np.lexsort((np.nan_to_num(errors, nan=np.inf), point))
    best = order[np.diff(point[order], prepend=-1) != 0]
    chosen = fitting.copy()
    chosen[best[~has[point[best]]]] = True
    return np.flatnonzero(chosen)
