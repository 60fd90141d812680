"""Observations by point, and viewing geometry: causes of weakly separable intrinsics and poses.

Let all images of a camera look along one direction d. Stretching the world along d by s, together
with the focal length, changes no pinhole image: x = f X / Z. If images differ only by translations,
no scene separates the focal length from the depth. Rotated images do separate them. Over a plane
perpendicular to d, only the images move ("height"). Then even slightly inclined images separate
focal length and depth poorly (Wu 2014: Critical configurations for radial distortion
self-calibration; Sturm 1997: critical motion sequences).

Weak joints: parts of a model that few points connect to the rest.

Test. The weight of two images is the number of their common points. A maximum spanning tree of
these weights connects the images; removing its edge (a, b) of weight w leaves two parts, and no
pair of images across them has more than w points in common. Parts across which fewer than 15 points
are seen have an uncertain relative pose and scale: 7 degrees of freedom from 15 points of a few
pixels' noise, of which outliers may be some. Both parts have at least two images.

Cost. Divide the points into 15 disjoint sets. If the points of each set connect all images, any two
parts share at least 15 points, one of each set, and no weak joint exists. This test takes linear
time. The pairs of images are needed only for small models and for models that fail it.

The images of a frame of a rig are one image: the rig holds them together.

Covisibility graph of images: the structure of the reduced camera matrix S.

Block (i, j) of S is nonzero exactly if images i and j observe a common point (as long as no two
images share a refined camera). The density of this graph is therefore the fill of S.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.components import component_roots
from bundle.base.records import dataclass
from bundle.base.words import named, plural
from bundle.interface.finding import Finding
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_inverse, quaternion_rotate

FEW_SHARED = 5
"""Number of common points below which two images leave their relative pose undetermined."""

Ints = NDArray[np.int64]


class TrackTable:
    """Images of each point without repeats, sorted by point.

    Attributes:
        images: (n,) image of each pair of a point and an image that observes it.
        points: (n,) point of each pair, ascending.
    """

    def __init__(self, problem: Problem) -> None:
        self.images, self.points = by_point(problem)
        self._problem = problem

    @cached_property
    def lengths(self) -> Ints:
        """Number of images of each point, (num_points,)."""
        return np.bincount(self.points, minlength=self._problem.num_points)

    @cached_property
    def pieces(self) -> NDArray[np.int32]:
        """Component of each image; the largest is 0; -1 for images without observations.

        Points connect the images that observe them; frames of rigs connect their images.
        """
        return self._pieces(self.images, self.points)

    @cached_property
    def shared(self) -> Ints:
        """Number of points of each image that another image also observes, (num_images,)."""
        counts = self.lengths[self.points] > 1
        return np.bincount(self.images[counts], minlength=self._problem.num_images)

    @cached_property
    def firm_pieces(self) -> NDArray[np.int32]:
        """Components as in ``pieces``, where five shared points are needed for a connection."""
        first, second, count = self.pair_counts
        ends = np.stack([first, second], axis=1)[count >= FEW_SHARED]
        # Each pair of images is treated as one point; single images as points of one image.
        alone = distinct(self.images)
        images = np.concatenate([ends.ravel(), alone])
        points = np.concatenate(
            [np.repeat(np.arange(len(ends)), 2), len(ends) + np.arange(len(alone))]
        )
        return self._pieces(images, points)

    @cached_property
    def rigid_pieces(self) -> NDArray[np.int32]:
        """Components as in ``pieces``, connected only by points that three images see."""
        chosen = self.lengths[self.points] > 2
        alone = distinct(self.images)
        last = self._problem.num_points
        return self._pieces(
            np.concatenate([self.images[chosen], alone]),
            np.concatenate([self.points[chosen], last + np.arange(len(alone))]),
        )

    def count_between(self, images: NDArray[Any]) -> int:
        """Return the number of points that both these images and other images observe."""
        inside = np.isin(self.images, images)
        both = np.intersect1d(self.points[inside], self.points[~inside])
        return len(both)

    @cached_property
    def pair_counts(self) -> tuple[Ints, Ints, Ints]:
        """Pairs of images on common points, first < second, and the number of these points."""
        size = max(self._problem.num_images, 1)
        first, second = self._pairs()
        code, count = np.unique(first * size + second, return_counts=True)
        return (*np.divmod(code, size), count)

    def _pairs(self) -> tuple[Ints, Ints]:
        """Return pairs of images that see a common point, once per such point.

        Long tracks give only pairs within ten positions: their images share many other points.
        """
        first, second = [], []
        for step in range(1, 11):
            same = np.flatnonzero(self.points[step:] == self.points[:-step])
            if not len(same):
                break
            first.append(self.images[same])
            second.append(self.images[same + step])
        if not first:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        return np.concatenate(first), np.concatenate(second)

    def _pieces(self, images: Ints, points: Ints) -> NDArray[np.int32]:
        problem = self._problem
        if problem.num_frames:
            observed = np.isin(np.arange(problem.num_images), images)
            carried = np.flatnonzero(observed & (problem.image_frame >= 0))
            by_frame = carried[np.argsort(problem.image_frame[carried], kind="stable")]
            images = np.concatenate([images, by_frame])
            last = points[-1] + 1 if len(points) else 0
            points = np.concatenate([points, last + problem.image_frame[by_frame]])
        return components(images, points, problem.num_images)[0].astype(np.int32)


# Entries of the adjacency matrix in memory at once: 128 MB of booleans.
_CELLS = 2**27


@dataclass(frozen=True, eq=False, kw_only=True)
class Covisibility:
    """Covisibility graph of the images."""

    # (num_images,) number of other images that share a point with each image
    neighbours: NDArray[np.int64]
    num_pairs: int  # pairs of images with a common point
    # share of nonzero image blocks of S, including the diagonal; NaN without images
    schur_fill: float
    # (num_images,) connected component of each image, the largest component first; -1 for an image
    # without observations
    component: NDArray[np.int64]
    component_sizes: tuple[int, ...]  # number of images of each component


def covisibility(problem: Problem) -> Covisibility:
    """Return the covisibility graph in time linear in the pairs of images that points connect."""
    images, points = by_point(problem)
    neighbours = _neighbours(images, points, problem.num_images)
    component, sizes = components(images, points, problem.num_images)
    num_pairs, size = int(neighbours.sum()) // 2, problem.num_images
    return Covisibility(
        neighbours=neighbours,
        num_pairs=num_pairs,
        schur_fill=(size + 2 * num_pairs) / size**2 if size else float("nan"),
        component=component,
        component_sizes=sizes,
    )


def shared_points(
    problem: Problem,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return (low, high, number of common points) of each pair of covisible images, ascending.

    Time is linear in the pairs of images that points connect, memory in the distinct ones.
    """
    images, points = by_point(problem)
    size = max(problem.num_images, 1)
    codes, counts = np.empty(0, np.int64), np.empty(0, np.int64)
    for low, high in _pairs(np.arange(len(images)), images, points):
        found, count = np.unique(low * size + high, return_counts=True)
        codes, place = np.unique(np.concatenate([codes, found]), return_inverse=True)
        both = np.concatenate([counts, count])
        counts = np.bincount(place, both, len(codes)).astype(np.int64)
    low, high = np.divmod(codes, size)
    return low, high, counts


