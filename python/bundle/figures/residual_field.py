"""Systematic residuals of a camera over cells and rows, and motions during the readout.

A wrong lens model causes residuals with the same direction in the same part of every image. In a
cell with n independent residuals r_i, the mean m has the standard error s per coordinate with


    s^2 = sum |r_i - m|^2 / (2 (n - 1) n),

with both coordinates pooled. The significance is |m| / s. Without systematic errors it has about a
Rayleigh distribution: 1 % of the cells exceed 3.03.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.figures.marks import GREY, Figure, Line, linear, round_down
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals

MOST_CAMERAS = 6  # number of cameras with their own fields

SIGNIFICANT = 3.03  # significance that 1 % of the cells exceed without systematic errors

MOST_CELLS = 24
PER_CELL = 12
FEWEST = 5
RINGS = 16
MOST_DOTS = 12_000


@dataclass(frozen=True, eq=False, kw_only=True)
class RadialProfile:
    """Residuals in radial and tangential direction, by distance from the principal point.

    Attributes:
        radius: (rings,) middle of each ring [pixels].
        count: (rings,) observations.
        radial: (rings,) mean residual outwards [pixels]; NaN in an empty ring.
        tangential: (rings,) mean tangential residual, clockwise in the image [pixels].
        radial_error: (rings,) standard error of ``radial``; NaN for fewer than two observations.
        tangential_error: (rings,) standard error of ``tangential``, likewise.
    """

    radius: NDArray[np.float64]
    count: NDArray[np.int64]
    radial: NDArray[np.float64]
    tangential: NDArray[np.float64]
    radial_error: NDArray[np.float64]
    tangential_error: NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualField:
    """Residuals over the image plane of one camera, or of several cameras pooled.

    Attributes:
        camera_ids: ids of the cameras.
        num_images: number of images of these cameras.
        box: (4,) left, top, right, bottom of the grid [pixels].
        center: (2,) principal point, or its mean over several cameras.
        count: (rows, columns) observations in each cell.
        mean: (rows, columns, 2) mean residual [pixels]; NaN in an empty cell.
        rms: (rows, columns) root mean square of |r| [pixels]; NaN in an empty cell.
        standard_error: (rows, columns) standard error of each coordinate of the mean [pixels]; NaN
            in a cell with fewer than 5 observations.
        num_outside: observations outside the grid.
        profile: residuals by distance from the principal point.
        dots: (n, 2) positions of some observations, evenly sampled [pixels].
        dot_residuals: (n, 2) residuals of these observations.
    """

    camera_ids: tuple[int, ...]
    num_images: int
    box: NDArray[np.float64]
    center: NDArray[np.float64]
    count: NDArray[np.int64]
    mean: NDArray[np.float64]
    rms: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    num_outside: int
    profile: RadialProfile
    dots: NDArray[np.float64]
    dot_residuals: NDArray[np.float64]

    @property
    def significance(self) -> NDArray[np.float64]:
        """(rows, columns) length of the mean in standard errors; NaN with too few observations."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.hypot(self.mean[..., 0], self.mean[..., 1]) / self.standard_error

    @property
    def num_observations(self) -> int:
        """Number of observations in the grid."""
        return int(self.count.sum())

    @property
    def cell_size(self) -> tuple[float, float]:
        """Width and height of a cell [pixels]."""
        rows, columns = self.count.shape
        left, top, right, bottom = self.box
        return float(right - left) / columns, float(bottom - top) / rows

    @property
    def num_significant(self) -> tuple[int, int]:
        """Number of cells with a significant mean, and number of cells that were tested."""
        known = self.significance[np.isfinite(self.significance)]
        return int((known > SIGNIFICANT).sum()), len(known)

    @property
    def vector_factor(self) -> float:
        """Round factor for drawing mean vectors, so that the 95th percentile fills a cell."""
        lengths = np.hypot(self.mean[..., 0], self.mean[..., 1])[self.count > 0]
        typical = float(np.quantile(lengths, 0.95)) if len(lengths) else 0.0
        return round_down(min(self.cell_size) / typical, 1e-3) if typical > 0 else 1.0


