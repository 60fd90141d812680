"""Figures of residuals: histograms, image planes of cameras, single images."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import pixels, plural
from bundle.errors import shown
from bundle.figures.marks import (
    GREY,
    Array,
    Cells,
    Dots,
    Figure,
    Line,
    Photo,
    Steps,
    Vectors,
    linear,
    logarithmic,
    over_image,
    round_down,
)
from bundle.figures.residual_field import SIGNIFICANT, ResidualField, residual_fields
from bundle.model.problem import Problem
from bundle.model.residuals import ImageError, Residuals, worst_of_errors

MOST_IMAGES = 2000  # number of images with a dot each; of more images every k-th has one

LONGEST = 0.08  # drawn length of the largest residual, relative to the longer side of the image

CELL_NUMBERS = {
    "significance": ("Significance of the mean", "standard errors"),
    "magnitude": ("Magnitude", "px RMSE"),
    "count": ("Count", "observations"),
}
"""Title and unit of each value of a cell, by name."""


def coordinate_figure(histogram: ResidualHistogram) -> Figure:
    """Return histograms of the coordinates, and the normal distribution for the last set."""
    last = [*histogram.coordinates][-1]
    drawn = _histograms(histogram.edges, histogram.coordinates)
    x, y = _normal(histogram, last)
    note = f"Dashed: the normal distribution of sigma {histogram.sigma[last]:.3g} px"
    note += ", from the median."
    outside = ", ".join(
        f"{share:.2%} {label}" for label, share in histogram.share_outside.items() if share
    )
    return Figure(
        name="coordinates",
        title="Coordinates",
        x=linear(histogram.edges.tolist(), "residual in x or y [px]", low=None),
        y=linear([0.0, 1.05 * _highest(histogram.coordinates)], "count"),
        marks=(*drawn, Line("", x, y, colour=GREY, dash=1)),
        note=note + (f" Beyond the axis: {outside}." if outside else ""),
    )


def length_figure(histogram: ResidualHistogram) -> Figure:
    """Return histograms of the lengths on a logarithmic axis."""
    label = "length of the residual [px], log scale"
    return Figure(
        name="lengths",
        title="Lengths",
        x=logarithmic(histogram.length_edges.tolist(), label),
        y=linear([0.0, 1.05 * _highest(histogram.lengths)], "count"),
        marks=_histograms(histogram.length_edges, histogram.lengths),
    )


def image_error_figure(problem: Problem, found: Residuals) -> Figure:
    """Return the RMSE of each image by its id, and their median."""
    of = problem.observation_image[found.counted]
    squares = np.bincount(of, found.lengths[found.counted] ** 2, problem.num_images)
    count = np.bincount(of, minlength=problem.num_images)
    there = np.flatnonzero(count)
    order = there[np.argsort(problem.image_ids[there], kind="stable")]
    order = order[:: max(-(-len(order) // MOST_IMAGES), 1)]
    ids, rmse = problem.image_ids[order].astype(float), np.sqrt(squares[order] / count[order])
    ends = ids[[0, -1]] if len(ids) else np.array([0.0, 1.0])
    middle = np.full(2, np.median(rmse) if len(rmse) else np.nan)
    return Figure(
        name="rmse_by_image",
        title="RMSE by image",
        x=linear([ends[0] - 0.5, ends[1] + 0.5], "image id", low=None),
        y=linear([0.0, *(1.05 * rmse).tolist()], "RMSE [px]"),
        marks=(
            Line("", ids, rmse, colour=0, is_dotted=True),
            Line("", ends, middle, colour=GREY, dash=1),
        ),
        note="Dashed: the median.",
    )


def _histograms(edges: Array, counts: dict[str, np.ndarray]) -> tuple[Steps, ...]:
    return tuple(
        Steps(label, edges, values.astype(float), index)
        for index, (label, values) in enumerate(counts.items())
    )


def _highest(counts: dict[str, np.ndarray]) -> float:
    return max((float(values.max(initial=0)) for values in counts.values()), default=1.0) or 1.0


def _normal(histogram: ResidualHistogram, label: str) -> tuple[Array, Array]:
    """Return a normal distribution fitted to the middle of a histogram, as counts per bin."""
    sigma, edges = max(histogram.sigma[label], 1e-300), histogram.edges
    inside = float(histogram.coordinates[label].sum())
    total = inside / max(1.0 - histogram.share_outside[label], 1e-12)
    top = total * (edges[1] - edges[0]) / (sigma * np.sqrt(2 * np.pi))
    x = np.linspace(edges[0], edges[-1], 121)
    return x, top * np.exp(-0.5 * (x / sigma) ** 2)


def field_figures(field: ResidualField) -> tuple[Figure, ...]:
    """Return the figures over a camera's image plane."""
    return (
        vector_figure(field, field.vector_factor),
        direction_figure(field),
        *(cell_figure(field, name) for name in CELL_NUMBERS),
        profile_figure(field),
    )


