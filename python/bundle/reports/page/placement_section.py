"""Control points and measured positions: tables of their errors, and ellipses."""

from __future__ import annotations

import math
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number, pixels, plural
from bundle.figures.placement_errors import Placement
from bundle.reports.page.page import tag
from bundle.reports.page.scale import Scale, linear
from bundle.reports.page.svg_charts import (
    BOTTOM,
    HEIGHT,
    LEFT,
    RIGHT,
    TOP,
    WIDTH,
    axes,
    place_x,
    place_y,
)
from bundle.reports.page.table import table

__all__ = ["placement_data", "placement_section"]

ROWS = 12
LETTER = 7.4
"""Width of a letter of a label."""

SHAPE = (WIDTH - LEFT - RIGHT) / (HEIGHT - TOP - BOTTOM)


def placement_section(place: Placement) -> str:
    """Return tables and figures; all lengths are metres east, north, up."""
    system = place.reference_system
    words = "Metres east, north, up: model minus measurement."
    words += f" Coordinates were read in {system}." if system else ""
    parts = [tag("p", escape(words), class_="quiet"), _rms(place)]
    if place.targets:
        parts += [tag("h3", "Control and check points"), _targets(place), _target_figures(place)]
    if place.images:
        parts += [tag("h3", "Measured positions of images"), _positions(place)]
        parts.append(_position_figures(place))
    return "".join(parts)


def placement_data(place: Placement) -> dict[str, Any]:
    """Return the numbers of the figures."""
    return {
        "targets": [
            {"name": t.name, "role": t.role, "residual": t.residual.tolist(),
             "sigma": t.sigma.tolist()}
            for t in place.targets
        ],
        "images": [
            {"name": i.name, "position": i.position.tolist(), "residual": i.residual.tolist(),
             "used": i.used}
            for i in place.images
        ],
    }  # fmt: skip


def _rms(place: Placement) -> str:
    head = ["RMS error", "count", "east [m]", "north [m]", "up [m]", "horizontal [m]", "total [m]"]
    rows = []
    for kind, name in (("control", "control points"), ("check", "check points"),
                       ("gps", "positions of images")):  # fmt: skip
        used = [image for image in place.images if image.used]
        count = len(used) if kind == "gps" else sum(t.role == kind for t in place.targets)
        if count:
            rows.append([name, f"{count}", *map(_metres, place.rms(kind))])
    return table(head, rows) if rows else ""


def _targets(place: Placement) -> str:
    head = ["point", "role", "images", "east [m]", "north [m]", "up [m]", "sigma [m]",
            "left out [m]", "RMSE [px]"]  # fmt: skip
    rows = [
        [target.name, "suspect" if target.suspect else target.role, f"{target.num_images}",
         *map(_metres, target.residual), _sigma(target.sigma), _metres(_length(target.left_out)),
         pixels(target.pixels)]
        for target in place.targets
    ]  # fmt: skip
    words = "Left out: the length of the error where the other points alone place the model."
    return table(head, rows, rows_shown=ROWS) + tag("p", words, class_="quiet")


def _target_figures(place: Placement) -> str:
    known = [t for t in place.targets if np.isfinite(t.residual[:2]).all()]
    if not known:
        return ""
    sigmas = sorted({(float(t.sigma[0]), float(t.sigma[1])) for t in known})
    residuals = np.array([t.residual[:2] for t in known])
    reach = 1.15 * float(np.abs(residuals).max(initial=0.0))
    reach = max(reach, 1.15 * max(max(pair) for pair in sigmas), 1e-9)
    x_scale, y_scale = _square(np.zeros(2), reach)
    marks = [
        _ellipse(np.zeros(2), np.diag(np.square(pair)), x_scale, y_scale, 2) for pair in sigmas
    ]
    controls = np.array([t.residual[:2] for t in known if t.role == "control"])
    if len(controls):
        moment = controls.T @ controls / len(controls)
        marks.append(_ellipse(np.zeros(2), moment, x_scale, y_scale, 0))
    roles = {"control": 0, "check": 1}
    marks += [
        _dot(target.residual, x_scale, y_scale, roles.get(target.role, 6), target.name)
        for target in known
    ]
    marks += _labels(residuals, [target.name for target in known], x_scale, y_scale)
    words = (
        "Blue: control points, with the ellipse of their root mean square; orange: check points; "
        "green: one standard deviation of the survey. Names where there is room."
    )
    chart = _chart(x_scale, y_scale, marks, "error east [m]", "error north [m]")
    figure = tag("figure", tag("h4", "Horizontal errors"), chart, tag("figcaption", words))
    return tag("div", figure, class_="grid")


def _positions(place: Placement) -> str:
    head = ["image", "used", "east [m]", "north [m]", "up [m]", "sigmas"]
    ranked = sorted(place.images, key=lambda i: -i.sigmas if math.isfinite(i.sigmas) else 1.0)
    rows = [
        [image.name, "yes" if image.used else "no", *map(_metres, image.residual),
         f"{image.sigmas:.1f}" if math.isfinite(image.sigmas) else "-"]
        for image in ranked
        if np.isfinite(image.residual).any()
    ]  # fmt: skip
    without = len(place.images) - len(rows)
    words = f"{plural(without, 'image')} without a position." if without else ""
    note = tag("p", words, class_="quiet") if words else ""
    return table(head, rows, rows_shown=ROWS) + note


