"""Matrices of a problem and their block orders, for drawing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arguments import check_type
from bundle.figures.matplotlib.matrix_pattern import MatrixPattern
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.solving.layout import resolve_defaults

ORDERINGS = ("natural", "amd", "colamd", "metis", "nesdis")
"""Orders of the blocks of S; all but the first are CHOLMOD's."""


def reduced_pattern(problem: Problem, options: SolveOptions | None = None) -> MatrixPattern:
    """Return the pattern of the reduced camera system S; images with shared points are coupled.

    Raises:
        InputError: the options are invalid for the problem.
    """
    given = _given(problem, options)
    return MatrixPattern.of(_core.reduced_pattern(problem, given))


def information_pattern(problem: Problem, options: SolveOptions | None = None) -> MatrixPattern:
    """Return the pattern of the information matrix, an arrowhead: first points, then cameras.

    Raises:
        InputError: the options are invalid for the problem.
    """
    given = _given(problem, options)
    return MatrixPattern.of(_core.full_pattern(problem, given))


def order_blocks(pattern: MatrixPattern, ordering: str) -> NDArray[np.int32]:
    """Return the blocks of a pattern in the elimination order of a method.

    Raises:
        InputError: the method does not exist.
    """
    check_type("pattern", pattern, MatrixPattern)
    return _core.order_blocks(
        pattern.sizes.astype(np.int32),
        pattern.column_begin,
        pattern.rows.astype(np.int32),
        choice("ordering", ordering, ORDERINGS),
    )


def _given(problem: Problem, options: SolveOptions | None) -> dict[str, object]:
    check_type("problem", problem, Problem)
    return resolve_defaults(problem, SolveOptions.of(options, {}, "options")).asdict()
