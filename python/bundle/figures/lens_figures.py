"""Figures of lenses: distortion, the certainty of projections, correlations of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_result import Certainty
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.figures.marks import (
    GREY,
    Array,
    Axis,
    Cells,
    Figure,
    Line,
    Matrix,
    Places,
    linear,
    logarithmic,
    over_image,
)
from bundle.figures.projection_uncertainty import ProjectionUncertainty, contour_levels
from bundle.figures.residual_field import (
    MOST_CAMERAS,
    by_observations,
    observations_of_cameras,
    principal_point,
)
from bundle.model.cameras import camera_models, project
from bundle.model.lenses.exact_image import PERSPECTIVE, focal_and_center
from bundle.model.problem import Problem

NONE = 1e-6  # limit in pixels below which distortion is a rounding error

MOST_NAMED = 6  # largest number of curves with a colour and a label each

WIDE = 20.0  # ratio of sigmas above which the axis is logarithmic


def lens_figure(curves: Mapping[str, LensCurve], title: str = "", note: str = "") -> Figure | None:
    """Return the figure of distortion against the distance from the principal point, by label.

    None without distortion, as of pinhole cameras.
    The curve "before" is grey and dashed. The others have sigma bands; marks are at the farthest
    observation and the farthest image corner of all. More than 6 curves are faint, without labels
    and bands.
    """
    lines = []
    now = [label for label in curves if label != "before"]
    many = len(now) > MOST_NAMED
    for label, curve in curves.items():
        before = label == "before"
        colour = GREY if before else 0 if many else now.index(label)
        sigma = curve.sigma if len(curve.sigma) and not before and not many else None
        lines.append(
            Line("" if many else label, curve.radius, curve.distortion, sigma, colour=colour,
                 dash=int(before), opacity=0.45 if many else 1.0)
        )  # fmt: skip
    marked = [curves[label] for label in now or curves]
    found = {
        "observed": max(curve.observed_radius for curve in marked),
        "corner": max(curve.corner_radius for curve in marked),
    }
    places = {name: value for name, value in found.items() if math.isfinite(value)}
    spread = [0.0 if line.sigma is None else line.sigma for line in lines]
    ends = [line.y + sign * s for line, s in zip(lines, spread, strict=True) for sign in (-1, 1)]
    heights = np.concatenate([np.zeros(0), *ends])
    heights = heights[np.isfinite(heights)]
    if (np.abs(heights) < NONE).all():
        return None
    reach = [x for line in lines for x in line.x.tolist()]
    reach += places.values()
    return Figure(
        name="distortion",
        title=title,
        x=linear([0.0, *reach], "distance from the principal point [px]"),
        y=linear([*heights.tolist(), 0.0], "distortion [px]", low=None),
        marks=(*lines, Places(places)),
        note=note,
    )


def focal_figure(
    ids: Array, values: Mapping[str, Array], sigmas: Mapping[str, Array], title: str
) -> Figure:
    """Return focal lengths [pixels] by parameter, with sigmas, NaN where unknown."""
    words = []
    for name, value in values.items():
        typical = sigmas[name][np.isfinite(sigmas[name])]
        words.append(f"{name}: spread {number(float(np.std(value)))} px")
        if len(typical):
            words[-1] += f", median sigma {number(float(np.median(typical)))} px"
    # Half of the bars are inside. Those of undetermined focal lengths would hide the others.
    every, known = (np.concatenate([*of.values()]) for of in (values, sigmas))
    bar = float(np.nanmedian(known)) if np.isfinite(known).any() else 0.0
    margin = max(0.25 * float(np.ptp(every)), min(1.2 * bar, 0.5 * float(every.mean())))
    margin = margin or 0.01 * float(every.mean())
    ends = [float(every.min()) - margin, float(every.max()) + margin]
    marks = [
        Line(name if len(values) > 1 else "", ids, value, colour=colour, is_dotted=True,
             error=sigmas[name])
        for colour, (name, value) in enumerate(values.items())
    ]  # fmt: skip
    return Figure(
        name="focal_lengths",
        title=title,
        x=linear([ids.min() - 0.5, ids.max() + 0.5], "camera id", low=None),
        y=linear(ends, "focal length [px]", low=None),
        marks=tuple(marks),
        note="; ".join(words) + ". Bars: one standard deviation.",
    )


def sigma_figure(
    known: ProjectionUncertainty, distance: float = math.inf, words: str = ""
) -> Figure:
    """Return the figure of the uncertainty over the image at a distance, with contours.

    ``words``: text of the note that describes the distance [length unit].
    """
    sigma = known.sigma(distance)
    seen = sigma[np.isfinite(sigma)]
    note = ""
    if len(seen):
        note = f"{_pixels(seen.min())} to {_pixels(seen.max())} px, median "
        note += f"{_pixels(np.median(seen))}"
    missing = sigma.size - len(seen)
    note += f"; {plural(missing, 'cell')} without a ray" if missing else ""
    note += f"; {words}" if words else ""
    titles = tuple(
        f"{_pixels(value)} px, {plural(int(count), 'observation', grouped=True)}"
        for value, count in zip(sigma.ravel(), known.count.ravel(), strict=True)
    )
    levels = contour_levels(sigma) if min(sigma.shape) > 1 else []
    cells = Cells(sigma, top_sigma(known), "px", titles, tuple(levels))
    far = math.isinf(distance)
    title = "At infinity" if far else f"At a distance of {number(distance)}"
    name = "uncertainty at infinity" if far else "uncertainty at the median distance"
    return over_image(known.box, name, title, cells, note=note)


def distance_figure(known: ProjectionUncertainty) -> Figure:
    """Return the uncertainty against the distance, with a mark at the median distance."""
    x = known.distances
    curves = known.by_distance()
    heights = [y for values in curves.values() for y in values.tolist() if 0 < y < math.inf]
    is_wide = max(heights, default=1.0) > WIDE * min(heights, default=1.0)
    label = f"uncertainty [px]{', log scale' if is_wide else ''}"
    y_axis = (
        logarithmic(heights, label)
        if is_wide
        else linear([0.0, 1.05 * max(heights, default=1.0)], label)
    )
    ticks = tuple(tick for tick in logarithmic(x.tolist()).ticks if x[0] <= tick <= x[-1])
    across = "distance from the camera, log scale"
    return Figure(
        name="uncertainty_against_distance",
        title="Against the distance",
        x=Axis(float(x[0]), float(x[-1]), ticks, is_logarithmic=True, label=across),
        y=y_axis,
        marks=(
            *(Line(name, x, y, colour=k) for k, (name, y) in enumerate(curves.items())),
            Places({"median": known.distance}),
        ),
    )


def top_sigma(known: ProjectionUncertainty) -> float:
    """Return the top of the colour scale: the 98th percentile of sigma at two distances."""
    both: Array = np.stack([known.sigma(), known.sigma(known.distance)])
    return float(f"{np.quantile(both[np.isfinite(both)], 0.98):.6g}")


def _pixels(value: float) -> str:
    return f"{float(value):.3g}"


# Distortion of lenses along the radius, and the observed radius.
#
# Let a ray have the angle theta to the axis and the direction phi around it. Without distortion its
# image would be at i = (fx s cos phi, fy s sin phi) from the principal point, with s = tan theta
# for perspective models and s = theta for fisheyes. The lens images it at d. The distortion is (d -
# i) . i / |i|, averaged over phi. It is drawn against the mean of |d|, the radius in the image.
# Terms without symmetry about the axis cancel in the mean.
#
# With the covariance C of the parameters p, the standard deviation of the curve is sqrt(g^T C g),
# where g is the derivative of the curve w.r.t. p, from central differences.

STEPS = 400
AROUND = 16
WIDEST_PERSPECTIVE, WIDEST_FISHEYE = 85.0, 130.0
DRAWN = 80
DIFFERENCE = 1e-5


@dataclass(frozen=True, eq=False, kw_only=True)
class LensCurve:
    """Distortion of one camera.

    Attributes:
        camera_id: id of the camera.
        model: camera model.
        radius: (n,) distance from the principal point in the image [pixels], ascending.
        distortion: (n,) distortion, positive outwards [pixels].
        sigma: (n,) standard deviation [pixels]; empty without a covariance.
        observed_radius: largest distance of an observation from the principal point [pixels]; NaN
            without observations.
        corner_radius: distance of the farthest image corner; NaN if the image size is unknown.
        fold_radius: radius at which the image stops growing with the angle, if it is inside the
            image; otherwise NaN.
    """

    camera_id: int
    model: str
    radius: NDArray[np.float64]
    distortion: NDArray[np.float64]
    sigma: NDArray[np.float64]
    observed_radius: float
    corner_radius: float
    fold_radius: float


def most_observed_cameras(problem: Problem, most: int = MOST_CAMERAS) -> list[int]:
    """Return indices of at most ``most`` observed cameras, most observations first."""
    return by_observations(observations_of_cameras(problem))[:most]


def lens_curves(
    problem: Problem,
    cameras: Sequence[int],
    covariances: Mapping[int, NDArray[np.float64]] | None = None,
) -> list[LensCurve]:
    """Return the curves of some cameras by index; cameras without focal length have none."""
    of = problem.image_camera[problem.observation_image]
    order = np.argsort(of, kind="stable")
    wanted = np.array([*cameras], np.int64)
    ends = np.searchsorted(of[order], np.stack([wanted, wanted + 1]))
    seen = (problem.observation_xy[order[begin:end]] for begin, end in ends.T.tolist())
    known = {} if covariances is None else covariances
    made = (
        _lens_curve(problem, camera, known.get(camera), xy)
        for camera, xy in zip(cameras, seen, strict=True)
    )
    return [curve for curve in made if curve is not None]


def lens_curve(
    problem: Problem, camera: int, covariance: NDArray[np.float64] | None = None
) -> LensCurve | None:
    """Return the curve of a camera; None for a model without focal length.

    Args:
        problem: problem with the camera.
        camera: index of the camera.
        covariance: (k, k) of its parameters in COLMAP's order; NaN for constant parameters.
    """
    given = {} if covariance is None else {camera: covariance}
    found = lens_curves(problem, [camera], given)
    return found[0] if found else None


def _lens_curve(
    problem: Problem,
    camera: int,
    covariance: NDArray[np.float64] | None,
    seen: NDArray[np.float64],
) -> LensCurve | None:
    model = problem.camera_models[camera]
    center = principal_point(problem, camera)
    if center is None:
        return None
    params = problem.camera_params[camera, : len(camera_models()[model])]
    width, height = problem.camera_sizes[camera].tolist()
    corner = np.nan
    if width > 0 and height > 0:
        corners = np.array([(0, 0), (width, 0), (0, height), (width, height)], float)
        corner = float(np.linalg.norm(corners - center, axis=1).max())
    observed = float(np.linalg.norm(seen - center, axis=1).max()) if len(seen) else np.nan
    reach = corner if np.isfinite(corner) else 1.05 * observed
    widest = WIDEST_PERSPECTIVE if model in PERSPECTIVE else WIDEST_FISHEYE
    angles = np.deg2rad(np.linspace(0.0, widest, STEPS + 1)[1:])
    # Sample finer within the image: up to the first angle with twice the undistorted radius.
    fx, fy, *_ = focal_and_center(model, params)
    ideal = max(fx, fy) * (np.tan(angles) if model in PERSPECTIVE else angles)
    if np.isfinite(reach) and (ideal > 2 * reach).any():
        angles = np.linspace(0.0, angles[np.argmax(ideal > 2 * reach)], STEPS + 1)[1:]
    radius, distortion = _curve(model, params, angles)
    grows = np.isfinite(radius) & (np.diff(radius, prepend=0.0) > 0)
    last = len(radius) if grows.all() else int(np.argmin(grows))
    beyond = radius[:last] > reach
    stop = int(np.argmax(beyond)) if beyond.any() else last
    fold = float(radius[last - 1]) if 0 < last < len(radius) and not beyond.any() else np.nan
    chosen = np.unique(np.linspace(0, stop - 1, min(DRAWN, stop)).astype(int))
    angles, radius, distortion = angles[chosen], radius[chosen], distortion[chosen]
    return LensCurve(
        camera_id=int(problem.camera_ids[camera]),
        model=model,
        radius=np.concatenate([[0.0], radius]),
        distortion=np.concatenate([[0.0], distortion]),
        sigma=_sigma(model, params, angles, covariance),
        observed_radius=observed,
        corner_radius=corner,
        fold_radius=fold,
    )


def _curve(
    model: str, params: NDArray[np.float64], angles: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    around = np.arange(AROUND) * (2 * np.pi / AROUND)
    angle, phi = (grid.ravel() for grid in np.meshgrid(angles, around, indexing="ij"))
    unit = np.column_stack([np.cos(phi), np.sin(phi)])
    rays = np.column_stack([np.sin(angle)[:, None] * unit, np.cos(angle)])
    xy, seen = project(model, params, rays)
    xy[~seen] = np.nan
    fx, fy, cx, cy = focal_and_center(model, params)
    length = np.tan(angle) if model in PERSPECTIVE else angle
    ideal = unit * (fx, fy) * length[:, None]
    placed = xy - (cx, cy)
    outwards = ((placed - ideal) * ideal).sum(axis=1) / np.linalg.norm(ideal, axis=1)
    shape = len(angles), AROUND
    radius = np.linalg.norm(placed, axis=1).reshape(shape).mean(axis=1)
    return radius, outwards.reshape(shape).mean(axis=1)


def _sigma(
    model: str,
    params: NDArray[np.float64],
    angles: NDArray[np.float64],
    covariance: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Return standard deviations with a leading 0 for the axis; empty without a covariance."""
    if covariance is None:
        return np.zeros(0)
    known = np.where(np.isfinite(covariance), covariance, 0.0)[: len(params), : len(params)]
    gradient = np.zeros((len(params), len(angles)))
    for index in np.flatnonzero(np.diag(known)):
        step = np.zeros(len(params))
        step[index] = DIFFERENCE * max(abs(params[index]), 1e-2)
        high, low = (_curve(model, params + sign * step, angles)[1] for sign in (1, -1))
        gradient[index] = (high - low) / (2 * step[index])
    variance = np.einsum("in,ij,jn->n", gradient, known, gradient)
    return np.concatenate([[0.0], np.sqrt(np.maximum(variance, 0.0))])


def correlation_figure(problem: Problem, known: Certainty, camera: int) -> Figure | None:
    """Return the correlations of a camera's refined parameters; None for fewer than two."""
    free, values = known.correlations(camera)
    if len(free) < 2:
        return None
    names = camera_models()[problem.camera_models[camera]]
    matrix = Matrix(tuple(names[index] for index in free), values)
    title = f"Camera {problem.camera_ids[camera]}, {problem.camera_models[camera]}"
    return Figure(name="correlations", title=title, marks=(matrix,))
