"""Control points and measured positions: tables of errors, and error ellipses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number, pixels, plural
from bundle.figures.placement_figures import Placement, plan_figure, position_figure, target_figure
from bundle.reports.sections import Section, Table

ROWS = 12


def placement_sections(place: Placement) -> list[Section]:
    """Return tables and figures; all lengths are in metres (east, north, up)."""
    system = place.reference_system
    words = "Metres east, north, up: model minus measurement."
    words += f" Coordinates were read in {system}." if system else ""
    targets = [target_figure(place)] if place.targets else []
    images = [position_figure(place), plan_figure(place)] if place.images else []
    return [
        Section(
            title="Control points and positions", text=[words], tables=_rms(place),
            figures=[figure for figure in [*targets, *images] if figure is not None],
        ),
        *([_targets(place)] if place.targets else []),
        *([_positions(place)] if place.images else []),
    ]  # fmt: skip


def _rms(place: Placement) -> list[Table]:
    head = ["RMS error", "count", "east [m]", "north [m]", "up [m]", "horizontal [m]", "total [m]"]
    rows = []
    for kind, name in (("control", "control points"), ("check", "check points"),
                       ("gps", "positions of images")):  # fmt: skip
        used = [image for image in place.images if image.used]
        count = len(used) if kind == "gps" else sum(t.role == kind for t in place.targets)
        if count:
            rows.append([name, f"{count}", *map(_metres, place.rms(kind))])
    return [Table.of(head, rows)] if rows else []


def _targets(place: Placement) -> Section:
    head = ["point", "role", "images", "east [m]", "north [m]", "up [m]", "sigma [m]",
            "left out [m]", "RMSE [px]"]  # fmt: skip
    rows = [
        [target.name, "suspect" if target.suspect else target.role, f"{target.num_images}",
         *map(_metres, target.residual), _sigma(target.sigma), _metres(_length(target.left_out)),
         pixels(target.pixels)]
        for target in place.targets
    ]  # fmt: skip
    words = "Left out: length of the error when only the other points place the model."
    table = Table.of(head, rows, left=2, most=ROWS, legend=words)
    title = f"Each of {plural(len(rows), 'control or check point', 'control and check points')}"
    return Section(title=title, tables=[table], is_detail=True)


def _positions(place: Placement) -> Section:
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
    table = Table.of(head, rows, left=2, most=ROWS, legend=words)
    title = f"Each of {plural(len(rows), 'measured position')}"
    return Section(title=title, tables=[table], is_detail=True)


def _sigma(sigma: NDArray[np.float64]) -> str:
    return "/".join(number(float(value)) for value in (sigma[0], sigma[2]))


def _length(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.linalg.norm(known)) if len(known) else math.nan


def _metres(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "-"
