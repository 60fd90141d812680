"""Options of a check of Jacobians, with the defaults of :func:`bundle.check_jacobians`."""

from __future__ import annotations

import math

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

SAMPLES_PER_IMAGE = 100
"""Number of observations to check per image."""
TOLERANCE = 1e-7
"""Relative error above which an entry is wrong."""


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class CheckOptions(Options):
    """Options of ``bundle check``.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    samples_per_image: int = option(
        SAMPLES_PER_IMAGE,
        "--samples",
        "number of observations to check for each image and its camera; of a graph, of factors "
        "with the same code and the same kinds of variables",
        minimum=1,
        maximum=math.inf,
        metavar="N",
    )
    seed: int = option(0, "--seed", "of the sampling", minimum=0, maximum=math.inf, metavar="N")
    tolerance: float = option(
        TOLERANCE,
        "--tolerance",
        "relative error above which an entry is wrong",
        metavar="X",
        late=True,
    )
    num_threads: int = option(
        0,
        "--threads",
        "number of threads, at most one per core; 0: all cores",
        minimum=0,
        maximum=math.inf,
        metavar="N",
    )
