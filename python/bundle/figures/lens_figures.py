"""Figures of lenses: distortion along the radius, and the certainty of projections."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bundle.base.words import number, plural
from bundle.figures.axes import Axis, linear, logarithmic
from bundle.figures.drawing import Figure, over_image
from bundle.figures.lens_curves import LensCurve
from bundle.figures.marks import GREY, Array, Cells, Line, Places
from bundle.figures.projection_uncertainty import ProjectionUncertainty, contour_levels

NONE = 1e-6
"""Limit in pixels below which distortion is a rounding error."""

MOST_NAMED = 6
"""Largest number of curves with a colour and a label each."""

WIDE = 20.0
"""Ratio of sigmas above which the axis is logarithmic."""


def lens_figure(curves: Mapping[str, LensCurve], title: str = "", note: str = "") -> Figure:
    """Return the figure of distortion against the distance from the principal point.

    Args:
        curves: curves by label. "before" is grey and dashed. The others have sigma bands, and
            marks at the farthest observation and at the farthest image corner. More than 6 curves
            are faint, without labels and bands, and have the marks of all together.
        title: title of the figure.
        note: text below the figure.
    """
    lines, places = [], []
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
        if not before and not many:
            places.append(_places([curve], colour if len(now) > 1 else GREY))
    if many:
        places.append(_places([*curves.values()], GREY))
    spread = [0.0 if line.sigma is None else line.sigma for line in lines]
    ends = [line.y + sign * s for line, s in zip(lines, spread, strict=True) for sign in (-1, 1)]
    heights = np.concatenate([np.zeros(0), *ends])
    heights = heights[np.isfinite(heights)]
    if (np.abs(heights) < NONE).all():
        heights = np.array([-1.0, 1.0])
    reach = [x for line in lines for x in line.x.tolist()]
    reach += [x for mark in places for x in mark.at.values()]
    return Figure(
        name="distortion",
        title=title,
        x=linear([0.0, *reach], "distance from the principal point [px]"),
        y=linear([*heights.tolist(), 0.0], "distortion [px]", low=None),
        marks=(*lines, *places),
        note=note,
    )


def _places(curves: Sequence[LensCurve], colour: int) -> Places:
    found = {
        "observed": max(curve.observed_radius for curve in curves),
        "corner": max(curve.corner_radius for curve in curves),
    }
    return Places({name: value for name, value in found.items() if math.isfinite(value)}, colour)


def focal_figure(
    ids: Array, values: Mapping[str, Array], sigmas: Mapping[str, Array], title: str
) -> Figure:
    """Return the focal lengths of several cameras with their standard deviations.

    Args:
        ids: (n,) ids of the cameras.
        values: (n,) focal lengths by the name of the parameter [pixels].
        sigmas: (n,) standard deviations by name, NaN where unknown.
        title: title of the figure.
    """
    words = []
    for name, value in values.items():
        typical = sigmas[name][np.isfinite(sigmas[name])]
        words.append(f"{name}: spread {number(float(np.std(value)))} px")
        if len(typical):
            words[-1] += f", median sigma {number(float(np.median(typical)))} px"
    # Bars of focal lengths that are not determined would hide the spread of the others.
    every = np.concatenate([*values.values()])
    margin = 0.25 * float(np.ptp(every)) or 0.01 * float(every.mean())
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
    """Return the figure of the uncertainty over the image, with contours.

    Args:
        known: uncertainty of a camera.
        distance: distance of the points [length unit].
        words: description of the distance, for the note.
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
