"""All findings about a model, the most important first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.interface.finding import Finding
from bundle.interface.options import SolveOptions
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.outliers import outliers
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem

__all__ = ["find"]

TESTS: tuple[Callable[[Measured], Finding | None], ...] = (outliers,)
"""One function per finding, in order of importance."""


def find(
    problem: Problem,
    *,
    source: str = "INPUT",
    target: str = "OUTPUT",
    given: Sequence[str] = (),
    options: SolveOptions | None = None,
    rounds: int = 0,
    covariance: Covariance | None = None,
    priors: Sequence[Any] = (),
    is_minimum: bool = False,
) -> tuple[Finding, ...]:
    """Return what a user should know about a model and do next.

    Args:
        problem: the model at its present values.
        source: path of the input, for the commands.
        target: path of the output, for the commands.
        given: flags of this run that the next command repeats, as words of a command line.
        options: options of the solve that made the model; None: unknown, and the defaults count.
        rounds: rounds of adjusting and filtering in this solve.
        covariance: covariance of the intrinsics, scale "sigma0", if it has been computed; None:
            computed here if that takes milliseconds.
        priors: measured positions of images in the frame of the problem.
        is_minimum: True if a solve with these options has just converged.
    """
    used = {problem.camera_models[camera] for camera in set(problem.image_camera.tolist())}
    if not problem.num_observations or not used <= camera_models().keys():
        return ()
    measured = Measured(
        whole=problem,
        command=NextCommand(source, target, given),
        options=SolveOptions() if options is None else options,
        rounds=rounds,
        covariance=covariance,
        priors=priors,
        is_minimum=is_minimum,
    )
    found = (test(measured) for test in TESTS)
    return tuple(finding for finding in found if finding is not None)
