"""Signature: tangent Jacobians padded with a column of zeros to the size of the block.

Older solvers expect a Jacobian by the parameters of a block (4 for a quaternion). They multiply it
by the Jacobian of the manifold's Plus. If the Plus Jacobian is (I, 0)^T, the tangent Jacobian with
a zero column is correct. For any other manifold it is wrong.
"""

from __future__ import annotations

import numpy as np

from bundle.checking.evidence import EXPLAINED, Finding, join_names
from bundle.checking.jacobian_deviation import Array, JacobianDeviation
from bundle.checking.residual_blocks import Layout

SCALES = (1.0, 2.0, 0.5)
"""Scales of tangent coordinates: a rotation vector, or twice or half a quaternion's vector part."""


def padded(
    layout: Layout, space: JacobianDeviation, tangent: JacobianDeviation, tolerance: float
) -> list[Finding]:
    """Return one finding per padded block if no other mistake exists.

    Args:
        layout: layout of the blocks.
        space: Jacobians by the parameters of the blocks.
        tangent: Jacobians by the tangent coordinates, at the same points.
        tolerance: relative error above which an entry is wrong.
    """
    wrong = set(np.flatnonzero((space.error > tolerance).any(axis=(0, 1))).tolist())
    findings = []
    first = first_tangent = 0
    for manifold in layout.manifolds:
        columns = list(range(first, first + manifold.size))
        moves = slice(first_tangent, first_tangent + manifold.tangent_size)
        first, first_tangent = first + manifold.size, first_tangent + manifold.tangent_size
        if manifold.tangent_size != manifold.size - 1 or not wrong & set(columns):
            continue
        given = space.analytic[..., columns]
        names = [layout.columns[j].name for j in columns]
        for place in np.flatnonzero(~given.any(axis=(0, 1))):
            if not _is_tangent(np.delete(given, place, axis=2), tangent.reference[..., moves]):
                continue
            wrong -= set(columns)
            findings.append(
                Finding(
                    "padded",
                    tuple(names),
                    f"{join_names(names)}: the Jacobian by the {manifold.tangent_size} tangent "
                    f"coordinates, padded with a zero column ({names[place]}), instead of that by "
                    f"the {manifold.size} numbers of the block",
                    float(space.error[..., columns].max()),
                )
            )
            break
    return [] if wrong else findings


def _is_tangent(given: Array, reference: Array) -> bool:
    """Return True if columns are derivatives by tangent coordinates, up to scale or rotation.

    Rotations and translations have three columns each. Their perturbation may be from the other
    side; then the columns are A Q with a rotation Q, and A A^T does not change.
    """
    parts = [slice(j, j + 3) for j in range(0, given.shape[2], 3)]
    for part in parts:
        right = reference[..., part]
        size = np.linalg.norm(right)
        products = right @ right.transpose(0, 2, 1)
        found = given[..., part] @ given[..., part].transpose(0, 2, 1)
        if not any(
            np.linalg.norm(found - scale**2 * products) <= EXPLAINED * size**2 * scale**2
            for scale in SCALES
        ):
            return False
    return True
