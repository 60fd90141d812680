"""Figures of georeferencing: horizontal errors of control points and positions, and the plan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bundle.figures.axes import SHAPE, round_down, square
from bundle.figures.drawing import Figure
from bundle.figures.marks import GREY, Array, Dots, Ellipses, Vectors
from bundle.figures.placement_errors import PlacedImage, PlacedTarget, Placement

ROLES = {"control": 0, "check": 1}
"""Colour indices of targets by role; other targets are grey."""

ERRORS = ("error east [m]", "error north [m]")
FARTHEST = 1.2
"""Largest drawn error of an image without influence, relative to the height of the plan."""


def target_figure(place: Placement) -> Figure | None:
    """Return horizontal errors of control and check points; None if none are known."""
    known = [target for target in place.targets if _is_known(target)]
    if not known:
        return None
    residuals = np.array([target.residual[:2] for target in known])
    sigmas = sorted({(float(target.sigma[0]), float(target.sigma[1])) for target in known})
    reach = 1.15 * max(float(np.abs(residuals).max()), *(max(pair) for pair in sigmas))
    controls = np.array([target.residual[:2] for target in known if target.role == "control"])
    ellipses = [Ellipses(np.array([np.diag(np.square(pair)) for pair in sigmas]), 2)]
    if len(controls):
        ellipses.append(Ellipses(_moment(controls)[None], 0))
    x, y = square((0.0, 0.0), max(reach, 1e-9), ERRORS)
    dots = Dots(
        residuals,
        tuple(ROLES.get(target.role, GREY) for target in known),
        tuple(target.name for target in known),
        is_labelled=True,
    )
    note = (
        "Blue: control points, with the ellipse of their root mean square; orange: check points; "
        "green: one standard deviation of the survey. Names where there is room."
    )
    return Figure(
        name="target_errors", title="Horizontal errors", x=x, y=y, marks=(dots, *ellipses),
        note=note, is_plan=True,
    )  # fmt: skip


def position_figure(place: Placement) -> Figure | None:
    """Return horizontal errors of measured positions; None if none are known."""
    known = [image for image in place.images if _is_known(image)]
    if not known:
        return None
    residuals = np.array([image.residual[:2] for image in known])
    reach = 1.15 * max(float(np.abs(residuals).max()), 1e-9)
    x, y = square((0.0, 0.0), reach, ERRORS)
    return Figure(
        name="position_errors",
        title="Horizontal errors",
        x=x,
        y=y,
        marks=(_dots(known, residuals), Ellipses(_moment(residuals)[None], 1)),
        note="Ellipse: one root mean square in every direction. Grey: without influence.",
        is_plan=True,
    )


def plan_figure(place: Placement) -> Figure | None:
    """Return positions from above with enlarged errors; None without positions."""
    placed = [i for i in place.images if _is_known(i) and np.isfinite(i.position).all()]
    if not placed:
        return None
    positions = np.array([image.position[:2] for image in placed])
    low, high = positions.min(axis=0), positions.max(axis=0)
    half, middle = (high - low) / 2, (low + high) / 2
    reach = 1.1 * max(float(half[0]) / SHAPE, float(half[1]), 1e-6)
    x, y = square((float(middle[0]), float(middle[1])), reach, ("east [m]", "north [m]"))
    residuals = np.array([image.residual[:2] for image in placed])
    lengths = np.hypot(*residuals.T)
    factor = round_down(0.2 * reach / float(lengths.max())) if lengths.max() > 0 else 1.0
    shown = np.array([image.used for image in placed])
    shown |= factor * lengths < 2 * reach * FARTHEST
    lines = Vectors(positions[shown], -factor * residuals[shown])
    return Figure(
        name="plan",
        title="Plan",
        x=x,
        y=y,
        marks=(lines, _dots(placed, positions)),
        note=f"Lines go from the camera towards the measured position, {factor:g} times as long.",
        is_plan=True,
    )


def _dots(images: Sequence[PlacedImage], at: Array) -> Dots:
    colours = tuple(0 if image.used else GREY for image in images)
    return Dots(at, colours, tuple(image.name for image in images))


def _is_known(one: PlacedImage | PlacedTarget) -> bool:
    return bool(np.isfinite(one.residual[:2]).all())


def _moment(residuals: Array) -> Array:
    moment: Array = residuals.T @ residuals / len(residuals)
    return moment
