"""Exact conversions: lenses that two camera models can both represent.

Most models are a special case of larger models. This module describes a lens independently of its
model. The description has the mapping of rays to coordinates (``perspective``, u = X / Z, or
``equidistant``, u = theta X / r), two focal lengths, a principal point, and the coefficients that
have an effect:

- ``r1`` ... ``r6``: radial polynomial 1 + r1 s + r2 s^2 + ... with s = u^2 + v^2,
- ``d1`` ... ``d3``: denominator of FULL_OPENCV,
- ``p1, p2, sx, sy``: tangential and thin prism terms of (u, v),
- ``P1, P2, Sx, Sx2, Sy, Sy2``: the same terms of RAD_TAN_THIN_PRISM_FISHEYE, which are functions of
  the coordinates after the radial polynomial; without a polynomial they equal the terms above,
- ``division``, ``omega``, ``alpha`` and ``beta``: coefficients of models that no other model
  contains.

A model can represent this lens if it has the same mapping of rays and all its coefficients. EUCM
with alpha = 0 and the division models with k = 0 are perspective. FOV with omega = 0 is perspective
as well, but its derivatives by omega are zero there, which would stall other solvers. Therefore
perspective lenses are converted to FOV by a fit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.model.cameras import param_kinds

_EXTRAS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("r1",),
    "RADIAL": ("r1", "r2"),
    "OPENCV": ("r1", "r2", "p1", "p2"),
    "FULL_OPENCV": ("r1", "r2", "p1", "p2", "r3", "d1", "d2", "d3"),
    "FOV": ("omega",),
    "SIMPLE_DIVISION": ("division",),
    "DIVISION": ("division",),
    "EUCM": ("alpha", "beta"),
    "SIMPLE_FISHEYE": (),
    "FISHEYE": (),
    "SIMPLE_RADIAL_FISHEYE": ("r1",),
    "RADIAL_FISHEYE": ("r1", "r2"),
    "OPENCV_FISHEYE": ("r1", "r2", "r3", "r4"),
    "THIN_PRISM_FISHEYE": ("r1", "r2", "p1", "p2", "r3", "r4", "sx", "sy"),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        *("r1", "r2", "r3", "r4", "r5", "r6"),
        *("P2", "P1", "Sx", "Sx2", "Sy", "Sy2"),
    ),
}
"""Coefficients of each model in the order of its parameters after the principal point."""

_WITHOUT_RADIAL = {"p1": "P1", "p2": "P2", "sx": "Sx", "sy": "Sy"}

PERSPECTIVE = frozenset(model for model in _EXTRAS if "FISHEYE" not in model)
"""Models with u = X / Z near the axis; the other models have u = theta X / r."""


class _Lens(NamedTuple):
    rays: str
    focal: tuple[float, float]
    center: tuple[float, float]
    coefficients: dict[str, float]


def extras_of(model: str, params: NDArray[np.float64] | None = None) -> dict[str, float]:
    """Return the coefficients of a model in the order of its parameters; 0 without coefficients."""
    names = _EXTRAS[model]
    values = [0.0] * len(names) if params is None else params[len(params) - len(names) :].tolist()
    return dict(zip(names, values, strict=True))


def is_symmetric(model: str, params: NDArray[np.float64]) -> bool:
    """Return True if a lens is symmetric about its axis."""
    return not params[asymmetric_params(model)[2:]].any()


def asymmetric_params(model: str) -> list[int]:
    """Return the indices of the principal point and of asymmetric coefficients."""
    num_focal = param_kinds(model).count("focal")
    extras = enumerate(_EXTRAS[model], start=num_focal + 2)
    return [num_focal, num_focal + 1, *(index for index, name in extras if name[0] in "pPsS")]


def focal_and_center(model: str, params: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a model that has them."""
    num_focal = param_kinds(model).count("focal")
    fx, fy = params[0], params[num_focal - 1]
    return float(fx), float(fy), float(params[num_focal]), float(params[num_focal + 1])


def exact_params(
    model: str, params: NDArray[np.float64], target: str
) -> NDArray[np.float64] | None:
    """Return the parameters with which a model equals another lens; None if it cannot."""
    if model == target:
        return params
    lens = _lens(model, params)
    names = _EXTRAS[target]
    coefficients = dict(lens.coefficients)
    if not any(name[0] == "r" for name in coefficients):
        there = _WITHOUT_RADIAL
        if "p1" in names:
            there = {after: before for before, after in there.items()}
        coefficients = {there.get(name, name): value for name, value in coefficients.items()}
    num_focal = param_kinds(target).count("focal")
    if (
        lens.rays != _rays(target)
        or not coefficients.keys() <= set(names)
        or (num_focal == 1 and lens.focal[0] != lens.focal[1])
        or target == "FOV"
    ):
        return None
    neutral = {"beta": 1.0}
    extras = [coefficients.get(name, neutral.get(name, 0.0)) for name in names]
    return np.array([*lens.focal[:num_focal], *lens.center, *extras])


def _rays(model: str) -> str:
    return "perspective" if model in PERSPECTIVE else "equidistant"


def _lens(model: str, params: NDArray[np.float64]) -> _Lens:
    fx, fy, cx, cy = focal_and_center(model, params)
    coefficients = {name: value for name, value in extras_of(model, params).items() if value}
    if "alpha" not in coefficients:
        coefficients.pop("beta", None)
    return _Lens(_rays(model), (fx, fy), (cx, cy), coefficients)
