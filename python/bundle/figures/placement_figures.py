"""Figures of georeferencing: errors at control points and positions, and the plan."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.figures.marks import (
    GREY,
    Array,
    Axis,
    Cells,
    Dots,
    Ellipses,
    Figure,
    Vectors,
    round_down,
    square,
)
from bundle.figures.residual_field import principal_point
from bundle.georeference.alignment_result import (
    UNKNOWN,
    ControlPointError,
    ImageError,
    root_mean_square,
)
from bundle.model.cameras import param_kinds, project
from bundle.model.lenses.exact_image import pixel_rays
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

ROLES = {"control": 0, "check": 1, "image": 5}
"""Colour indices by role; others are grey."""

ERRORS = ("error east [m]", "error north [m]")
PLAN = ("east [m]", "north [m]")
CELLS = (24, 37)
"""Rows and columns of the map of overlap: square cells in the shape of a chart."""
MOST_BOUNDED = 10_000
"""Number of points whose extent is searched."""
FARTHEST = 1.2
"""Largest drawn error of an image without influence, relative to the height of the plan."""


def target_figure(place: Placement) -> Figure | None:
    """Return horizontal errors of control and check points; None if none are known."""
    known = [target for target in place.targets if _is_known(target)]
    if not known:
        return None
    known.sort(key=lambda target: -float(np.hypot(*target.residual[:2])))  # names first
    residuals = np.array([target.residual[:2] for target in known])
    sigmas = sorted({(float(target.sigma[0]), float(target.sigma[1])) for target in known})
    reach = max(float(np.abs(residuals).max()), *(max(pair) for pair in sigmas))
    controls = np.array([target.residual[:2] for target in known if target.role == "control"])
    ellipses = [Ellipses(np.array([np.diag(np.square(pair)) for pair in sigmas]), 2)]
    if len(controls):
        ellipses.append(Ellipses(_moment(controls)[None], 0))
    x, y = square((-reach, -reach), (reach, reach), ERRORS, 0.15)
    note = (
        "Blue: control points, with the ellipse of their root mean square; orange: check points; "
        "green: one standard deviation of the survey. Names with errors of height."
    )
    return Figure(
        name="target_errors", title="Errors of control and check points", x=x, y=y,
        marks=(_dots(known, residuals, True), *ellipses), note=note, is_plan=True,
    )  # fmt: skip


def position_figure(place: Placement) -> Figure | None:
    """Return horizontal errors of measured positions; None if none are known."""
    known = [image for image in place.images if _is_known(image)]
    if not known:
        return None
    residuals = np.array([image.residual[:2] for image in known])
    reach = float(np.abs(residuals).max())
    x, y = square((-reach, -reach), (reach, reach), ERRORS, 0.15)
    return Figure(
        name="position_errors",
        title="Errors of positions",
        x=x,
        y=y,
        marks=(_dots(known, residuals, False), Ellipses(_moment(residuals)[None], 1)),
        note="Ellipse: the RMS in each direction. Grey: without influence.",
        is_plan=True,
    )


def plan_figure(place: Placement, centers: Array) -> Figure | None:
    """Return cameras and points from above with enlarged errors; None without measurements.

    The (n, 3) centers of all images are drawn where no image has a measured position.
    """
    groups: dict[str, list[ImageError | ControlPointError]] = {
        noun: [one for one in all_ if _is_known(one) and np.isfinite(_in_model(one)).all()]
        for noun, all_ in (("images", place.images), ("points", place.targets))
    }
    if not any(groups.values()):
        return None
    others = centers[: 0 if groups["images"] else None, :2]
    every = np.vstack([others, *(_in_model(one) for group in groups.values() for one in group)])
    x, y = square(every.min(axis=0), every.max(axis=0), PLAN, 0.1)
    reach = (y.high - y.low) / 2
    marks: list[Any] = [Dots(others, (GREY,) * len(others), radius=2.0)]
    note = "Lines go towards the measurement"
    for noun, group in groups.items():
        if not group:
            continue
        at = np.array([_in_model(one) for one in group])
        residuals = np.array([one.residual[:2] for one in group])
        lengths = np.hypot(*residuals.T)
        used = np.array([one.used for one in group])
        longest = float(lengths[used if used.any() else ...].max())
        factor = round_down(0.2 * reach / longest) if longest > 0 else 1.0
        shown = factor * lengths < 2 * reach * FARTHEST
        lines = Vectors(at[shown], -factor * residuals[shown], ROLES["image"])
        marks += [lines, _dots(group, at, noun == "points")]
        note += f", {factor:g} times as long for {noun}"
    if groups["points"]:
        note += ". Blue: control points; orange: check points; with errors of height"
    return Figure(
        name="plan", title="Plan", x=x, y=y, marks=tuple(marks), note=f"{note}.", is_plan=True
    )


def overlap_figure(dimensions: Block, centers: Array) -> Figure | None:
    """Return the map of the images that see the ground, with cameras; None if it is unknown.

    Nothing hides the ground: the frames of images contain it.
    """
    if not dimensions.area > 0:
        return None
    x, y = dimensions.axes
    images = dimensions.images
    titles = tuple(plural(int(count), "image") for count in images.ravel())
    cells = Cells(images, float(images.max()), "images", titles, (3.0,))
    dots = Dots(centers[:, :2], (GREY,) * len(centers), radius=2.0)
    note = "Inside the line: 3 images or more. Dots: cameras. What hides the ground is ignored."
    return Figure(
        name="overlap", title="Images whose frame contains the ground", x=x, y=y,
        marks=(cells, dots), note=note, is_plan=True,
    )  # fmt: skip


def _dots(group: Sequence[ImageError | ControlPointError], at: Array, is_labelled: bool) -> Dots:
    names = (f"{one.name} {one.residual[2]:+.3f} m".removesuffix(" +nan m") for one in group)
    colours = tuple(ROLES.get(one.role, GREY) for one in group)
    return Dots(at, colours, tuple(names), is_labelled, radius=5.0 if is_labelled else 3.4)


def _in_model(one: ImageError | ControlPointError) -> Array:
    """Return the position in the model, (2,) east and north; that of a point is the survey's."""
    east, north, _ = np.add(one.position, 0.0 if isinstance(one, ImageError) else one.residual)
    return np.array([east, north])


