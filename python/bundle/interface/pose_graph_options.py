"""Options of a solve of a pose graph."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option
from bundle.interface.options import BACKENDS, LOSSES, TRUST_REGION_STRATEGIES

__all__ = ["POSE_ERRORS", "PoseGraphOptions"]

POSE_ERRORS = ("log", "g2o", "ceres")

GRAPH_LOSSES = (*LOSSES, "geman_mcclure", "dcs", "switchable", "gnc_tls", "auto")


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class PoseGraphOptions(Options):
    """Options of :func:`bundle.solve` for a :class:`bundle.PoseGraph`.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    backend: str = option(
        "auto",
        "--backend",
        "solver library: fused is our own, with block-sparse normal equations; auto takes it",
        choices=BACKENDS,
    )
    error: str = option(
        "log",
        "--error",
        "error of an edge: log is the logarithm of Z^-1 X_i^-1 X_j as a whole (GTSAM's), g2o its "
        "translation and angle, or in space the vector part of its quaternion, ceres that of "
        "Ceres' pose graph examples",
        choices=POSE_ERRORS,
    )
    init: str = option(
        "file",
        "--init",
        "where the solve starts: the file's poses, a chain or a tree of edges, the chordal "
        "relaxation (two linear solves), or auto: the one of these from which some steps reach "
        "the least cost",
        choices=("file", "odometry", "spanning_tree", "chordal", "auto"),
    )
    information: str = option(
        "file",
        "--information",
        "information of the edges: the file's, or isotropic: one number for the rotation and one "
        "for the translation, the means of the diagonal",
        choices=("file", "isotropic"),
    )
    loss: str = option(
        "trivial",
        "--loss",
        "robust loss of an edge's whitened error; geman-mcclure, dcs and switchable constraints "
        "are for wrong closures, as is gnc-tls, which solves some tens of times and ends with each "
        "edge in or out; auto: none where no closure is to be doubted, else the better of dcs and "
        "gnc-tls, which then looks at the set of --consistency, too",
        choices=GRAPH_LOSSES,
    )
    loss_scale: float = option(
        1.0,
        "--loss-scale",
        "error at which the loss begins to bend, in sigmas; gnc-tls: in radii that hold 99.95 % "
        "of the errors of right edges",
        above=0.0,
        metavar="X",
        only_with=("loss", GRAPH_LOSSES[1:]),
    )
    loss_on: str = option(
        "closures",
        "--loss-on",
        "edges that the loss applies to; closures are edges that are not between consecutive ids",
        choices=("closures", "all"),
        only_with=("loss", GRAPH_LOSSES[1:]),
    )
    consistency: bool = option(
        False,
        "--consistency",
        "before the solve, find the largest set of closures that agree with each other pair by "
        "pair along the odometry, and leave the others out (needs SciPy)",
    )
    trust_region_strategy_type: str = option(
        "gauss_newton",
        "--trust-region",
        "how steps are found; gauss-newton is levenberg-marquardt that starts without damping",
        choices=("gauss_newton", *TRUST_REGION_STRATEGIES),
    )
    ordering: str = option(
        "auto",
        "--pose-ordering",
        "order in which the poses are eliminated; auto: the cheapest of all",
        choices=("auto", "amd", "metis", "natural"),
    )
    max_num_iterations: int = option(
        100, "--max-iterations", "maximum number of steps to try", minimum=0, metavar="N"
    )
    function_tolerance: float = option(
        1e-10,
        "--function-tolerance",
        "stop when |change of cost| < X * cost",
        minimum=0.0,
        metavar="X",
    )
    gradient_tolerance: float = option(
        1e-10,
        "--gradient-tolerance",
        "stop when max |gradient entry| <= X",
        minimum=0.0,
        metavar="X",
    )
    parameter_tolerance: float = option(
        1e-10,
        "--parameter-tolerance",
        "stop when |step| <= X * (|parameters| + X)",
        minimum=0.0,
        metavar="X",
    )
    num_threads: int = option(
        0,
        "--threads",
        "number of threads, capped at the number of cores; 0: all cores",
        minimum=0,
        metavar="N",
    )
