"""Table of the arrays that a solve estimates.

Everything that carries the state of a solve reads this table: results, checkpoints, held-out fits,
selections and local adjustments, processes and slices, digests, similarities, keys of factors. A
new variable is a new row of it. A similarity x' = s R x + t of the world moves an array in one of
these ways:

    pose     R_c' = R_c R^T,  t_c' = s t_c - R_c' t: a pose of the world in another frame
    point    x' = s R x + t
    lengths  some columns times s: vectors in a frame that moves with the world
    none     no change
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

SHUTTER = "rolling_shutter"


class Variable(NamedTuple):
    """An array that a solve estimates."""

    name: str  # attribute of ``holder``; also the name in checkpoints and in the core's output
    kind: str  # first element of the key of one row, see ``problem_keys``
    # records of which each has a row: attribute of a ``Selection``; "num_" + rows is their number
    # in a problem
    rows: Literal["images", "frames", "sensors", "cameras", "points"]
    width: int  # number of columns; 0: the largest number of parameters of a camera model
    tangent: int  # degrees of freedom of a row; 0: the number of parameters of its camera model
    # change under a similarity of the world, see above
    similarity: Literal["pose", "point", "lengths", "none"]
    lengths: slice = slice(0)  # columns that are lengths, for the similarity "lengths"
    # arrays of several processes: each has all rows ("shared") or its own rows ("own"), or one
    # process has all of the problem ("alone")
    division: Literal["shared", "own", "alone"] = "shared"
    # field of the problem that has the array as an attribute; "": the problem itself
    holder: str = ""


POSE_WIDTH = 7  # columns of a pose, on SE(3); all other variables are vectors

VARIABLES = [
    Variable("cam_from_world", "image", "images", POSE_WIDTH, 6, "pose"),
    Variable("camera_params", "camera", "cameras", 0, 0, "none"),
    Variable("points", "point", "points", 3, 3, "point", division="own"),
    Variable("rig_from_world", "frame", "frames", POSE_WIDTH, 6, "pose"),
    Variable("sensor_from_rig", "sensor", "sensors", POSE_WIDTH, 6, "lengths", slice(4, 7)),
    Variable("twist", "twist", "images", 6, 6, "lengths", slice(3, 6), "alone", SHUTTER),
    Variable("readout", "readout", "cameras", 1, 1, "none", slice(0), "alone", SHUTTER),
]
"""All variables; readers look at the table when they are called."""


class _Problem(Protocol):
    """A problem from which copies with other arrays are made."""

    def replace(self, **changes: Any) -> Self: ...

    def _moved(self, **state: Any) -> Self: ...


P = TypeVar("P", bound=_Problem)


def arrays_of(rows: str) -> tuple[str, ...]:
    """Return the names of the arrays of a problem itself with one row per image, frame, ..."""
    return tuple(one.name for one in VARIABLES if one.rows == rows and not one.holder)


def kinds(holder: str = "") -> tuple[str, ...]:
    """Return the kinds of the variables whose array is in ``holder``; "": in the problem."""
    return tuple(one.kind for one in VARIABLES if one.holder == holder)


def variable_of(kind: str) -> Variable:
    """Return the variable whose keys have this kind."""
    return next(one for one in VARIABLES if one.kind == kind)


def estimates(
    problem: Any, variables: Iterable[Variable] = VARIABLES
) -> dict[str, NDArray[np.float64]]:
    """Return the arrays of a problem by name, without those of a holder that the problem lacks."""
    found = {}
    for one in variables:
        holder = getattr(problem, one.holder) if one.holder else problem
        if holder is not None:
            found[one.name] = getattr(holder, one.name)
    return found


def with_estimates(problem: P, values: Mapping[str, Any], *, checked: bool = False) -> P:
    """Return a problem with other values.

    Args:
        problem: the problem.
        values: new arrays by name; arrays that are missing stay, other names are ignored.
        checked: True to check all arrays again; False: the caller knows that they are valid and
            immutable.
    """
    changes: dict[str, Any] = {}
    held: dict[str, dict[str, Any]] = {}
    for one in VARIABLES:
        if one.name in values:
            of = held.setdefault(one.holder, {}) if one.holder else changes
            of[one.name] = values[one.name]
    for name, arrays in held.items():
        holder = getattr(problem, name)
        if holder is not None:
            changes[name] = holder.replace(**arrays)
    return problem.replace(**changes) if checked else problem._moved(**changes)