def _is_known(one: ImageError | ControlPointError) -> bool:
    return bool(np.isfinite(one.residual[:2]).all())


def _moment(residuals: Array) -> Array:
    moment: Array = residuals.T @ residuals / len(residuals)
    return moment


@dataclass(frozen=True, eq=False)
class Placement:
    """Georeference of a model, and its errors at measured positions.

    Attributes:
        reference_system: coordinate system of the input; None for Cartesian coordinates.
        images: images with a measured position.
        targets: control and check points.
    """

    reference_system: str | None
    images: tuple[ImageError, ...]
    targets: tuple[ControlPointError, ...]

    def errors(self, kind: str) -> NDArray[np.float64]:
        """Return (n, 3) errors: east, north, up [m]; NaN where unknown.

        The kind is "control", "check", "left out" or "gps": "left out" has the errors of control
        points without their own influence; "gps" includes only used positions.
        """
        if kind == "gps":
            rows = [image.residual for image in self.images if image.used]
        elif kind == "left out":
            rows = [target.leave_one_out for target in self.targets if target.role == "control"]
        else:
            rows = [target.residual for target in self.targets if target.role == kind]
        return np.array(rows, float).reshape(-1, 3)

    def rms(self, kind: str) -> NDArray[np.float64]:
        """Return (5,) root mean squares: east, north, up, horizontal, total [m]; NaN if unknown."""
        east, north, up = root_mean_square(self.errors(kind).tolist())
        horizontal = math.hypot(east, north)
        return np.array([east, north, up, horizontal, math.hypot(horizontal, np.nan_to_num(up))])


@dataclass(frozen=True)
class Block:
    """Dimensions of a georeferenced model; NaN where unknown."""

    height: float  # median height of a camera above the points that it observes [m]
    ground_pixel: float  # median over observations of the depth over the focal length [m per pixel]
    # length and width of the smallest rectangle around the points from above, without 1 % at each
    # side [m]
    extent: tuple[float, float]
    axes: tuple[Axis, Axis]  # east and north of the map of overlap
    images: Array  # number of images whose frame contains the ground, in each cell of the map

    @property
    def area(self) -> float:
        """Area of ground in the frames of two images or more [m^2]."""
        width, height = (axis.high - axis.low for axis in self.axes)
        return width * height * float((self.images > 1).mean())

    @property
    def sentence(self) -> str:
        """All known dimensions in words."""
        length, width = self.extent
        words = [f"Points over {length:.3g} x {width:.3g} m"]
        if self.area > 0:
            area = f"{self.area:.3g} m²" if self.area < 1e3 else f"{self.area / 1e4:.3g} ha"
            overlap = np.median(self.images[self.images > 1])
            words.append(f"{area} of ground in two images or more ({overlap:.0f} in the median)")
        if self.height > 0:
            words.append(f"cameras {self.height:.3g} m above them")
        if math.isfinite(self.ground_pixel):
            words.append(f"{100 * self.ground_pixel:.3g} cm per pixel (GSD)")
        return ", ".join(words) + "."


