"""Null space of a factor graph at its values: the gauge, and directions that no factor determines.

The dimension is that of a QR factorisation of the whitened Jacobian with columns of norm 1
(:meth:`bundle.FactorGraph.digits`); normal equations would lose valid directions of long chains.
The directions N are the lowest eigenvectors of the normal equations.

Components share no factor, so that each has its own directions. A direction belongs to the gauge if
the poses of its component move as one. C are the motions of all poses by a translation, a rotation
and a scaling of the world. The gauge is the intersection of span(C) and span(N), both restricted to
the rows of poses. With orthonormal bases A of C and B of N, it has as many dimensions as A^T B has
singular values of 1. Points, velocities and biases move as they must, because N contains them.
Poses are world_from_body, X to Exp(e) X, or cam_from_world, X to X Exp(-e); the convention with the
larger intersection is used. A component of several variables without poses has the common
translation of its Euclidean variables as gauge.

Held coordinates. N must have no direction that is zero at them. The first variable of a component
with independent rows is held, then the coordinate with the largest remaining row of N, and so on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.graphs.factors.contents import connected
from bundle.graphs.factors.variables import Variable
from bundle.graphs.pose_graphs.lie_groups import adjoint_between
from bundle.model.rigid_motions import rotation_matrices

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

MOST_DIRECTIONS = 300  # largest dimension of a null space whose directions are computed

SAME = 1 - 1e-6  # cosine above which a direction lies in a space

INDEPENDENT = 1e-6
"""Share of the norm of a row of N that must remain for the row to count as independent."""


STILL = 1e-12  # share of the largest entry of N below which a row is 0


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Directions of all tangent coordinates that change no residual."""

    begin: NDArray[np.int64]  # (n + 1,) first tangent coordinate of each variable, and their number
    constant: Flags  # (t,) mask of constant coordinates
    labels: NDArray[np.int64]  # (n,) component of each variable
    nullity: int  # dimension of the null space
    nullities: dict[int, int]  # dimension by component, without entries of 0; empty if not computed
    # number of directions in which whole components move; equal to ``nullity`` if ``directions``
    # were not computed
    gauge: int
    directions: Floats  # (t, nullity) orthonormal basis; without columns if there are too many
    others: Floats  # (t, nullity - gauge) basis of the directions beyond the gauge
    is_exact: bool  # False if the directions were not computed

    def held(self) -> Flags:
        """Return constant coordinates, and further ones that leave no null direction."""
        held = self.constant.copy()
        for label in np.unique(self.labels):
            rows = np.flatnonzero(np.repeat(self.labels == label, np.diff(self.begin)))
            self._hold(rows, self.labels == label, held)
        return held

    def moving(self, directions: Floats) -> NDArray[np.int64]:
        """Return the variables that directions move, those that move most first."""
        squares = np.add.reduceat((directions**2).sum(axis=1), self.begin[:-1])
        return np.argsort(-squares, kind="stable")[: int((squares > 1e-9 * squares.max()).sum())]

    def _hold(self, rows: NDArray[np.int64], members: Flags, held: Flags) -> None:
        basis = self.directions[rows]
        left = _part(basis)
        position = {int(row): k for k, row in enumerate(rows)}
        first = next((int(v) for v in np.flatnonzero(members) if self._is_whole(int(v), left,
                      position)), None)  # fmt: skip
        wanted = left.shape[1]
        taken: list[int] = []
        while len(taken) < wanted:
            size = np.linalg.norm(left, axis=1)
            if first is not None and len(taken) < self.begin[first + 1] - self.begin[first]:
                candidates = [position[c] for c in range(*self.begin[first : first + 2].tolist())]
                best = max(candidates, key=lambda k: size[k])
            else:
                best = int(np.argmax(size))
            taken.append(best)
            along = left[best] / size[best]
            left = left - np.outer(left @ along, along)
        held[rows[taken]] = True

    def _is_whole(self, variable: int, basis: Floats, position: dict[int, int]) -> bool:
        """Return True if fixing a variable removes as many directions as it has coordinates."""
        span = range(*self.begin[variable : variable + 2].tolist())
        if len(span) > basis.shape[1] or self.constant[list(span)].any():
            return False
        rows = basis[[position[c] for c in span]]
        lengths = np.linalg.norm(rows, axis=1, keepdims=True)
        if not len(rows) or (lengths <= STILL * np.abs(basis).max()).any():
            return False
        values = np.linalg.svd(rows / lengths, compute_uv=False)
        return bool(values[-1] > INDEPENDENT)


def find_null_space(graph: Any) -> NullSpace:
    """Return the null space of a :class:`bundle.FactorGraph`."""
    graph.check_free()
    core_variables, core_factors = graph.core()
    variables = list(graph.variables.values())
    begin = np.concatenate([[0], np.cumsum([len(v.coordinates) for v in variables])])
    constant = np.concatenate([_constant(variable) for variable in variables])
    labels = np.array(list(connected(graph.variables, graph.factors, held_connect=False).values()))
    _, _, _, dependent = _core.graph_conditioning(core_variables, core_factors)
    nullity = len(dependent)
    none = np.zeros((len(constant), 0))
    if nullity == 0 or nullity > MOST_DIRECTIONS:
        return NullSpace(begin, constant, labels, nullity, {}, nullity, none, none, nullity == 0)
    found = _core.factor_graph_spectrum(core_variables, core_factors, constant, nullity, 1)
    directions, _ = np.linalg.qr(found["null_directions"])
    gauge, others, nullities = 0, [], {}
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label)
        rows = np.concatenate([np.arange(begin[v], begin[v + 1]) for v in members])
        basis = _part(directions[rows])
        if not basis.shape[1]:
            continue
        nullities[int(label)] = basis.shape[1]
        inside = _gauge_of([variables[v] for v in members], basis)
        gauge += inside.shape[1]
        whole = np.zeros((len(constant), basis.shape[1] - inside.shape[1]))
        whole[rows] = basis @ _complement(inside)
        others.append(whole)
    beyond = _of_few_variables(np.concatenate([none, *others], axis=1))
    return NullSpace(begin, constant, labels, nullity, nullities, gauge, directions, beyond, True)


