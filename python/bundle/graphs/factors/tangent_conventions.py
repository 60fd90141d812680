"""Derivatives with respect to other tangent coordinates than those of a factor graph.

Common mistakes are derivatives with respect to other tangent coordinates. A variable X moves by
delta to X Exp(delta). A derivative with respect to another motion d is J M with delta = M d. With R
and t the rotation and translation of X:

- Exp(d) X: X^-1 Exp(d) X = Exp(Ad(X)^-1 d), so M = Ad(X)^-1;
- t + d, in the frame of the world: M = R^T for the translation, as for Exp(d) R of the rotation;
- translation and rotation in the other order: M is a permutation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bundle.graphs.factors.variables import Array
from bundle.model.rotations import rotation_matrices

__all__ = ["other_coordinates"]


Conventions = dict[tuple[str, str], Array]

_LEFT = "left for right perturbation: derivative by d of Exp(d) X, not of X Exp(d)"
_WORLD = "translation in the world frame: t + d instead of t + R d (R is missing)"
_BOTH = (
    "left for right perturbation of rotation and translation: derivative by d of Exp(d) R and t + d"
)
_TURN = "left for right perturbation of the rotation: Exp(d) R instead of R Exp(d)"
_ORDER = "wrong order: {} first"


def other_coordinates(manifold: str, values: Array) -> Conventions:
    """Return kind, description and M (K, d, d) of each wrong convention at the values (K, n)."""
    return _MANIFOLDS[manifold](values) if manifold in _MANIFOLDS else {}


def _so3(values: Array) -> Conventions:
    return {("perturbation", _LEFT): _turned(values)}


def _se3(values: Array) -> Conventions:
    back, t = _turned(values[:, :4]), values[:, 4:]
    one = np.broadcast_to(np.eye(3), back.shape)
    skew = np.cross(t[:, None, :], np.eye(3)).transpose(0, 2, 1)
    left = _blocks(back, back)
    left[:, 3:, :3] = -back @ skew
    plain = {
        ("perturbation", _LEFT): left,
        ("frame", _WORLD): _blocks(one, back),
        ("perturbation", _BOTH): _blocks(back, back),
        ("perturbation", _TURN): _blocks(back, one),
    }
    return _also_reordered(plain, [3, 4, 5, 0, 1, 2], "translation")


def _se2(values: Array) -> Conventions:
    cosine, sine = np.cos(values[:, 2]), np.sin(values[:, 2])
    back = np.array([[cosine, sine], [-sine, cosine]]).transpose(2, 0, 1)
    world = np.zeros((len(values), 3, 3))
    world[:, :2, :2] = back
    world[:, 2, 2] = 1
    left = world.copy()
    across = np.stack([-values[:, 1], values[:, 0]], axis=1)
    left[:, :2, 2] = (back @ across[..., None])[..., 0]
    return _also_reordered(
        {("perturbation", _LEFT): left, ("frame", _WORLD): world}, [2, 0, 1], "angle"
    )


def _also_reordered(plain: Conventions, order: list[int], first: str) -> Conventions:
    """Add the same conventions with reordered columns: new column j is old column order[j]."""
    size = len(order)
    count = len(next(iter(plain.values())))
    words = _ORDER.format(first)
    right = np.broadcast_to(np.eye(size), (count, size, size))
    moved: Conventions = {("order", words): right[..., order]}
    for (kind, what), matrix in plain.items():
        moved[kind, f"{what}; and {words}"] = matrix[..., order]
    return plain | moved


def _turned(quaternions: Array) -> Array:
    """Return R^T (K, 3, 3)."""
    back: Array = rotation_matrices(quaternions).transpose(0, 2, 1)
    return back


def _blocks(first: Array, second: Array) -> Array:
    matrices = np.zeros((len(first), 6, 6))
    matrices[:, :3, :3], matrices[:, 3:, 3:] = first, second
    return matrices


_MANIFOLDS: dict[str, Callable[[Array], Conventions]] = {"so3": _so3, "se2": _se2, "se3": _se3}