def _position_figures(place: Placement) -> str:
    known = [i for i in place.images if np.isfinite(i.residual[:2]).all()]
    if not known:
        return ""
    residuals = np.array([i.residual[:2] for i in known])
    moment = residuals.T @ residuals / len(residuals)
    reach = 1.15 * max(float(np.abs(residuals).max()), 1e-9)
    x_scale, y_scale = _square(np.zeros(2), reach)
    marks = [_dot(i.residual, x_scale, y_scale, 0 if i.used else 6, i.name) for i in known]
    marks.append(_ellipse(np.zeros(2), moment, x_scale, y_scale, 1))
    scatter = _chart(x_scale, y_scale, marks, "error east [m]", "error north [m]")
    figures = [
        tag("figure", tag("h4", "Horizontal errors"), scatter,
            tag("figcaption", "Ellipse: one root mean square in every direction. "
                "Grey: without influence.")),
    ]  # fmt: skip
    placed = [i for i in known if np.isfinite(i.position).all()]
    if placed:
        figures.append(_plan(placed))
    return tag("div", *figures, class_="grid")


def _plan(placed: list[Any]) -> str:
    positions = np.array([i.position[:2] for i in placed])
    low, high = positions.min(axis=0), positions.max(axis=0)
    half = (high - low) / 2
    reach = 1.1 * max(half[0] / SHAPE, half[1], 1e-6)
    x_scale, y_scale = _square((low + high) / 2, reach)
    largest = max(float(np.hypot(*i.residual[:2])) for i in placed)
    factor = _round_down(0.2 * reach / largest) if largest > 0 else 1.0
    marks = []
    for image in placed:
        x, y = place_x(x_scale(image.position[0])), place_y(y_scale(image.position[1]))
        unit = (HEIGHT - TOP - BOTTOM) / (2 * reach) * factor
        dx, dy = image.residual[0] * unit, -image.residual[1] * unit
        marks.append(_dot(image.position, x_scale, y_scale, 0 if image.used else 6, image.name))
        if image.used or np.hypot(dx, dy) < HEIGHT:
            style = "stroke:var(--c1);stroke-width:1.6;fill:none"
            marks.append(tag("path", d=f"M{x:.1f} {y:.1f}l{-dx:.1f} {-dy:.1f}", style=style))
    chart = _chart(x_scale, y_scale, marks, "east [m]", "north [m]")
    words = f"Lines go from the camera towards the measured position, {factor:g} times as long."
    return tag("figure", tag("h4", "Plan"), chart, tag("figcaption", words))


def _square(center: NDArray[np.float64], reach: float) -> tuple[Scale, Scale]:
    """Return scales on which a metre is as long across as up."""
    ends = [(center[0], reach * SHAPE), (center[1], reach)]
    made = [linear([middle - half, middle + half], low=None) for middle, half in ends]
    return made[0], made[1]


def _chart(x_scale: Scale, y_scale: Scale, marks: list[str], x_label: str, y_label: str) -> str:
    return tag(
        "svg", *axes(x_scale, y_scale, x_label, y_label), *marks,
        viewBox=f"0 0 {WIDTH} {HEIGHT}", role="img", aria_label=f"{y_label} against {x_label}",
    )  # fmt: skip


def _dot(at: NDArray[np.float64], x_scale: Scale, y_scale: Scale, colour: int, name: str) -> str:
    return tag(
        "circle", tag("title", escape(name)), cx=f"{place_x(x_scale(at[0])):.1f}",
        cy=f"{place_y(y_scale(at[1])):.1f}", r=3.4, style=f"fill:var(--c{colour})",
    )  # fmt: skip


def _labels(at: NDArray[np.float64], names: list[str], x_scale: Scale, y_scale: Scale) -> list[str]:
    """Return the names that have room beside their dots."""
    dots = [(place_x(x_scale(x)), place_y(y_scale(y))) for x, y in at]
    taken = [(x - 4, y - 4, x + 4, y + 4) for x, y in dots]
    parts = []
    for (x, y), name in zip(dots, names, strict=True):
        width = LETTER * len(name)
        for left in (x + 6, x - 6 - width):
            box = (left, y - 7, left + width, y + 7)
            others = [other for other in taken if other != (x - 4, y - 4, x + 4, y + 4)]
            inside = box[0] > LEFT and box[2] < WIDTH - RIGHT and box[1] > TOP
            if inside and not any(_meet(box, other) for other in others):
                taken.append(box)
                parts.append(
                    tag("text", escape(name), class_="tick", x=f"{left:.1f}", y=f"{y + 4:.1f}")
                )
                break
    return parts


def _meet(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _ellipse(
    center: NDArray[np.float64],
    covariance: NDArray[np.float64],
    x_scale: Scale,
    y_scale: Scale,
    colour: int,
) -> str:
    """Return the ellipse of one standard deviation."""
    values, vectors = np.linalg.eigh(covariance)
    around = np.linspace(0, 2 * np.pi, 61)
    unit = np.stack([np.cos(around), np.sin(around)])
    border = center[:, None] + vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * unit)
    points = "L".join(f"{place_x(x_scale(x)):.1f} {place_y(y_scale(y)):.1f}" for x, y in border.T)
    return tag("path", d=f"M{points}Z", class_="ellipse", style=f"stroke:var(--c{colour})")


def _round_down(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-12))


def _sigma(sigma: NDArray[np.float64]) -> str:
    return "/".join(number(float(value)) for value in (sigma[0], sigma[2]))


def _length(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.linalg.norm(known)) if len(known) else math.nan


def _metres(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "-"
