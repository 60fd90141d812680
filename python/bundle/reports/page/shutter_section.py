"""Rolling shutters: readout, size of the motions, and what they gained."""

from __future__ import annotations

from typing import Any

from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.figures.twist_figures import twist_figures
from bundle.model.problem import Problem
from bundle.reports.sections import Section
from bundle.reports.terminal.shutter_tables import (
    about_shutter,
    shutter_fact,
    solved_data,
    solved_sentences,
)
from bundle.solving.result import Result


def shutter_section(
    problem: Problem, result: Result | None, covariance: Covariance | None
) -> list[Section]:
    """Return the rolling shutters of a problem, or of a solve; empty without any.

    Args:
        problem: the problem, that of the result if there is one.
        result: the solve.
        covariance: covariance of the problem, for sigmas of refined readouts.
    """
    facts = shutter_fact(problem)
    if not facts:
        return []
    sigmas = {} if covariance is None else covariance.readout_sigmas
    words = [] if result is None else solved_sentences(result, sigmas)
    return [
        Section(
            title="Rolling shutter",
            text=[
                *words,
                "Each image moves while it is read. Its pose is that of the middle row. "
                "Residuals by row are among the residuals over the image.",
            ],
            facts=facts,
            figures=twist_figures(problem),
        )
    ]


def shutter_data(
    problem: Problem, result: Result | None, covariance: Covariance | None
) -> dict[str, Any]:
    """Return the same for programs; empty without rolling shutters."""
    if result is None or not about_shutter(problem):
        return about_shutter(problem)
    return solved_data(result, {} if covariance is None else covariance.readout_sigmas)