def vector_figure(field: ResidualField, factor: float) -> Figure:
    """Return the mean residual of each cell, enlarged by ``factor``, bold if significant."""
    rows, columns = field.count.shape
    cells = np.flatnonzero(field.count.ravel() > 0)
    row, column = np.divmod(cells, columns)
    middle = field.box[:2] + (np.column_stack([column, row]) + 0.5) * field.cell_size
    significance = field.significance.ravel()
    means = field.mean.reshape(-1, 2)

    def title(cell: int) -> str:
        count = int(field.count.ravel()[cell])
        if count == 0:
            return "no observation"
        x, y = means[cell]
        words = f"{plural(count, 'observation')}, mean {x:+.3f}, {y:+.3f} px"
        if np.isfinite(significance[cell]):
            words += f", significance {significance[cell]:.1f}"
        return words

    vectors = Vectors(
        middle, factor * means[cells], is_bold=significance[cells] > SIGNIFICANT, cells=cells,
        grid=(rows, columns), titles=tuple(map(title, range(rows * columns))),
    )  # fmt: skip
    note = f"lines {factor:g} times as long as residuals"
    return over_image(field.box, "mean residual of each cell", "Mean residual", vectors, note=note)


def direction_figure(field: ResidualField) -> Figure:
    """Return residuals as dots, coloured by direction: clusters of one colour are systematic."""
    dots = Dots(field.dots, directions=field.dot_residuals)
    note = f"{len(field.dots):,} residuals"
    return over_image(field.box, "directions of residuals", "Directions", dots, note=note)


def cell_figure(field: ResidualField, name: str) -> Figure:
    """Return the figure of a value per cell, one of ``CELL_NUMBERS``."""
    find: dict[str, Callable[[], Array]] = {
        "significance": lambda: field.significance,
        "magnitude": lambda: field.rms,
        "count": lambda: np.where(field.count > 0, field.count, np.nan).astype(float),
    }
    values = find[name]()
    known = values[np.isfinite(values)]
    top = float(np.quantile(known, 0.98)) if len(known) else 1.0
    top = max(top, 2 * SIGNIFICANT) if name == "significance" else top
    title, unit = CELL_NUMBERS[name]
    return over_image(field.box, name, title, Cells(values, top, unit))


def redundancy_figure(problem: Problem, redundancy: Array) -> Figure:
    """Return (n, 2) redundancies over the image plane of the camera, or kind, with the most."""
    counted = ~np.isnan(redundancy[:, 0])
    field = residual_fields(problem, Residuals(redundancy, counted), 1)[0]
    note = "Mean share of an error that its own residual shows; where it is near 0, errors hide."
    cells = Cells(field.mean.mean(axis=2), 1.0, "of an error")
    return over_image(field.box, "redundancy", "Redundancy over the images", cells, note=note)


def profile_figure(field: ResidualField) -> Figure:
    """Return mean radial and tangential residuals by distance from the principal point."""
    profile = field.profile
    parts = (
        ("outwards", profile.radial, profile.radial_error),
        ("across", profile.tangential, profile.tangential_error),
    )
    reach = [
        sign * (np.abs(mean) + np.where(np.isfinite(error), error, 0.0))
        for _, mean, error in parts
        for sign in (-1, 1)
    ]
    heights = np.concatenate(reach)
    heights = heights[np.isfinite(heights)] if np.isfinite(heights).any() else np.array([-1.0, 1.0])
    return Figure(
        name="radial_profile",
        title="Radial profile",
        x=linear([0.0, *profile.radius.tolist()], "distance from the principal point [px]"),
        y=linear(heights.tolist(), "mean residual [px]", low=None),
        marks=tuple(
            Line(name, profile.radius, mean, colour=index, error=error)
            for index, (name, mean, error) in enumerate(parts)
        ),
    )


def image_figure(
    image: ImageResiduals, factor: float | None = None, picture: object = None
) -> Figure:
    """Return the residuals of an image over ``picture``, ``factor`` times as long (None: round)."""
    box, round_factor = image_frame(image)
    factor = round_factor if factor is None else factor
    words = plural(len(image.xy), "residual")
    if len(image.xy) < image.error.num_observations:
        words = f"the largest {len(image.xy)} residuals"
    vectors = Vectors(image.xy, factor * image.residual)
    marks = (vectors,) if picture is None else (Photo(picture), vectors)
    note = f"{words}, {factor:g} times as long"
    name = image_name(image)
    title = f"{name}, RMSE {pixels(image.error.rmse)} px"
    return over_image(box, f"residuals of {name}", title, *marks, note=note)


def image_name(image: ImageResiduals) -> str:
    """Return the name of an image; without a name its id."""
    return shown(image.error.name) or f"image {image.error.image_id}"


