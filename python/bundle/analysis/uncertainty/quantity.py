"""Quantities of a model that users measure: lengths, heights, angles, volumes, camera parameters.

The gradient of a quantity is w.r.t. all points, poses and camera parameters of a problem. With the
centre c = -R^T t of an image, whose pose moves by (w, t), R to Exp(w) R,

    dc = -R^T [t]x dw - R^T dt.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.model.problem_keys import parameter_names
from bundle.model.rigid_motions import center_jacobians, rotation_matrices

if TYPE_CHECKING:
    from bundle.model.problem import Problem

_Floats = NDArray[np.float64]

PLACES = {"distance": 2, "height": 2, "angle": 3, "volume": 4, "baseline": 2}
"""Number of places of each quantity."""


_PIXELS = ("f", "fx", "fy", "cx", "cy")


@dataclass(frozen=True, eq=False)
class Quantity:
    """A function of a problem, with its gradient."""

    text: str  # the quantity in words
    unit: str  # "" for the unit of the model, "px", "degrees" or "1"
    value: float  # its value
    images: _Floats  # (num_images, 6) derivatives with respect to the pose, (w, t)
    cameras: _Floats  # (num_cameras, k) derivatives with respect to the parameters
    points: _Floats  # (num_points, 3) derivatives with respect to the coordinates


def quantity_of(text: str, problem: Problem, markers: Mapping[str, int]) -> Quantity:
    """Return the quantity that a text names; ``markers``: point ids by name."""
    if not isinstance(text, str) or not text.split():
        raise InputError(f"on: expected a quantity such as 'distance 12 87', found {brief(text)}")
    above, is_ratio, below = text.partition(" / ")
    first = _plain(above.split(), problem, markers)
    if not is_ratio:
        return first
    second = _plain(below.split(), problem, markers)
    if not abs(second.value) > 0:
        raise InputError(f"on: expected a ratio to a number other than 0, found {brief(text)}")
    ratio = first.value / second.value
    parts = {
        name: (getattr(first, name) - ratio * getattr(second, name)) / second.value
        for name in ("images", "cameras", "points")
    }
    words = f"{first.text} / {second.text}"
    return replace(first, text=words, unit="1", value=ratio, **parts)


def _plain(words: Sequence[str], problem: Problem, markers: Mapping[str, int]) -> Quantity:
    name, places = (words[0], words[1:]) if words else ("", [])
    if name not in PLACES:
        return _parameter(words, problem)
    if len(places) != PLACES[name]:
        raise InputError(
            f"on: expected {PLACES[name]} places after {name}, found {brief(' '.join(words))}"
        )
    if len(set(places)) < len(places):
        raise InputError(f"on: expected different places, found {brief(' '.join(words))}")
    owners = [_place(word, problem, markers, name == "baseline") for word in places]
    if len(set(owners)) < len(owners):
        raise InputError(f"on: expected different places, found {brief(' '.join(words))}")
    centers = problem.projection_centers if any(one for one, _ in owners) else problem.points
    at = np.array([(centers if is_image else problem.points)[row] for is_image, row in owners])
    value, by_place = _FUNCTIONS["distance" if name == "baseline" else name](at)
    if not np.isfinite(by_place).all():
        raise InputError(f"on: expected places apart, found {brief(' '.join(words))} at one place")
    quantity = _empty(problem, " ".join(words), "degrees" if name == "angle" else "", value)
    for (is_image, row), by in zip(owners, by_place, strict=True):
        if is_image:
            quantity.images[row] += by @ center_jacobians(problem.cam_from_world[row, None])[0]
        else:
            quantity.points[row] += by
    return quantity


def _empty(problem: Problem, text: str, unit: str, value: float) -> Quantity:
    shapes = (problem.num_images, 6), problem.camera_params.shape, (problem.num_points, 3)
    return Quantity(text, unit, float(value), *(np.zeros(shape) for shape in shapes))


def _parameter(words: Sequence[str], problem: Problem) -> Quantity:
    kinds = f"on: expected {', '.join(PLACES)}, or"
    if len(words) != 2:
        found = brief(" ".join(words))
        raise InputError(f"{kinds} a camera's parameter such as f, found {found}")
    rows = _rows_of(words[1], problem.camera_ids)
    if not rows:
        raise InputError(f"on: expected the id of a camera of the model, found {brief(words[1])}")
    camera = rows[0]
    names = parameter_names("on", problem, camera)
    if words[0] not in names:
        raise InputError(
            f"{kinds} a parameter of camera {words[1]} "
            f"({problem.camera_models[camera]}): {', '.join(names)}, found {brief(words[0])}"
        )
    column = names.index(words[0])
    value = problem.camera_params[camera, column]
    quantity = _empty(problem, " ".join(words), "px" if words[0] in _PIXELS else "1", value)
    quantity.cameras[camera, column] = 1
    return quantity


def _place(
    word: str, problem: Problem, markers: Mapping[str, int], is_image: bool
) -> tuple[bool, int]:
    """Return (True, row of an image) or (False, row of a point)."""
    is_image = is_image or word.startswith("image:")
    if is_image:
        name = word.removeprefix("image:")
        rows = [row for row, one in enumerate(problem.image_names) if one == name]
        what, found = "the name or id of an image", rows + _rows_of(name, problem.image_ids)
    else:
        found = _rows_of(str(markers.get(word, word)), problem.point_ids)
        what = "the id of a point, the name of a control point or image:NAME"
    if not found:
        raise InputError(f"on: expected {what} of the model, found {brief(word)}")
    seen = problem.observation_image if is_image else problem.observation_point
    if found[0] not in seen:
        raise InputError(f"on: expected a place with observations, {brief(word)} has 0")
    return is_image, found[0]


def _rows_of(word: str, ids: NDArray[Any]) -> list[int]:
    """Return the rows with the id that a word spells."""
    is_number = re.fullmatch("0|-?[1-9][0-9]*", word)
    return [int(row) for row in np.flatnonzero(ids == int(word))] if is_number else []


def _distance(at: _Floats) -> tuple[float, _Floats]:
    along = at[0] - at[1]
    length = np.linalg.norm(along)
    with np.errstate(invalid="ignore"):
        return float(length), np.stack([along, -along]) / length


def _height(at: _Floats) -> tuple[float, _Floats]:
    up = np.array([0.0, 0.0, 1.0])
    return float(at[1, 2] - at[0, 2]), np.stack([-up, up])


def _angle(at: _Floats) -> tuple[float, _Floats]:
    a, b = at[0] - at[1], at[2] - at[1]
    across = np.cross(a, b)
    size, product = np.linalg.norm(across), a @ b
    with np.errstate(invalid="ignore", divide="ignore"):
        # d atan2(|a x b|, a . b), with n the normal: da of the angle is along n x a / |a|^2.
        normal = across / size
        by_a = -np.cross(normal, a) / (a @ a)
        by_b = np.cross(normal, b) / (b @ b)
    return float(np.degrees(np.arctan2(size, product))), np.degrees(
        np.stack([by_a, -by_a - by_b, by_b])
    )


def _volume(at: _Floats) -> tuple[float, _Floats]:
    edges = at[1:] - at[0]
    by = np.cross(edges[[1, 2, 0]], edges[[2, 0, 1]]) / 6
    value = float(edges[0] @ by[0])
    sign = 1.0 if value >= 0 else -1.0
    return abs(value), sign * np.concatenate([-by.sum(axis=0)[None], by])


_FUNCTIONS = {"distance": _distance, "height": _height, "angle": _angle, "volume": _volume}


def lacking(quantity: Quantity, problem: Problem) -> str:
    """Return the free motions of the world that change a quantity: "rotation", "scale" or both."""
    rotations = rotation_matrices(problem.cam_from_world[:, :4])
    of_w, of_t = quantity.images[:, :3], quantity.images[:, 3:]
    points, t = problem.points, problem.cam_from_world[:, 4:]
    turn = np.cross(points, quantity.points).sum(axis=0)
    turn -= np.einsum("nji,nj->ni", rotations, of_w).sum(axis=0)
    scale = (points * quantity.points).sum() + (t * of_t).sum()
    reach = np.abs(points).max(initial=0) + np.abs(t).max(initial=0)
    size = (np.abs(quantity.points).sum() + np.abs(of_t).sum()) * reach
    changes = {
        "rotation": np.linalg.norm(turn) > 1e-9 * (size + np.abs(of_w).sum()),
        "scale": abs(scale) > 1e-9 * size,
    }
    return " and ".join(name for name, is_changed in changes.items() if is_changed)
