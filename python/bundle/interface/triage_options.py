"""Options of a triage: differences that count as noise."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class TriageOptions(Options):
    """Options of :func:`bundle.triage`: the largest differences that count as noise.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    time_noise: float = option(
        1.5,
        "--time-noise",
        "largest ratio of two times of equal work that is noise; short solves and busy machines "
        "have more",
        minimum=1.0,
        metavar="RATIO",
    )
    cost_noise: float = option(
        1e-3,
        "--cost-noise",
        "largest relative difference of two final costs that is noise; of odometry ten times as "
        "much, because its time budget ends some solves early",
        minimum=0.0,
        metavar="X",
    )
    step_noise: float = option(
        0.3,
        "--step-noise",
        "largest relative difference of two numbers of steps that is noise, and at least 2 steps",
        minimum=0.0,
        metavar="X",
    )
