"""Variables of a factor graph: keys, manifolds, values, and tangent coordinates.

Tangent coordinates of poses in several libraries, and derivatives with respect to the wrong ones.

A variable of a :class:`bundle.FactorGraph` moves by delta to X Exp(delta), with the rotation first.
In another convention it moves by d, with delta = M d to first order. Its Jacobian is J M, J the
Jacobian w.r.t. delta. With R and t the rotation and translation of X, M is a product of

- the motion. Exp(d) X: X^-1 Exp(d) X = Exp(Ad(X)^-1 d), so Ad(X)^-1; t + d in the frame of the
  world: R^T for the translation; Exp(d) R: R^T for the rotation; X as the inverse of another pose
  that moves by Exp(d) on its right: X moves to Exp(-d) X, so -Ad(X)^-1;
- the angle. The vector part of a quaternion is half the rotation vector: 2 for the rotation;
- the order of translation and rotation: a permutation.

Libraries:

============  ====================  =================  ================================
tangent       se3: motion           order              rotation by
============  ====================  =================  ================================
gtsam         X Exp(d)              rotation first     rotation vector
manif         X Exp(d)              translation first  rotation vector
g2o           X Exp(d)              translation first  vector part of the quaternion
g2o_expmap    Exp(d) X              rotation first     rotation vector
============  ====================  =================  ================================

These are GTSAM's Pose3, manif's SE3 (also Sophus' manifold for Ceres), g2o's VertexSE3 and its
VertexSE3Expmap (ORB-SLAM). In 2D, all move by x y angle in the frame of X, but g2o's
VertexSE2, which adds the translation in the frame of the world.

If the expected convention has M_e and a mistake M_w, the wrong Jacobian is J M_w, and the expected
one times M_e^-1 M_w.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Set
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import FrozenArrays, as_array, as_integers, freeze
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.interface.option_fields import choice
from bundle.model.rigid_motions import rotation_matrices

Key = Hashable
Array = NDArray[np.float64]

MANIFOLDS = ("euclidean", "so2", "so3", "se2", "se3")


def variable_name(key: Key) -> str:
    """Return the name of a variable for messages."""
    return f"variable {brief(key)}"


@dataclass(frozen=True, eq=False)
class Variable(FrozenArrays):
    """Variable of a graph."""

    key: Key  # name of the variable in the graph
    manifold: str  # one of MANIFOLDS
    value: Array  # (n,) in the manifold's representation; quaternions have norm 1
    coordinates: tuple[str, ...]  # names of the tangent coordinates
    held: tuple[bool, ...]  # flag per tangent coordinate, True if constant; () if all are free
    lower: Array  # lower bounds (n,), or (0,) without bounds
    upper: Array  # upper bounds in the same shape

    @cached_property
    def name(self) -> str:
        """Name for messages."""
        return variable_name(self.key)

    @staticmethod
    def make(
        key: Key,
        value: ArrayLike,
        manifold: str,
        fixed: bool | Iterable[int],
        lower: ArrayLike | None,
        upper: ArrayLike | None,
    ) -> Variable:
        """Return a checked variable."""
        name = variable_name(key)
        manifold = choice(f"{name}: manifold", manifold, MANIFOLDS)
        checked, coordinates = _core.check_value(name, manifold, as_row(name, value))
        held = _held(name, fixed, len(coordinates))
        bounds = [
            _bound(name, what, manifold, bound, len(checked), none)
            for what, bound, none in (("lower", lower, -np.inf), ("upper", upper, np.inf))
        ]
        if lower is None and upper is None:
            bounds = [np.zeros(0), np.zeros(0)]
        equal = bounds[0] == bounds[1]
        if equal.any():
            held = tuple(bool(flag) for flag in equal | (held or False))
        variable = Variable(
            key, manifold, checked, tuple(coordinates), held, freeze(bounds[0]), freeze(bounds[1])
        )
        _core.check_variable((*variable.core()[:-2], *bounds))
        return variable

    def holding(self, held: NDArray[np.bool_]) -> Variable:
        """Return the variable with additional coordinates held constant."""
        flags = held | np.array(self.held or (False,) * len(held))
        return replace(self, held=tuple(map(bool, flags)))

    def core(self) -> tuple[Any, ...]:
        """Return the arguments of ``_core``; equal bounds, which Ceres refuses, are constants."""
        equal = self.lower == self.upper
        lower, upper = (
            np.where(equal, infinity, bound)
            for infinity, bound in ((-np.inf, self.lower), (np.inf, self.upper))
        )
        return (
            self.name,
            self.manifold,
            self.value,
            list(self.held),
            lower,
            upper,
        )


class Values(Mapping[Key, Array]):
    """View of the values of variables by key, like ``dict.values``."""

    def __init__(self, variables: Mapping[Key, Variable]) -> None:
        self._variables = variables

    def __getitem__(self, key: Key) -> Array:
        return self._variables[key].value

    def __iter__(self) -> Iterator[Key]:
        return iter(self._variables)

    def __len__(self) -> int:
        return len(self._variables)

    def __repr__(self) -> str:
        return repr(dict(self))


def as_row(name: str, value: Any) -> Array:
    """Return numbers as an array (n,); one number has n = 1."""
    row = np.atleast_1d(as_array(name, value))
    if row.ndim != 1:
        hint = {(3, 3): " (se2: x y angle)", (4, 4): " (se3: qx qy qz qw tx ty tz)"}
        found = f"{row.shape}{hint.get(row.shape, '')}"
        raise InputError(f"{name}: expected a 1-D array of numbers, found shape {found}")
    return row


def as_keys(argument: str, keys: Any, *, ordered: bool = True) -> tuple[Key, ...]:
    """Return distinct keys in the given order."""
    listed = as_list(argument, "keys", keys)
    if ordered and isinstance(keys, Set):
        raise InputError(f"{argument}: expected a list of keys with an order, found a set")
    seen: set[Key] = set()
    for key in listed:
        check_key(argument, key)
        if key in seen:
            raise InputError(f"{argument}: expected different variables, found {brief(key)} twice")
        seen.add(key)
    return listed


def as_list(argument: str, things: str, given: Any) -> tuple[Any, ...]:
    """Return the members of an iterable other than text."""
    try:
        if not isinstance(given, str | bytes):
            return tuple(given)
    except TypeError:
        pass
    raise InputError(f"{argument}: expected a list of {things}, found {brief(given)}")


def check_key(argument: str, key: Any) -> None:
    """Refuse keys that are not hashable."""
    try:
        hash(key)
    except Exception:  # any exception of a user's __hash__
        raise InputError(
            f"{argument}: expected a key, such as a word or a number, found {brief(key)}"
        ) from None


def _held(name: str, fixed: bool | Iterable[int], size: int) -> tuple[bool, ...]:
    if isinstance(fixed, bool | np.bool_):
        return (True,) * size if fixed else ()
    flags = [False] * size
    for entry in as_integers(f"{name}: fixed", fixed).reshape(-1):
        if not 0 <= entry < size:
            raise InputError(
                f"{name}: fixed: expected tangent coordinates from 0 to {size - 1}, found {entry}"
            )
        flags[entry] = True
    return tuple(flags) if any(flags) else ()


def _bound(
    name: str, what: str, manifold: str, bound: ArrayLike | None, size: int, none: float
) -> Array:
    if bound is None:
        return np.full(size, none)
    if manifold != "euclidean":
        raise InputError(f"{name}: {what}: expected a euclidean variable, found {manifold}")
    values = as_array(f"{name}: {what}", bound)
    if values.ndim and values.shape != (size,):
        raise InputError(
            f"{name}: {what}: expected {plural(size, 'number')}, found shape {values.shape}"
        )
    if np.isnan(values).any():
        raise InputError(f"{name}: {what}: expected numbers, found nan")
    return np.ascontiguousarray(np.broadcast_to(values, (size,)), dtype=np.float64).copy()


Conventions = dict[tuple[str, str], Array]

TANGENTS = ("gtsam", "manif", "g2o", "g2o_expmap")
"""Conventions by the library that uses them; gtsam is that of a factor graph."""

MOTIONS = {
    "right": "X Exp(d)",
    "left": "Exp(d) X",
    "world": "R Exp(d), t + d",
    "split": "Exp(d) R, t + d",
    "turn": "Exp(d) R, t + R d",
    "inverse": "Exp(-d) X, of which the inverse is X^-1 Exp(d)",
    "inverse_left": "X Exp(-d), of which the inverse is Exp(d) X^-1",
}
_ON_THE_LEFT = {"left", "split", "turn", "inverse"}


@dataclass(frozen=True)
class Tangent:
    """Tangent coordinates of one manifold."""

    motion: str = "right"  # motion of a variable, one of MOTIONS
    is_translation_first: bool = False  # order; in 2D, False for the angle first
    is_half: bool = False  # True if the rotation is the vector part of a quaternion

    def order(self, manifold: str) -> list[int]:
        """Return the coordinate of a factor graph, x y angle in 2D, for each column."""
        if manifold == "se3":
            return [3, 4, 5, 0, 1, 2] if self.is_translation_first else [0, 1, 2, 3, 4, 5]
        if manifold == "se2":
            return [0, 1, 2] if self.is_translation_first else [2, 0, 1]
        return [0, 1, 2] if manifold == "so3" else [0]

    def matrix(self, manifold: str, values: Array) -> Array:
        """Return M (K, d, d) at the values (K, n)."""
        if manifold == "so2":
            return np.ones((len(values), 1, 1))
        order = self.order(manifold)
        moved = _motion(self.motion, manifold, values)
        if self.is_half and manifold in ("so3", "se3"):
            moved = moved * np.where(np.arange(len(order)) < 3, 2.0, 1.0)
        reordered: Array = moved[..., order]
        return reordered


_SE3: Mapping[str, Tangent] = {
    "gtsam": Tangent(),
    "manif": Tangent(is_translation_first=True),
    "g2o": Tangent(is_translation_first=True, is_half=True),
    "g2o_expmap": Tangent("left"),
}


def tangent_of(name: str, manifold: str) -> Tangent:
    """Return the tangent coordinates of a library on a manifold."""
    if manifold == "se2":
        return Tangent("world" if name == "g2o" else "right", is_translation_first=True)
    if manifold == "so3":
        return replace(_SE3[name], is_translation_first=False)
    return _SE3[name]


def other_coordinates(manifold: str, values: Array, tangent: str = "gtsam") -> Conventions:
    """Return kind, description, M_e^-1 M_w (K, d, d) of wrong conventions at values (K, n)."""
    if manifold not in ("so3", "se2", "se3"):
        return {}
    expected = tangent_of(tangent, manifold)
    back = np.linalg.inv(expected.matrix(manifold, values))
    found: Conventions = {}
    for other in sorted(_all(manifold), key=lambda one: _distance(one, expected)):
        # By the inverse pose, on the same side, only the sign is another.
        same_side = "inverse" if expected.motion == "left" else "inverse_left"
        if other == expected or other.motion == same_side:
            continue
        kind, words = _difference(other, expected, manifold)
        found[kind, words] = back @ other.matrix(manifold, values)
    return found


def _all(manifold: str) -> list[Tangent]:
    motions = {
        "so3": ("right", "left", "inverse", "inverse_left"),
        "se2": ("right", "left", "world", "inverse", "inverse_left"),
    }
    orders = (False,) if manifold == "so3" else (True, False)
    halves = (False,) if manifold == "se2" else (False, True)
    return [
        Tangent(motion, order, half)
        for motion in motions.get(manifold, tuple(MOTIONS))
        for order in orders
        for half in halves
    ]


def _distance(one: Tangent, other: Tangent) -> int:
    """Return the number of differences, most of them first for the motion."""
    return (
        4 * (one.motion != other.motion)
        + one.motion.startswith("inverse")
        + 2 * (one.is_half != other.is_half)
        + 2 * (one.is_translation_first != other.is_translation_first)
    )


def _difference(wrong: Tangent, expected: Tangent, manifold: str) -> tuple[str, str]:
    """Return kind and description of a wrong convention."""
    words, kinds = [], []
    if wrong.motion != expected.motion:
        turns = (wrong.motion in _ON_THE_LEFT) != (expected.motion in _ON_THE_LEFT)
        kind = "perturbation" if turns else "frame"
        is_inverse = wrong.motion.startswith("inverse")
        kinds.append("inverse" if is_inverse else kind)
        what = "another frame of the translation"
        if is_inverse:
            what = "of the inverse pose"
        elif turns:
            what = "perturbation on the wrong side"
        words.append(
            f"{what}: derivative of {MOTIONS[wrong.motion]}, not of {MOTIONS[expected.motion]}"
        )
    if wrong.is_half != expected.is_half:
        kinds.append("half_angle")
        vector, part = "the rotation vector", "the vector part of the quaternion, half of it,"
        first, second = (part, vector) if wrong.is_half else (vector, part.rstrip(","))
        words.append(f"the rotation is by {first} instead of {second}")
    if wrong.is_translation_first != expected.is_translation_first:
        kinds.append("order")
        turn = "angle" if manifold == "se2" else "rotation"
        first = "translation" if wrong.is_translation_first else turn
        words.append(f"wrong order: {first} first")
    same = [name for name in TANGENTS if tangent_of(name, manifold) == wrong]
    library = f" (as in {' and '.join(same)})" if same else ""
    return kinds[0], f"{'; and '.join(words)}{library}"


def _motion(motion: str, manifold: str, values: Array) -> Array:
    """Return M of a motion in the order of a factor graph."""
    if manifold == "so3":
        back = rotation_matrices(values).transpose(0, 2, 1)
        one = np.broadcast_to(np.eye(3), back.shape)
        return {"right": one, "inverse_left": -one, "inverse": -back}.get(motion, back)
    return _se2(motion, values) if manifold == "se2" else _se3(motion, values)


def _se3(motion: str, values: Array) -> Array:
    back: Array = rotation_matrices(values[:, :4]).transpose(0, 2, 1)
    one = np.broadcast_to(np.eye(3), back.shape)
    if motion == "inverse_left":
        return -_blocks(one, one)
    if motion in ("left", "inverse"):
        left = _blocks(back, back)
        left[:, 3:, :3] = -back @ np.cross(values[:, None, 4:], np.eye(3)).transpose(0, 2, 1)
        return left if motion == "left" else -left
    turns = back if motion in ("split", "turn") else one
    return _blocks(turns, back if motion in ("world", "split") else one)


def _se2(motion: str, values: Array) -> Array:
    cosine, sine = np.cos(values[:, 2]), np.sin(values[:, 2])
    matrices = np.zeros((len(values), 3, 3))
    matrices[:, 2, 2] = 1
    back = np.array([[cosine, sine], [-sine, cosine]]).transpose(2, 0, 1)
    matrices[:, :2, :2] = np.eye(2) if motion in ("right", "inverse_left") else back
    if motion in ("left", "inverse"):
        across = np.stack([-values[:, 1], values[:, 0]], axis=1)
        matrices[:, :2, 2] = (back @ across[..., None])[..., 0]
    return -matrices if motion.startswith("inverse") else matrices


def _blocks(first: Array, second: Array) -> Array:
    matrices = np.zeros((len(first), 6, 6))
    matrices[:, :3, :3], matrices[:, 3:, 3:] = first, second
    return matrices
