"""Drawings over an image plane: cells by darkness, mean vectors, and dots by direction."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bundle.figures.matplotlib.directions import direction_colours
from bundle.figures.residual_field import SIGNIFICANT, ResidualField
from bundle.reports.page.image import data_uri
from bundle.reports.page.page import tag
from bundle.reports.page.scale import short

__all__ = ["PAD", "Boxed", "cells", "directions", "plane", "plane_size", "vectors"]

WIDTH = 400.0
PAD = 2.0
BELOW = 18.0
DOTS_WIDE = 560


class Boxed(Protocol):
    """Numbers over an image plane."""

    @property
    def box(self) -> NDArray[np.float64]:
        """(4,) left, top, right, bottom [pixels]."""


def plane(field: Boxed, *content: str, label: str, scale: str = "") -> str:
    """Return a drawing in the shape of the image, its corners written below."""
    width, height = plane_size(field)
    left, top, right, bottom = field.box
    y = height + 2 * PAD + 13
    frame = tag("rect", class_="plane", x=PAD, y=PAD, width=f"{width:.1f}", height=f"{height:.1f}")
    corners = [
        tag("text", f"{left:.0f}, {top:.0f}", class_="tick", x=PAD, y=f"{y:.1f}"),
        tag("text", f"{right:.0f}, {bottom:.0f} px", class_="tick", x=f"{PAD + width:.1f}",
            y=f"{y:.1f}", text_anchor="end"),
    ]  # fmt: skip
    view = f"0 0 {width + 2 * PAD:.1f} {height + 2 * PAD + BELOW:.1f}"
    drawing = tag("svg", frame, *content, *corners, viewBox=view, role="img", aria_label=label)
    return drawing + scale


def cells(
    field: Boxed,
    values: NDArray[np.float64],
    top: float,
    name: str,
    unit: str,
    *,
    titles: Callable[[int, int], str] | None = None,
    overlay: str = "",
) -> str:
    """Return cells, the fuller the larger the value, from 0 to ``top``; empty where nan.

    ``overlay`` is drawn on top.
    """
    rows, columns = values.shape
    width, height = plane_size(field)
    wide, high = width / columns, height / rows
    drawn = []
    for row in range(rows):
        for column in range(columns):
            value = float(values[row, column])
            if not np.isfinite(value):
                continue
            share = min(value / top, 1.0) if top > 0 else 0.0
            title = tag("title", escape(titles(row, column))) if titles else ""
            drawn.append(
                tag(
                    "rect", title, data_cell=row * columns + column,
                    x=f"{PAD + column * wide:.1f}", y=f"{PAD + row * high:.1f}",
                    width=f"{wide + 0.2:.1f}", height=f"{high + 0.2:.1f}",
                    fill_opacity=f"{share:.3f}",
                )
            )  # fmt: skip
    group = tag("g", *drawn, class_="heat")
    return plane(field, group, overlay, label=name, scale=_ramp(top, unit))


def vectors(field: ResidualField, factor: float, titles: Callable[[int, int], str]) -> str:
    """Return the mean residual of each cell as a line from its middle, ``factor`` times as long.

    A line is bold where the mean is significant, faint where it is not or cannot be said.
    """
    rows, columns = field.count.shape
    width, height = plane_size(field)
    wide, high = width / columns, height / rows
    pixel = width / float(field.box[2] - field.box[0])
    drawn, areas = [], []
    significant = field.significance
    for row in range(rows):
        for column in range(columns):
            areas.append(
                tag("rect", tag("title", escape(titles(row, column))), class_="area",
                    x=f"{PAD + column * wide:.1f}", y=f"{PAD + row * high:.1f}",
                    width=f"{wide:.1f}", height=f"{high:.1f}")
            )  # fmt: skip
            if field.count[row, column] == 0:
                continue
            x, y = PAD + (column + 0.5) * wide, PAD + (row + 0.5) * high
            dx, dy = field.mean[row, column] * factor * pixel
            bold = significant[row, column] > SIGNIFICANT
            drawn.append(
                tag("path", d=f"M{x:.2f} {y:.2f}l{dx:.2f} {dy:.2f}",
                    data_cell=row * columns + column, class_="bold" if bold else None)
            )  # fmt: skip
            drawn.append(tag("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=1.2))
    group = tag("g", *drawn, class_="vectors")
    return plane(field, group, *areas, label="mean residual of each cell")


def directions(field: ResidualField) -> str:
    """Return some observations as dots, coloured by the direction of their residuals."""
    width, height = plane_size(field)
    across, down = DOTS_WIDE, max(round(DOTS_WIDE * height / width), 1)
    image = np.zeros((down, across, 4), np.uint8)
    share = (field.dots - field.box[:2]) / (field.box[2:] - field.box[:2])
    x = (share[:, 0] * across).astype(int)
    y = (share[:, 1] * down).astype(int)
    colours = direction_colours(field.dot_residuals)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            place = np.clip(y + dy, 0, down - 1), np.clip(x + dx, 0, across - 1)
            image[(*place, slice(0, 3))] = colours
            image[(*place, 3)] = 255
    picture = tag(
        "image", href=data_uri(image), x=PAD, y=PAD, width=f"{width:.1f}", height=f"{height:.1f}",
        preserveAspectRatio="none", class_="dots",
    )  # fmt: skip
    return plane(field, picture, label="directions of residuals", scale=_wheel())


def plane_size(field: Boxed) -> tuple[float, float]:
    """Return width and height of a plane as it is drawn, within its margin ``PAD``."""
    left, top, right, bottom = field.box
    height = WIDTH * float((bottom - top) / (right - left))
    limit = 1.5 * WIDTH
    return (WIDTH, height) if height <= limit else (WIDTH * limit / height, limit)


def _ramp(top: float, unit: str) -> str:
    words = f"{short(float(f'{top:.3g}'))} {unit}".strip()
    return tag("p", tag("span", "0"), tag("span", class_="ramp"), tag("span", escape(words)),
               class_="scale")  # fmt: skip


def _wheel() -> str:
    names = ("right", "down", "left", "up")
    parts = []
    for index, name in enumerate(names):
        angle = 0.5 * np.pi * index
        red, green, blue = direction_colours(np.array([[np.cos(angle), np.sin(angle)]]))[0]
        colour = f"background:rgb({red},{green},{blue})"
        parts.append(tag("li", tag("span", class_="swatch", style=colour), name))
    return tag("ul", *parts, class_="legend")