def _constant(variable: Variable) -> Flags:
    size = len(variable.coordinates)
    return np.array(variable.held, bool) if variable.held else np.zeros(size, bool)


def _orthonormal(columns: Floats) -> Floats:
    if not columns.size:
        return np.zeros((len(columns), 0))
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > INDEPENDENT * max(values[0], 1e-300)])


def _part(rows: Floats) -> Floats:
    """Return an orthonormal basis of a component's directions: singular values are 1 or 0."""
    left, values, _ = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(left[:, values > 0.5])


def _of_few_variables(basis: Floats) -> Floats:
    """Return the basis of a space in which each vector has a 1 where all others are 0.

    Gauss-Jordan elimination with complete pivoting: independent undetermined variables become
    vectors of their own.
    """
    found = basis.copy()
    pivots: list[int] = []
    for k in range(found.shape[1]):
        left = np.abs(found[:, k:])
        left[pivots] = 0
        row, column = divmod(int(np.argmax(left)), left.shape[1])
        found[:, [k, k + column]] = found[:, [k + column, k]]
        found[:, k] /= found[row, k]
        others = np.arange(found.shape[1]) != k
        found[:, others] -= np.outer(found[:, k], found[row, others])
        pivots.append(row)
    return found


def _complement(columns: Floats) -> Floats:
    left, _, _ = np.linalg.svd(columns, full_matrices=True)
    return np.asarray(left[:, columns.shape[1] :])


def _gauge_of(variables: list[Variable], basis: Floats) -> Floats:
    """Return the coefficients of an orthonormal gauge in an orthonormal basis, as columns."""
    best = np.zeros((basis.shape[1], 0))
    for rows, motions in _motions(variables):
        left, values, right = np.linalg.svd(basis[rows], full_matrices=False)
        kept = values > INDEPENDENT * max(values[0], 1e-300)
        lengths = np.linalg.norm(motions, axis=0)  # translations and rotations differ in unit
        units = motions / np.where(lengths > 0, lengths, 1)
        along, cosines, _ = np.linalg.svd(left[:, kept].T @ _orthonormal(units))
        inside = along[:, : int((cosines > SAME).sum())]
        if inside.shape[1] > best.shape[1]:
            best = _orthonormal(right[kept].T @ (inside / values[kept, None]))
    return best


def _motions(variables: list[Variable]) -> list[tuple[NDArray[np.int64], Floats]]:
    """Return rows of a component and motions of the world there, for each convention."""
    sizes = [len(variable.coordinates) for variable in variables]
    begin = np.concatenate([[0], np.cumsum(sizes)])

    def rows_of(chosen: list[int]) -> NDArray[np.int64]:
        return np.concatenate([np.arange(begin[k], begin[k + 1]) for k in chosen])

    poses = [k for k, variable in enumerate(variables) if variable.manifold != "euclidean"]
    if not poses:
        size = max(set(sizes), key=sizes.count)
        alike = [k for k, n in enumerate(sizes) if n == size]
        if len(alike) < 2:
            return []
        return [(rows_of(alike), np.tile(np.eye(size), (len(alike), 1)))]
    is_planar = variables[poses[0]].manifold in ("so2", "se2")
    kinds = ("so2", "se2") if is_planar else ("so3", "se3")
    poses = [k for k in poses if variables[k].manifold in kinds]
    places = [variables[k].value for k in poses if variables[k].manifold == kinds[1]]
    first = 0 if is_planar else 4
    middle = np.zeros(3) if is_planar else np.array([0, 0, 0, 1.0, 0, 0, 0])
    if places:
        middle[first : first + (2 if is_planar else 3)] = np.mean(places, axis=0)[
            first : first + (2 if is_planar else 3)
        ]
    both = []
    for is_world_from_body in (True, False):
        blocks = [_motion_of(variables[k], middle, is_world_from_body) for k in poses]
        both.append((rows_of(poses), np.concatenate(blocks)))
    return both


def _motion_of(variable: Variable, middle: Floats, is_world_from_body: bool) -> Floats:
    """Return the motions of a variable: of the world (3 or 6), then by a change of scale."""
    value = variable.value
    if variable.manifold in ("so2", "so3"):
        size = 1 if variable.manifold == "so2" else 3
        turn = np.eye(size)
        if size == 3 and is_world_from_body:
            turn = rotation_matrices(value[None])[0].T
        still = np.zeros((size, 2 if size == 1 else 3))
        parts = (still, turn) if size == 1 else (turn, still)
        return np.concatenate([*parts, np.zeros((size, 1))], axis=1)
    d = 3 if variable.manifold == "se2" else 6
    moved = adjoint_between(value[None], middle)[0] if is_world_from_body else np.eye(d)
    scaled = np.zeros((d, 1))
    if d == 3:
        c, s = np.cos(value[2]), np.sin(value[2])
        scaled[:2, 0] = np.array([[c, s], [-s, c]]) @ value[:2]
    else:
        scaled[3:, 0] = rotation_matrices(value[None, :4])[0].T @ value[4:]
    return np.concatenate([moved, scaled], axis=1)