def components(
    images: NDArray[np.int64], points: NDArray[np.int64], num_images: int
) -> tuple[NDArray[np.int64], tuple[int, ...]]:
    """Return the component of each image (-1: no observation) and the sizes, largest first.

    Observations must be sorted by point.
    """
    starts = np.flatnonzero(np.diff(points, prepend=-1))
    root = component_roots(images, starts, num_images)
    observed = np.zeros(num_images, bool)
    observed[images] = True
    component = np.full(num_images, -1)
    _, component[observed], sizes = np.unique(
        root[observed], return_inverse=True, return_counts=True
    )
    order = np.argsort(-sizes, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    component[observed] = rank[component[observed]]
    return component, tuple(int(size) for size in sizes[order])


def by_point(problem: Problem) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return images and points of all distinct observed pairs, sorted by point, then image."""
    size = max(problem.num_images, 1)
    code = np.sort(problem.observation_point.astype(np.int64) * size + problem.observation_image)
    points, images = np.divmod(code[np.diff(code, prepend=-1) != 0], size)
    return images, points


def _neighbours(
    images: NDArray[np.int64], points: NDArray[np.int64], num_images: int
) -> NDArray[np.int64]:
    """Return the number of neighbours of each image, computed in blocks of adjacency rows."""
    neighbours = np.zeros(num_images, np.int64)
    rows = max(_CELLS // max(num_images, 1), 1)
    for first in range(0, num_images, rows):
        adjacent = np.zeros((min(rows, num_images - first), num_images), bool)
        inside = np.flatnonzero((images >= first) & (images < first + rows))
        for low, high in _pairs(inside, images, points):
            adjacent[low - first, high] = True
        neighbours[first : first + rows] += adjacent.sum(1)
        neighbours += adjacent.sum(0)
    return neighbours


def _pairs(
    chosen: NDArray[np.int64], images: NDArray[np.int64], points: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the pairs (low, high) of images on common points, low among the chosen observations.

    Round k pairs each observation with the k-th after it on the same point.
    """
    step = 1
    while True:
        chosen = chosen[chosen + step < len(points)]
        chosen = chosen[points[chosen] == points[chosen + step]]
        if len(chosen) == 0:
            return
        yield images[chosen], images[chosen + step]
        step += 1


ONE_PLACE = 1e-3
"""Spread of images, relative to the distance of their points, that counts as pure rotation."""
PARALLEL_DEGREES = 12.0
"""Root mean square angle to their mean, below which viewing directions count as equal."""
FLAT = 0.1  # relief of a flat scene, relative to the distance of the points
ALONG_DEGREES = 30.0  # angle to the viewing direction, below which a path counts as forward motion
MOST_POINTS = 20000

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Viewing:
    """Viewing geometry of images."""

    spread_degrees: float  # root mean square angle of the viewing directions to their mean
    # root mean square distance of the projection centres from their middle, in median distances of
    # points
    baseline: float
    # root mean square distance of the points from their plane (or line), likewise, from the tenth
    # to the ninetieth percentile
    relief: float
    tilt_degrees: float  # angle of the mean viewing direction to the plane's normal
    path_degrees: float  # angle of the mean viewing direction to the main direction of the path
    path_share: float  # share of the path along its main direction, 1 for a straight line

    @property
    def cause(self) -> str:
        """Name of the critical configuration that these images are in or near; "": none."""
        if self.baseline < ONE_PLACE:
            return "pure_rotation"
        if self.spread_degrees > PARALLEL_DEGREES:
            return ""
        forward = self.path_degrees < ALONG_DEGREES and self.path_share > 0.9
        if forward:
            return "forward_motion"
        if self.relief < FLAT and self.tilt_degrees < 45:
            return "flat_scene"
        return "parallel_views"


def viewing(problem: Problem, images: NDArray[np.int64]) -> Viewing | None:
    """Return the viewing geometry of these images; None if they observe nothing."""
    chosen = np.flatnonzero(np.isin(problem.observation_image, images))
    if not len(chosen) or not len(images):
        return None
    chosen = chosen[:: max(len(chosen) // MOST_POINTS, 1)]
    points = problem.points[problem.observation_point[chosen]]
    centers = problem.projection_centers
    away = np.linalg.norm(points - centers[problem.observation_image[chosen]], axis=1)
    distance = float(np.median(away)) or 1.0
    axes = quaternion_rotate(
        quaternion_inverse(problem.cam_from_world[images, :4]), np.array([0.0, 0.0, 1.0])
    )
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    mean = axes.mean(axis=0)
    length = float(np.linalg.norm(mean))
    mean = mean / length if length > 0 else axes[0]
    off = np.degrees(np.arccos(np.clip(axes @ mean, -1, 1)))
    _, spans, path = np.linalg.svd(centers[images] - centers[images].mean(axis=0))
    total = float((spans**2).sum())
    relief, normal = plane(points)
    return Viewing(
        spread_degrees=float(np.sqrt((off**2).mean())),
        baseline=float(np.sqrt(total / len(images))) / distance,
        relief=relief / distance,
        tilt_degrees=_angle(normal, mean),
        path_degrees=_angle(path[0], mean),
        path_share=float(spans[0] ** 2 / total) if total > 0 else 0.0,
    )


def plane(points: Vector) -> tuple[float, Vector]:
    """Return relief and normal of the plane through points, without the farthest tenth."""
    middle = np.median(points, axis=0)
    far = np.linalg.norm(points - middle, axis=1)
    inner = points[far <= np.quantile(far, 0.9)] - middle
    if len(inner) < 3:
        return 0.0, np.array([0.0, 0.0, 1.0])
    _, normals = np.linalg.eigh(inner.T @ inner)
    heights = inner @ normals[:, 0]
    low, high = np.quantile(heights, [0.1, 0.9])
    return float(high - low) / 2.56, normals[:, 0]


def _angle(a: Vector, b: Vector) -> float:
    """Return the angle between two lines in degrees."""
    return float(np.degrees(np.arccos(min(abs(float(a @ b)), 1.0))))


FEW = 15
SMALL = 50_000
MOST_EDGES_TRIED = 20


def weak_joint(problem: Problem, tracks: TrackTable) -> Finding | None:
    """Return the finding about the weakest joint, or None."""
    if len(tracks.points) > SMALL and _is_firm(problem, tracks):
        return None
    images, count = _weakest(problem, tracks)
    if not count:
        return None
    ids = sorted(problem.image_ids[images].tolist())
    return Finding(
        kind="weak_joint",
        sentence=f"Weak joint: {plural(len(ids), 'image')} ({named('image', ids)}) share only "
        f"{plural(count, 'point')} with the other {problem.num_images - len(ids)}: their relative "
        "pose and scale are uncertain. Match more pairs across this joint, or close a loop.",
        evidence={"image_ids": ids, "num_points": count},
    )


def _is_firm(problem: Problem, tracks: TrackTable) -> bool:
    """Return True if the points of each of 15 sets connect all images that have 100 points."""
    many = np.bincount(tracks.images, minlength=problem.num_images) >= 100
    chosen = many[tracks.images]
    images, points = tracks.images[chosen], tracks.points[chosen]
    for rest in range(FEW):
        own = points % FEW == rest
        starts = np.flatnonzero(np.diff(points[own], prepend=-1))
        roots = component_roots(images[own], starts, problem.num_images)
        if len(distinct(roots[many])) > 1:
            return False
    return True


def _weakest(problem: Problem, tracks: TrackTable) -> tuple[Ints, int]:
    """Return the images of the smaller part at the weakest joint, and its points; 0: none."""
    node = _nodes(problem)
    first, second, weight = tracks.pair_counts
    first, second = node[first], node[second]
    apart = first != second
    first, second, weight = first[apart], second[apart], weight[apart]
    order = np.argsort(-weight, kind="stable")
    parent = np.arange(problem.num_images)
    tree: list[tuple[int, int, int]] = []

    def root(image: int) -> int:
        while parent[image] != image:
            parent[image] = parent[parent[image]]
            image = int(parent[image])
        return image

    for a, b, w in zip(
        first[order].tolist(), second[order].tolist(), weight[order].tolist(), strict=True
    ):
        one, other = root(a), root(b)
        if one != other:
            parent[one] = other
            tree.append((a, b, w))
    weak = [edge for edge in reversed(tree) if edge[2] < FEW][:MOST_EDGES_TRIED]
    best: tuple[Ints, int] = (np.zeros(0, np.int64), 0)
    for edge in weak:
        nodes, others = _sides(tree, edge, problem.num_images)
        if min(len(nodes), len(others)) < 2:
            continue
        images = np.flatnonzero(np.isin(node, nodes))
        count = tracks.count_between(images)
        if 0 < count < FEW and (not best[1] or count < best[1]):
            best = (images, count)
    return best


def _nodes(problem: Problem) -> Ints:
    """Return the first image of the frame of each image, or the image itself."""
    node = np.arange(problem.num_images)
    if problem.num_frames:
        carried = np.flatnonzero(problem.image_frame >= 0)
        frame = problem.image_frame[carried]
        first = np.full(problem.num_frames, problem.num_images)
        np.minimum.at(first, frame, carried)
        node[carried] = first[frame]
    return node


def _sides(
    tree: list[tuple[int, int, int]], without: tuple[int, int, int], count: int
) -> tuple[Ints, Ints]:
    """Return the two sides of the tree without one edge, the smaller first."""
    edges = np.array([edge[:2] for edge in tree if edge is not without], np.int64).reshape(-1, 2)
    roots = component_roots(edges.ravel(), np.arange(len(edges)) * 2, count)
    one, other = sorted((np.flatnonzero(roots == roots[end]) for end in without[:2]), key=len)
    return one, other
