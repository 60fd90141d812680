"""Robust losses (M-estimators): values, and the correction of residuals and Jacobians.

A residual r costs 1/2 rho(||r||^2). Names and scales are those of :class:`bundle.SolveOptions`. All
values are computed by the C++ code that a solve uses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import Array, as_declared
from bundle.errors import InputError
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES

__all__ = ["SECOND_ORDER_TERMS", "Corrected", "correct", "evaluate_loss", "second_order_block"]

SECOND_ORDER_TERMS = ("full", "clamped", "ceres")


class Corrected(NamedTuple):
    """A residual (m,) and its Jacobian (m, n), corrected for a least-squares solver."""

    residual: NDArray[np.float64]
    jacobian: NDArray[np.float64]


def evaluate_loss(loss: str, scale: float, squared_norms: ArrayLike) -> NDArray[np.float64]:
    """Return rho, rho' and rho'' at squared norms s = ||r||^2.

    Args:
        loss: name of the loss, as in SolveOptions.
        scale: norm above which the loss differs from the quadratic, in the unit of r.
        squared_norms: (N,) values s, not negative.

    Returns:
        (N, 3) array; rho' and rho'' are derivatives with respect to s.
    """
    name = choice("loss", loss, LOSSES)
    scale = number("scale", scale, above=0)
    squared = as_declared("squared_norms", squared_norms, Array(("N",), "at least 0"))
    return _core.evaluate_loss(name, scale, squared)


def second_order_block(
    rho: ArrayLike, residual: ArrayLike, jacobian: ArrayLike
) -> NDArray[np.float64]:
    """Return Triggs' block J^T (rho' I + 2 rho'' r r^T) J, (n, n), which may be indefinite.

    Args:
        rho: (3,) rho, rho', rho'' at ||r||^2.
        residual: (m,) r.
        jacobian: (m, n) J.
    """
    return _core.second_order_block(*_checked(rho, residual, jacobian))


def correct(
    rho: ArrayLike, residual: ArrayLike, jacobian: ArrayLike, second_order_term: str = "ceres"
) -> Corrected | None:
    """Return the corrected residual and Jacobian that replace r and J in a least-squares solver.

    Args:
        rho: (3,) rho, rho', rho'' at ||r||^2, with rho' > 0 if rho'' is not zero.
        residual: (m,) r.
        jacobian: (m, n) J.
        second_order_term: "full" (Triggs'), "clamped" (no second-order term if rho'' <= 0) or
            "ceres" (Ceres' code).

    Returns:
        The corrected pair; None if the full correction does not exist because the block is singular
        or indefinite.
    """
    arrays = _checked(rho, residual, jacobian)
    _, first, second = arrays[0]
    if not (first >= 0 and (first > 0 or second == 0)):
        raise InputError(f"rho: expected rho' above 0, found {first}")
    term = choice("second_order_term", second_order_term, SECOND_ORDER_TERMS)
    pair = _core.correct(*arrays, term)
    return None if pair is None else Corrected(*pair)


def _checked(
    rho: ArrayLike, residual: ArrayLike, jacobian: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    sizes: dict[str | int, int] = {}
    three = as_declared("rho", rho, Array((3,)))
    r = as_declared("residual", residual, Array(("m",)), sizes)
    j = as_declared("jacobian", jacobian, Array(("m", "n")), sizes)
    if not j.size:
        raise InputError(f"residual, jacobian: expected numbers, found shape {j.shape}")
    return three, r, j
