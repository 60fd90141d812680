"""Fields of Ceres' further options of the trust region, under Ceres' names."""

from __future__ import annotations

from typing import Any

from bundle.errors import InputError
from bundle.interface.option_fields import option

LARGEST_RADIUS = 1e16
"""Largest trust region radius of both backends, with negligible damping."""

CERES_ONLY = ("min_lm_diagonal", "max_lm_diagonal", "use_nonmonotonic_steps")
"""Options of which other trust regions than Ceres' have no other value than the default."""

_STRATEGIES = ("levenberg_marquardt", "dogleg", "subspace_dogleg")


def initial_radius() -> Any:
    """Return the field of the radius of the first step."""
    return option(
        1e4,
        "--initial-trust-region-radius",
        "trust region radius of the first step: the reciprocal of Levenberg-Marquardt's damping, "
        "or the length of a dogleg's step, both relative to the columns of the Jacobian. A good "
        "start needs fewer steps with 1e6, a bad start may need more or end at a higher cost",
        above=0.0,
        maximum=LARGEST_RADIUS,
        metavar="X",
        only_with=("trust_region_strategy_type", _STRATEGIES),
    )


def largest_radius() -> Any:
    """Return the field of the largest radius."""
    return option(
        LARGEST_RADIUS,
        "--max-trust-region-radius",
        "largest trust region radius of Levenberg-Marquardt; a smaller value keeps the damping "
        "lambda = 1 / radius above a bound",
        above=0.0,
        maximum=LARGEST_RADIUS,
        metavar="X",
        only_with=("trust_region_strategy_type", ("levenberg_marquardt",)),
    )


def smallest_radius() -> Any:
    """Return the field of the radius at which a solve ends."""
    return option(
        1e-32,
        "--min-trust-region-radius",
        "trust region radius at which the solve ends",
        minimum=0.0,
        metavar="X",
    )


def relative_decrease() -> Any:
    """Return the field of the least relative decrease of an accepted step."""
    return option(
        1e-3,
        "--min-relative-decrease",
        "a step is accepted if its decrease of the cost, divided by the decrease that the model "
        "predicts, exceeds X",
        minimum=0.0,
        below=1.0,
        metavar="X",
    )


def most_invalid_steps() -> Any:
    """Return the field of the number of failures that end a solve."""
    return option(
        10,
        "--max-invalid-steps",
        "consecutive steps without a solution of the linear system after which the solve fails "
        "(Ceres' default is 5)",
        minimum=1,
        metavar="N",
    )


def lm_diagonal(which: str, default: float) -> Any:
    """Return the field of a bound of the diagonal that damps the scaled normal equations."""
    return option(
        default,
        f"--{which}-lm-diagonal",
        f"{'lower' if which == 'min' else 'upper'} bound of the diagonal of J^T J (scaled columns) "
        "in Levenberg-Marquardt's damping; other values need --backend ceres",
        above=0.0,
        metavar="X",
    )


def nonmonotonic_steps() -> Any:
    """Return the field that allows steps that raise the cost."""
    return option(
        False,
        "--use-nonmonotonic-steps",
        "accept steps that raise the cost for some steps; needs Ceres as the backend",
    )


def most_nonmonotonic_steps() -> Any:
    """Return the field of the number of steps that may raise the cost."""
    return option(
        5,
        "--max-nonmonotonic-steps",
        "consecutive steps that may raise the cost",
        minimum=1,
        metavar="N",
        only_with=("use_nonmonotonic_steps", (True,)),
    )


def check_order(options: Any) -> None:
    """Refuse bounds that exclude each other."""
    for low, high in (
        ("initial_trust_region_radius", "max_trust_region_radius"),
        ("min_trust_region_radius", "initial_trust_region_radius"),
        ("min_lm_diagonal", "max_lm_diagonal"),
    ):
        least, most = getattr(options, low), getattr(options, high)
        if least > most:
            raise InputError(f"{low}: expected at most {high} ({most:g}), found {least:g}")
