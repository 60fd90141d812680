"""3-D view of a page, drawn by three.js, which is embedded in the page."""

from __future__ import annotations

import base64
import re
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.figures.axes import short
from bundle.figures.scene_view import SceneView
from bundle.reports.page.page import asset, tag

__all__ = ["scene_data", "scene_script", "scene_section"]

FRUSTUM = 0.08
"""Depth of a drawn camera, relative to the extent of the scene."""

MANY = 50


def scene_section(view: SceneView, num_points: int, more: str = "") -> str:
    """Return the view and its controls.

    Args:
        view: scene to draw.
        num_points: number of points in the reconstruction.
        more: sentence about ellipsoids; "" without ellipsoids.
    """
    boxes = ["points", "cameras", *(["ellipsoids"] if more else [])]
    controls = [
        tag("label", tag("input", type="checkbox", checked=True, data_shows=name), f" {name}")
        for name in boxes
    ]
    size = tag("input", type="range", id="point-size", min=1, max=8, step=0.5, value=2,
               aria_label="size of the points")  # fmt: skip
    controls += [tag("label", "size ", size), tag("button", "Reset the view", id="scene-home")]
    limit = error_limit(view)
    words = (
        f"{plural(len(view.points), 'point', grouped=True)} and "
        f"{plural(len(view.centers), 'camera', grouped=True)}"
    )
    if view.step > 1:
        words += f"; of {num_points:,} points, every {_ordinal(view.step)} is drawn"
    if view.num_far:
        words += (
            f"; {view.num_far:,} farther away than 50 times the half width of the scene are not "
            "drawn"
        )
    words += f". Points are blue at 0 px RMSE, orange from {short(limit)} px on, grey unobserved."
    words += f" {more}" if more else ""
    words += " Drag to turn, wheel to zoom, right button or arrow keys to move."
    canvas = tag("canvas", tabindex=0, role="img", aria_label="3-D view of cameras and points")
    sorry = tag("p", "This browser has no WebGL 2: the view stays empty.", hidden=True)
    return "".join(
        [
            tag("p", escape(words), class_="quiet"),
            tag("div", canvas, sorry, class_="scene"),
            tag("div", *controls, class_="controls"),
        ]
    )


def scene_data(view: SceneView) -> dict[str, Any]:
    """Return the numbers of the view; arrays are base64 of little-endian 32-bit floats."""
    # Many cameras are drawn smaller, so that they do not hide the scene.
    frustum = FRUSTUM * view.reach / max(1.0, (len(view.centers) / MANY) ** 0.5)
    return {
        "origin": view.origin.tolist(),
        "unit": view.unit,
        "step": view.step,
        "points": packed(view.points),
        "errors": packed(view.point_errors),
        "error_limit": error_limit(view),
        "centers": packed(view.centers),
        "axes": packed(view.axes),
        "fields": packed(view.half_fields),
        "frustum": frustum,
        "middle": view.middle.tolist(),
        "reach": view.reach,
        "up": view.up.tolist(),
        "forward": view.forward.tolist(),
    }


def scene_script() -> str:
    """Return three.js and the script of the view, as one module.

    The page loads no files, so it cannot import modules. The export statement at the end of
    three.js is replaced by declarations of the names that the view needs.
    """
    library = asset("three", "three.js")
    start = library.rindex("export{")
    names = dict(
        reversed(pair.split(" as ")) if " as " in pair else (pair, pair)
        for pair in re.findall(r"[\w$]+ as \w+|\w+", library[start + 7 : library.index("}", start)])
    )
    needed = {name: names[name] for name in ("THREE", "OrbitControls")}
    declared = "".join(f"const {name}={local};" for name, local in needed.items() if name != local)
    return f"{library[:start]}{declared}\n{asset('scene.js')}"


def error_limit(view: SceneView) -> float:
    """Return the error that is drawn orange: the 95th percentile, or 1 without errors."""
    known = view.point_errors[np.isfinite(view.point_errors)]
    limit = float(np.quantile(known, 0.95)) if len(known) else 0.0
    return float(f"{limit:.2g}") if np.isfinite(limit) and limit > 0 else 1.0


def packed(values: NDArray[np.float64]) -> str:
    """Return an array as base64 of little-endian 32-bit floats."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


def _ordinal(number: int) -> str:
    return {2: "second", 3: "third"}.get(number, f"{number}th")
