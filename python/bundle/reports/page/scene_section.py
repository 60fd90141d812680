"""3-D view of a page, drawn by three.js, which is embedded in the page."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.figures.marks import short
from bundle.figures.scene_view import SceneView
from bundle.reports.page.page import asset, tag

FRUSTUM = 0.08  # depth of a drawn camera, relative to the extent of the scene

MANY = 50


@dataclass(frozen=True, eq=False)
class Shades:
    """Value per point, drawn from blue (the best) to orange."""

    name: str  # name of the value
    values: NDArray[np.float64]  # (n,) values; NaN: unknown, drawn grey
    ends: tuple[float, float]  # values of pure blue and of pure orange
    unit: str  # unit, for the legend

    def data(self) -> dict[str, Any]:
        """Return shades from 0 (blue) to 254 (orange) as base64 of bytes; 255 is grey."""
        best, worst = self.ends
        share = np.clip((self.values - best) / (worst - best), 0.0, 1.0)
        shades = np.where(np.isfinite(share), np.rint(254 * np.nan_to_num(share)), 255)
        words = [f"{short(end)} {self.unit}".strip() for end in self.ends]
        return {"name": self.name, "shades": _coded(shades.astype(np.uint8)), "ends": words}


PARTS = {"points": "points", "cameras": "cameras"}
"""Parts of the view that can be hidden, with their names."""


def scene_section(
    view: SceneView,
    num_points: int,
    *,
    is_solved: bool,
    more: str = "",
    parts: Mapping[str, str] = PARTS,
    nouns: tuple[str, str] = ("point", "camera"),
) -> str:
    """Return the view with its controls, and the dialog of an image.

    ``more`` is a sentence about ellipsoids, ``parts`` what can be hidden, with its names, ``nouns``
    the singular of points and of cameras.
    """
    states = [
        tag("button", name, type="button", data_state=name.lower(), aria_pressed=str(pressed))
        for name, pressed in (("Before", "false"), ("After", "true"))
    ]
    boxes = [
        tag("label", tag("input", type="checkbox", checked=True, data_shows=part), f" {name}")
        for part, name in {**parts, **({"ellipsoids": "ellipsoids"} if more else {})}.items()
    ]
    size = tag("input", type="range", id="point-size", min=1, max=8, step=0.5, value=2,
               aria_label="size of the points")  # fmt: skip
    controls = [
        *(states if is_solved else []),
        tag("select", id="shade", aria_label="colour of the points"),
        *boxes,
        tag("label", "size ", size),
        tag("select", id="image", aria_label="image to show"),
        tag("button", "Reset", id="scene-home", type="button"),
        tag("button", "Full screen", id="scene-full", type="button"),
    ]  # fmt: skip
    words = (
        f"{plural(len(view.points), nouns[0], grouped=True)}, "
        f"{plural(len(view.centers), nouns[1], grouped=True)}"
    )
    if view.step > 1:
        nth = {2: "second", 3: "third"}.get(view.step, f"{view.step}th")
        words += f"; of {num_points:,} {nouns[0]}s, every {nth} is drawn"
    if view.num_far:
        words += f"; {view.num_far:,} farther away than 50 half widths of the scene are not drawn"
    words += f". {more}" if more else "."
    hint = "Drag to turn, wheel to zoom, right button or arrow keys to move"
    if parts is PARTS:
        hint += "; click on a camera"
    canvas = tag("canvas", tabindex=0, role="img", title=hint,
                 aria_label=f"3-D view of {nouns[1]}s and {nouns[0]}s")  # fmt: skip
    hover = tag("p", id="hover")
    sorry = tag("p", "This browser has no WebGL 2: the view stays empty.", id="sorry", hidden=True)
    bar = tag("div", tag("strong", id="image-name"),
              tag("button", "◀", type="button", data_step=-1, aria_label="previous image"),
              tag("button", "▶", type="button", data_step=1, aria_label="next image"),
              tag("button", "Close", type="button", id="close"), class_="controls")  # fmt: skip
    dialog = tag("dialog", bar, tag("div", id="photograph"), aria_labelledby="image-name")
    return tag(
        "div",
        tag("div", canvas, hover, sorry, class_="scene"),
        tag("div", *controls, class_="controls"),
        tag("p", tag("span", id="legend"), " ", escape(words), class_="quiet"),
        dialog,
        class_="view",
    )


def scene_data(
    view: SceneView,
    before: SceneView | None = None,
    others: Sequence[Shades] = (),
    error: tuple[str, str] = ("error", "px RMSE"),
) -> dict[str, Any]:
    """Return the numbers of the view; arrays are base64 of little-endian 32-bit floats.

    ``others`` may colour the points in place of their errors, which have a name and a unit.
    """
    # Many cameras are drawn smaller, so that they do not hide the scene.
    frustum = FRUSTUM * view.reach / max(1.0, (len(view.centers) / MANY) ** 0.5)
    limit = upper_limit(view.point_errors)
    data = {
        "origin": view.origin.tolist(),
        "unit": view.unit,
        "step": view.step,
        "fields": packed(view.half_fields),
        "images": view.image_ids.tolist(),
        "frustum": frustum,
        "middle": view.middle.tolist(),
        "reach": view.reach,
        "up": view.up.tolist(),
        "forward": view.forward.tolist(),
        "shades": [shades.data() for shades in others],
    }
    for name, state in (("after", view), ("before", before)):
        if state is not None:
            errors = Shades(error[0], state.point_errors, (0.0, limit), error[1])
            data[name] = {
                "points": packed(state.points),
                "error": errors.data(),
                "centers": packed(state.centers),
                "axes": packed(state.axes),
            }
    return data


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


def upper_limit(values: NDArray[np.float64]) -> float:
    """Return the value that is drawn orange: the 95th percentile, or 1 without values."""
    known = values[np.isfinite(values)]
    limit = float(np.quantile(known, 0.95)) if len(known) else 0.0
    return float(f"{limit:.2g}") if np.isfinite(limit) and limit > 0 else 1.0


def packed(values: NDArray[np.float64]) -> str:
    """Return an array as base64 of little-endian 32-bit floats."""
    return _coded(np.ascontiguousarray(values, "<f4"))


def _coded(values: NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")
