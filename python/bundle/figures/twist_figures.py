"""Motions of images during the readout of a rolling shutter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.figures.drawing import Figure
from bundle.figures.marks import GREY, Line, linear
from bundle.model.problem import Problem


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