def residual_fields(
    problem: Problem, found: Residuals, most: int = MOST_CAMERAS
) -> list[ResidualField]:
    """Return the fields of the cameras with the most observations.

    If more than ``most`` cameras are observed, the first field pools all cameras with the most
    frequent model and image size, and fields of ``most`` - 1 cameras follow.

    Args:
        problem: problem with the cameras.
        found: residuals of the problem.
        most: largest number of fields.
    """
    number = observations_of_cameras(problem, found.counted)
    observed = by_observations(number)
    groups: list[Sequence[int]] = [[index] for index in observed[:most]]
    if len(observed) > most:
        kinds: dict[tuple[str, int, int], list[int]] = {}
        for index in sorted(observed):
            width, height = problem.camera_sizes[index].tolist()
            kinds.setdefault((problem.camera_models[index], width, height), []).append(index)
        commonest = max(kinds.values(), key=lambda cameras: int(number[cameras].sum()))
        groups = [commonest, *groups[: most - 1]] if len(commonest) > 1 else groups
    return [field_of(problem, found, group) for group in groups]


def observations_of_cameras(
    problem: Problem, counted: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """Return (num_cameras,) numbers of observations of each camera, or of counted ones only."""
    image = problem.observation_image if counted is None else problem.observation_image[counted]
    return np.bincount(problem.image_camera[image], minlength=problem.num_cameras)


def by_observations(number: NDArray[np.int64]) -> list[int]:
    """Return indices of the cameras with observations, most observations first."""
    observed = np.flatnonzero(number)
    ordered: list[int] = observed[np.argsort(-number[observed], kind="stable")].tolist()
    return ordered


def field_of(problem: Problem, found: Residuals, cameras: Sequence[int]) -> ResidualField:
    """Return the pooled field of some cameras, given by index."""
    members = np.isin(problem.image_camera, cameras)
    chosen = np.flatnonzero(found.counted & members[problem.observation_image])
    xy, residual = problem.observation_xy[chosen], found.xy[chosen]
    box = image_box(xy, problem.camera_sizes[cameras[0]])
    centers = [principal_point(problem, index) for index in cameras]
    known = [center for center in centers if center is not None]
    center = np.mean(known, axis=0) if known else (box[:2] + box[2:]) / 2
    inside = ((xy >= box[:2]) & (xy <= box[2:])).all(axis=1)
    num_outside = int((~inside).sum())
    xy, residual = xy[inside], residual[inside]
    columns, rows = _cells(box, len(xy))
    step = max(-(-len(xy) // MOST_DOTS), 1)
    return ResidualField(
        camera_ids=tuple(int(problem.camera_ids[index]) for index in cameras),
        num_images=int(members.sum()),
        box=box,
        center=center,
        num_outside=num_outside,
        **_statistics(xy, residual, box, columns, rows),
        profile=_profile(xy - center, residual),
        dots=xy[::step],
        dot_residuals=residual[::step],
    )


def principal_point(problem: Problem, camera: int) -> NDArray[np.float64] | None:
    """Return the principal point of a camera by its index; None for models without one."""
    model = problem.camera_models[camera]
    places = [i for i, kind in enumerate(param_kinds(model)) if kind == "principal_point"]
    return problem.camera_params[camera, places] if len(places) == 2 else None


def image_box(xy: NDArray[np.float64], size: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the box of the image, or of the observations if the size is unknown or unused."""
    inside = ((xy >= 0) & (xy <= size)).all(axis=1)
    if (size > 0).all() and 2 * inside.sum() >= len(xy):
        return np.array([0.0, 0.0, *size])
    low, high = np.quantile(xy, [0.001, 0.999], axis=0)
    margin = np.maximum(0.02 * (high - low), 0.5)
    return np.concatenate([low - margin, high + margin])


def _cells(box: NDArray[np.float64], count: int) -> tuple[int, int]:
    """Return columns and rows of nearly square cells with about 12 observations on average."""
    width, height = box[2:] - box[:2]
    cells = max(count / PER_CELL, 1.0)
    side = max(np.sqrt(width * height / cells), max(width, height) / MOST_CELLS)
    columns, rows = np.clip(np.rint([width / side, height / side]), 1, MOST_CELLS)
    return int(columns), int(rows)


def _statistics(
    xy: NDArray[np.float64],
    residual: NDArray[np.float64],
    box: NDArray[np.float64],
    columns: int,
    rows: int,
) -> dict[str, NDArray[Any]]:
    place = (xy - box[:2]) / (box[2:] - box[:2]) * (columns, rows)
    column, row = np.minimum(place.astype(np.int64), (columns - 1, rows - 1)).T
    cell, size = row * columns + column, rows * columns
    count = np.bincount(cell, minlength=size)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.stack([np.bincount(cell, part, size) / count for part in residual.T], axis=-1)
        squares = np.bincount(cell, (residual**2).sum(axis=1), size)
        spread = np.bincount(cell, ((residual - mean[cell]) ** 2).sum(axis=1), size)
        error = np.sqrt(spread / (2.0 * (count - 1) * count))
    error[count < FEWEST] = np.nan
    return {
        "count": count.reshape(rows, columns),
        "mean": mean.reshape(rows, columns, 2),
        "rms": np.sqrt(squares / np.where(count, count, np.nan)).reshape(rows, columns),
        "standard_error": error.reshape(rows, columns),
    }


def _profile(offset: NDArray[np.float64], residual: NDArray[np.float64]) -> RadialProfile:
    radius = np.hypot(offset[:, 0], offset[:, 1])
    unit = offset / np.where(radius > 0, radius, 1.0)[:, None]
    outwards = (unit * residual).sum(axis=1)
    across = unit[:, 0] * residual[:, 1] - unit[:, 1] * residual[:, 0]
    edges = np.linspace(0.0, max(float(radius.max(initial=0.0)), 1e-9), RINGS + 1)
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, RINGS - 1)
    count = np.bincount(ring, minlength=RINGS)
    means, errors = [], []
    with np.errstate(divide="ignore", invalid="ignore"):
        for part in (outwards, across):
            mean = np.bincount(ring, part, RINGS) / count
            spread = np.bincount(ring, (part - mean[ring]) ** 2, RINGS)
            means.append(mean)
            errors.append(np.sqrt(spread / ((count - 1.0) * count)))  # 0 / 0 for count below 2
    return RadialProfile(
        radius=(edges[1:] + edges[:-1]) / 2,
        count=count,
        radial=means[0],
        tangential=means[1],
        radial_error=errors[0],
        tangential_error=errors[1],
    )


# Residuals by row: what the images of a moving camera with a rolling shutter have in common.
#
# An image that moves by (a, b) pixels during its readout has residuals of about (a, b) s at the row
# s from the middle, as a share of the height. Its pose absorbs shift and rotation, its focal length
# a part; what remains grows towards the first and the last row: shear in x, anisotropy in y. Signs
# and sizes differ from image to image, so that means over all images vanish. The profile therefore
# has the size of the mean residual of an image in a band of rows, over the images i with n_i >= 3
# observations there:
#
#     size = sqrt(mean of m_i^2),    noise: sqrt(mean of sigma^2 / n_i),
#
# with m_i the mean of a coordinate, and sigma from the median length, which is 1.1774 sigma.
# Residuals beyond 5 sigma are left out. Without motion, size and noise agree in all bands.

NUM_BANDS = 12
FEWEST_IN_ROW = 3
FEWEST_IMAGES = 3
_RAYLEIGH_MEDIAN = 1.17741
_OUTLIER = 5.0


@dataclass(frozen=True, eq=False, kw_only=True)
class RowResiduals:
    """Sizes of the mean residuals of images in bands of rows.

    Attributes:
        is_by_column: True for bands of columns, if most cameras are read column by column.
        row: (bands,) middle of each band, as a share of the height, 0 at the top.
        num_images: (bands,) images with enough observations.
        size: (bands, 2) rms over the images of the mean residual in x and y [pixels]; NaN with
            fewer than 3 images.
        noise: (bands,) expectation of both without motion [pixels].
    """

    is_by_column: bool
    row: NDArray[np.float64]
    num_images: NDArray[np.int64]
    size: NDArray[np.float64]
    noise: NDArray[np.float64]


def row_residuals(problem: Problem, found: Residuals) -> RowResiduals | None:
    """Return the residuals of a problem by row; None if sizes of images are unknown."""
    camera = problem.image_camera[problem.observation_image]
    size = problem.camera_sizes[camera]
    chosen = found.counted & (size > 0).all(axis=1)
    if not chosen.any():
        return None
    lengths = found.lengths[chosen]
    sigma = float(np.median(lengths)) / _RAYLEIGH_MEDIAN
    rows = np.flatnonzero(chosen)[lengths <= _OUTLIER * sigma]
    shutter = problem.rolling_shutter
    axis = np.zeros(len(camera), int) if shutter is None else shutter.axis[camera]
    by_column = bool((axis[rows] == 2).mean() > 0.5) if len(rows) else False
    coordinate = 0 if by_column else 1
    share = problem.observation_xy[rows, coordinate] / size[rows, coordinate]
    band = np.clip((share * NUM_BANDS).astype(np.int64), 0, NUM_BANDS - 1)
    cell = problem.observation_image[rows].astype(np.int64) * NUM_BANDS + band
    cells = problem.num_images * NUM_BANDS
    count = np.bincount(cell, minlength=cells).reshape(-1, NUM_BANDS)
    there = count >= FEWEST_IN_ROW
    num_images = there.sum(axis=0)
    known = np.where(num_images >= FEWEST_IMAGES, num_images, np.nan)
    weight = there / np.maximum(count, 1)
    means = [
        np.bincount(cell, found.xy[rows, k], cells).reshape(-1, NUM_BANDS) * weight for k in (0, 1)
    ]
    return RowResiduals(
        is_by_column=by_column,
        row=(np.arange(NUM_BANDS) + 0.5) / NUM_BANDS,
        num_images=num_images,
        size=np.stack([np.sqrt((mean**2).sum(axis=0) / known) for mean in means], axis=1),
        noise=sigma * np.sqrt(weight.sum(axis=0) / known),
    )


def rows_of_sets(sets: Mapping[str, tuple[Problem, Residuals]]) -> dict[str, RowResiduals]:
    """Return the residuals by row of labelled problems whose images have known sizes."""
    found = {label: row_residuals(*one) for label, one in sets.items()}
    return {label: one for label, one in found.items() if one is not None}


def row_figure(sets: Mapping[str, RowResiduals]) -> Figure:
    """Return the sizes by row of labelled sets; the last is solid, earlier ones are dashed."""
    last = [*sets][-1]
    marks = []
    for label, found in sets.items():
        words = "" if len(sets) == 1 else f" {label}"
        for k, name in enumerate(("x", "y")):
            dash = 0 if label == last else 1
            marks.append(Line(name + words, found.row, found.size[:, k], colour=k, dash=dash))
    now = sets[last]
    marks.append(Line("noise alone", now.row, now.noise, colour=GREY, dash=2))
    what = "column / width" if now.is_by_column else "row / height"
    name = "column" if now.is_by_column else "row"
    highest = [float(np.nanmax(mark.y, initial=0.0)) for mark in marks]
    return Figure(
        name="row_residuals",
        title=f"Residuals by {name}",
        x=linear([0.0, 1.0], what),
        y=linear([0.0, *(1.05 * value for value in highest)], "mean residual of an image [px]"),
        marks=tuple(marks),
        note="Shear (x) and anisotropy (y) of single images. A rolling shutter lifts the first "
        f"and the last {name}s above the noise.",
    )


def twist_figures(problem: Problem) -> list[Figure]:
    """Return rotations and translations of the twists by image; empty without any.

    Images are in the order of their frames if all frames are known, or else of their names. Twists
    of neighbours in a film are alike; a jump is shake, or an image that does not determine its
    twist.
    """
    shutter = problem.rolling_shutter
    if shutter is None:
        return []
    images = np.flatnonzero(shutter.is_rolling[problem.image_camera])
    if not len(images) or not shutter.twist[images].any():
        return []
    frames = None if shutter.frames is None else shutter.frames[images]
    if frames is None or not np.isfinite(frames).all():
        names = np.array(problem.image_names)[images] if problem.image_names else images
        order, what = np.argsort(names, kind="stable"), "image"
        x = np.arange(len(images), dtype=float)
    else:
        order, what = np.argsort(frames, kind="stable"), "frame"
        x = frames[order]
    twist = shutter.twist[images[order]]
    return [
        _figure("rotation", "Rotation during the readout", x, what, np.degrees(twist[:, :3]), "°"),
        _figure(
            "translation", "Translation during the readout", x, what, twist[:, 3:], "length units"
        ),
    ]


def _figure(
    name: str, title: str, x: NDArray[np.float64], what: str, twist: NDArray[np.float64], unit: str
) -> Figure:
    lines = [Line(axis, x, twist[:, k], colour=k) for k, axis in enumerate("xyz")]
    ends = np.array([float(x[0]), float(max(x[-1], x[0] + 1))])
    return Figure(
        name=f"twist_{name}",
        title=title,
        x=linear(ends.tolist(), what, low=None),
        y=linear([0.0, *twist.ravel().tolist()], f"{name} [{unit}]", low=None),
        marks=(*lines, Line("", ends, np.zeros(2), colour=GREY, dash=2)),
        note="In the camera's frame, per height of the image (width for columns).",
    )