def block(problem: Problem) -> Block | None:
    """Return the dimensions of a model in metres, east, north and up; None without observations."""
    if not problem.num_observations:
        return None
    image, point = problem.observation_image, problem.observation_point
    rays = problem.points[point] - problem.projection_centers[image]
    forward = rotation_matrices(problem.cam_from_world[:, :4])[:, 2]
    depth = np.abs(np.einsum("ni,ni->n", rays, forward[image]))
    order = np.argsort(image, kind="stable")
    axes, ground = _ground(problem.points, problem.projection_centers)
    heights = np.split(-rays[order, 2], np.flatnonzero(np.diff(image[order])) + 1)
    return Block(
        height=float(np.median([np.median(one) for one in heights])),
        ground_pixel=float(np.median(depth / focal_lengths(problem)[problem.image_camera[image]])),
        extent=_extent(problem.points[:, :2]),
        axes=axes,
        images=_views(problem, ground).reshape(CELLS),
    )


def focal_lengths(problem: Problem) -> NDArray[np.float64]:
    """Return the mean focal length of each camera [px]; NaN for a model without any."""
    found = []
    for model, params in zip(problem.camera_models, problem.camera_params, strict=True):
        kinds = param_kinds(model)
        focal = [params[k] for k, kind in enumerate(kinds) if kind == "focal"]
        found.append(float(np.mean(focal)) if focal else math.nan)
    return np.array(found)


def _extent(plan: NDArray[np.float64]) -> tuple[float, float]:
    """Return length and width of the smallest rectangle, by area, around 98 % of each axis."""
    some = plan[:: len(plan) // MOST_BOUNDED + 1]
    sizes = []
    for angle in np.radians(np.arange(90.0)):
        turned = some @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        low, high = np.percentile(turned, [1, 99], axis=0)
        sizes.append(sorted((high - low).tolist(), reverse=True))
    length, width = min(sizes, key=math.prod)
    return length, width


def _ground(points: Array, centers: Array) -> tuple[tuple[Axis, Axis], Array]:
    """Return axes of a map around points and cameras, and (n, 3) the middles of its cells.

    A middle has the mean height of the points in its cell, or in all cells.
    """
    ends = [np.percentile(part, [1, 99], axis=0) for part in (points, centers)]
    low, high = np.minimum(*ends)[0, :2], np.maximum(*ends)[1, :2]
    axes = square(low, high, PLAN, 0.3)
    edges = [np.linspace(a.low, a.high, n + 1) for a, n in zip(axes, CELLS[::-1], strict=True)]
    heights = np.clip(points[:, 2], *ends[0][:, 2])
    x, y = points[:, :2].T
    total, count = (np.histogram2d(x, y, edges, weights=each)[0] for each in (heights, None))
    mean = np.where(count > 0, total / np.maximum(count, 1), heights.mean())
    east, north = np.meshgrid(*(0.5 * (edge[1:] + edge[:-1]) for edge in edges))
    ground: Array = np.stack([east, north, mean.T], axis=-1)[::-1]  # the northernmost row first
    return axes, ground.reshape(-1, 3)


def _views(problem: Problem, points: Array) -> Array:
    """Return the number of images whose frame contains each of (n, 3) points; NaN if unknown."""
    views = np.zeros(len(points))
    turns = rotation_matrices(problem.cam_from_world[:, :4])
    frame = np.indices((9, 9)).reshape(2, -1).T / 8
    for camera, size in enumerate(problem.camera_sizes):
        model, widest = problem.camera_models[camera], -1.0
        params = problem.camera_params[camera, : len(param_kinds(model))]
        if principal_point(problem, camera) is not None:  # beyond its frame, a lens may fold
            rays, is_seen = pixel_rays(model, params, frame * size)
            widest = float(rays[is_seen, 2].min(initial=1.0))
        for image in np.flatnonzero(problem.image_camera == camera):
            ahead = points @ turns[image].T + problem.cam_from_world[image, 4:]
            xy, valid = project(model, params, ahead)
            valid &= ahead[:, 2] >= widest * np.linalg.norm(ahead, axis=1)
            views += valid & ((xy >= 0) & (xy <= size)).all(axis=1)
    return views if problem.camera_sizes[problem.image_camera].all() else math.nan * views


def placement(problem: Problem, record: Mapping[str, Any]) -> Placement:
    """Return the content of a ``georeference.json``.

    Args:
        problem: problem in the frame that the record describes.
        record: content of the file, or ``asdict()`` of a :class:`Georeference`.

    Raises:
        InputError: the record has another form.
    """
    index = {name: place for place, name in enumerate(problem.image_names)}
    centers = np.vstack([problem.projection_centers, UNKNOWN])
    try:
        images = tuple(
            ImageError.of(entry, centers[index.get(entry["image"], -1)]) for entry in record["gps"]
        )
        targets = tuple(map(ControlPointError.of, record["gcps"]))
        system = record["reference_system"]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "georeference: expected the entries of bundle refine's georeference.json, found "
            f"{type(error).__name__} at {error}"
        ) from None
    return Placement(None if system is None else str(system), images, targets)
