"""Options of covariances, reliability, influence and plans, and of a check of Jacobians."""

from __future__ import annotations

import math
from collections.abc import Iterable

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.georeference_options import GCP_SIGMA, SCALE_BAR_SIGMA
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import choice, option

PARTS = ("poses", "points", "intrinsics")
GAUGES = ("inner", "two_cameras", "three_points", "none")
SCALES = ("unit", "sigma0")
ROBUST = ("weights", "sandwich")


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class CovarianceOptions(Options):
    """Options of ``bundle covariance``; a pose graph uses only pairs, gauge and scale."""

    of: str | None = option(  # type: ignore[assignment]  # in place of Options.of
        None,
        "--of",
        "some of poses, points, intrinsics",
        metavar="LIST",
        value="word",
        unset="all",
        use=3,
    )
    relative: tuple[tuple[int, int], ...] = option(
        (),
        "--relative",
        "pairs of image ids, for covariances of cam_b_from_cam_a; for a pose graph pairs of pose "
        "ids, for X_a^-1 X_b",
        metavar="A:B,...",
        value="pairs",
        late=True,
        use=4,
    )
    gauge: str | None = option(
        None,
        "--gauge",
        "how position, rotation and scale of the world are fixed. inner: by the constraints of "
        "least trace (the pseudo-inverse); none: by priors and fixed parameters; first, for pose "
        "graphs: by the first pose of each component without a fixed pose, as in a solve",
        choices=(*GAUGES, "first"),
        unset="inner; pose graphs: first",
        late=True,
        use=5,
    )
    scale: str = option(
        SCALES[0],
        "--scale",
        "unit: residuals have a sigma of 1 px; sigma0: the sigma is estimated from the residuals; "
        "priors keep their sigmas",
        choices=SCALES,
        use=6,
    )
    robust: str | None = option(
        None,
        "--robust",
        "effect of --loss: weights of observations, or H^-1 (sum psi psi^T) H^-1, which is valid "
        "for residuals of any distribution",
        choices=ROBUST,
        unset="weights",
        late=True,
        use=7,
    )


DELTA0 = 4.13
"""Shift of a standardised residual that a test finds: level 0.1 %, power 80 % (W. Baarda)."""
NOT_CHECKABLE = 0.02  # redundancy below which an error cannot be checked
GAUGE = 1e-7  # relative size of N^T g above which free motions of the world change a quantity


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class ReliabilityOptions(Options):
    """Options of ``bundle diagnose`` for reliability."""

    reliability: bool = option(
        False,
        "--reliability",
        "also compute the redundancy of every measurement, and which errors would go unnoticed",
        negatable=False,
        use=3,
    )
    delta0: float = option(
        DELTA0,
        "--delta0",
        "shift of a standardised residual that a test has to find; 4.13: level 0.1 %, power 80 %",
        above=0,
        metavar="X",
        only_with=("reliability", (True,)),
    )


WITHOUT = ("observations", "points", "images")


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class InfluenceOptions(Options):
    """Options of ``bundle influence``."""

    on: str = option(
        "",
        "--on",
        "the quantity: distance A B, height A B, angle A B C, volume A B C D, baseline I J, a "
        "camera's parameter such as f 1, or a ratio of two with ' / ' between them; A is a point "
        "id, the name of a control point or image:NAME",
        metavar="QUANTITY",
    )
    without: str = option(
        WITHOUT[0],
        "--without",
        "what is left out, one by one; images take a factorisation each",
        choices=WITHOUT,
    )


ADDED = ("image", "tie", "gcp", "bar")


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class PlanOptions(Options):
    """Options of ``bundle plan``."""

    on: str = option(
        "",
        "--for",
        "the quantity, as in bundle influence: distance A B, height A B, angle A B C, "
        "volume A B C D, baseline I J, a camera's parameter such as f 1, or a ratio",
        metavar="QUANTITY",
        use=3,
    )
    add: str = option(
        ",".join(ADDED),
        "--add",
        "what could be added: some of image, tie (an observation), gcp (a control point), bar",
        metavar="LIST",
        use=4,
    )
    count: int = option(
        3, "--count", "number of measurements to choose one by one", minimum=1, metavar="N", use=5
    )
    candidates: str | None = option(
        None,
        "--candidates",
        "poses of new images, in a format of bundle evaluate",
        metavar="FILE",
        value="path",
        unset="beside each image, as far away as neighbours are",
    )
    gcp_sigma: str = option(
        GCP_SIGMA,
        "--gcp-sigma",
        "standard deviation of control points, horizontal and vertical, in metres",
        metavar="H[/V]",
    )
    bar_sigma: float = option(
        SCALE_BAR_SIGMA,
        "--bar-sigma",
        "standard deviation of a new scale bar, in metres",
        above=0,
        metavar="METRES",
    )


def parts_of(
    name: str, value: str | Iterable[str], parts: tuple[str, ...] = PARTS
) -> tuple[str, ...]:
    """Return the named parts, in the order of ``parts``."""
    words = value.split(",") if isinstance(value, str) else list(value)
    named = {choice(name, word.strip() if isinstance(word, str) else word, parts) for word in words}
    if not named:
        raise InputError(f"{name}: expected at least one of {', '.join(parts)}, found ''")
    return tuple(part for part in parts if part in named)


SAMPLES_PER_IMAGE = 100  # number of observations to check per image
TOLERANCE = 1e-7  # relative error above which an entry is wrong


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class CheckOptions(Options):
    """Options of ``bundle check``."""

    samples_per_image: int = option(
        SAMPLES_PER_IMAGE,
        "--samples",
        "number of observations to check for each image and its camera; for a graph, of factors "
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