def image_frame(image: ImageResiduals) -> tuple[Array, float]:
    """Return the box of an image, or of its observations, and a round factor for its residuals."""
    box = np.array([0.0, 0.0, 1.0, 1.0])
    if min(image.size) > 0:
        box[2:] = image.size
    elif len(image.xy):
        low, high = image.xy.min(axis=0), image.xy.max(axis=0)
        margin = max(0.05 * float((high - low).max()), 1.0)
        box = np.concatenate([low - margin, high + margin])
    largest = float(np.hypot(*image.residual.T).max(initial=0.0))
    size = float((box[2:] - box[:2]).max())
    return box, round_down(LONGEST * size / largest) if largest > 0 else 1.0


BINS = 61
SHARE = 0.99
WIDEST = 4.0


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualHistogram:
    """Histograms of sets of residuals with labels such as "before" and "after".

    Attributes:
        edges: (bins + 1,) edges of coordinates [pixels], symmetric about 0.
        coordinates: (bins,) counts of x and y together, by label.
        share_outside: share of the coordinates beyond the edges, by label.
        length_edges: (bins + 1,) edges of lengths [pixels], with a constant ratio.
        lengths: (bins,) counts, by label; lengths below the first edge are in the first bin.
        sigma: robust spread of the coordinates by label [pixels], 1.4826 median |r_x|, |r_y|; for
            normally distributed residuals it is their standard deviation.
    """

    edges: NDArray[np.float64]
    coordinates: dict[str, NDArray[np.int64]]
    share_outside: dict[str, float]
    length_edges: NDArray[np.float64]
    lengths: dict[str, NDArray[np.int64]]
    sigma: dict[str, float]


def residual_histogram(sets: dict[str, Residuals]) -> ResidualHistogram | None:
    """Return histograms of counted residuals; None if no observation counts.

    The axis of coordinates covers 99 % of the last set. It covers up to 99 % of the others, but at
    most four times the range of the last set.
    """
    values = {label: found.xy[found.counted] for label, found in sets.items()}
    if not values or not all(len(part) for part in values.values()):
        return None
    widths = [float(np.quantile(np.abs(part), SHARE)) for part in values.values()]
    limit = max(min(max(widths), WIDEST * widths[-1]), 1e-12)
    edges = np.linspace(-limit, limit, BINS + 1)
    lengths = {label: np.hypot(part[:, 0], part[:, 1]) for label, part in values.items()}
    positive = np.concatenate([part[part > 0] for part in lengths.values()])
    low, high = np.quantile(positive, [0.001, 1.0]) if len(positive) else (0.1, 1.0)
    length_edges = np.geomspace(max(low, high * 1e-9), high * (1 + 1e-9), BINS + 1)
    return ResidualHistogram(
        edges=edges,
        coordinates={label: np.histogram(part, edges)[0] for label, part in values.items()},
        share_outside={
            label: float((np.abs(part) > limit).mean()) for label, part in values.items()
        },
        length_edges=length_edges,
        lengths={
            label: np.histogram(np.maximum(part, length_edges[0]), length_edges)[0]
            for label, part in lengths.items()
        },
        sigma={label: 1.4826 * float(np.median(np.abs(part))) for label, part in values.items()},
    )


MOST_PHOTOGRAPHS = 6
MOST_ARROWS = 400


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageResiduals:
    """Residuals of one image.

    Attributes:
        error: RMSE, largest residual, name and id.
        camera_id: id of its camera.
        size: (2,) width and height [pixels]; 0 if unknown.
        xy: (n, 2) measured positions [pixels] of the largest residuals, at most 400.
        residual: (n, 2) residuals at these positions [pixels].
    """

    error: ImageError
    camera_id: int
    size: tuple[int, int]
    xy: NDArray[np.float64]
    residual: NDArray[np.float64]


def worst_residuals(
    problem: Problem, found: Residuals, most: int = MOST_PHOTOGRAPHS
) -> list[ImageResiduals]:
    """Return the residuals of the images with the largest RMSE, the largest first."""
    lengths = np.where(found.counted, found.lengths, np.nan)
    behind = np.zeros(len(lengths), bool)  # ignored observations have length NaN
    return image_residuals(
        problem, found, worst_of_errors(problem, lengths, behind, "algebraic", most=most)
    )


def image_residuals(
    problem: Problem, found: Residuals, images: Iterable[ImageError]
) -> list[ImageResiduals]:
    """Return the residuals of some images."""
    index = {int(image_id): place for place, image_id in enumerate(problem.image_ids)}
    counted = np.flatnonzero(found.counted)
    counted = counted[np.argsort(problem.observation_image[counted], kind="stable")]
    ends = np.searchsorted(problem.observation_image[counted], np.arange(problem.num_images + 1))
    result = []
    for error in images:
        image = index[error.image_id]
        camera = problem.image_camera[image]
        rows = counted[ends[image] : ends[image + 1]]
        rows = rows[np.argsort(-found.lengths[rows], kind="stable")[:MOST_ARROWS]]
        width, height = problem.camera_sizes[camera].tolist()
        result.append(
            ImageResiduals(
                error=error,
                camera_id=int(problem.camera_ids[camera]),
                size=(width, height),
                xy=problem.observation_xy[rows],
                residual=found.xy[rows],
            )
        )
    return result
