"""Options of a solve of a pose graph, and of loop closing."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option, same
from bundle.interface.options import BACKENDS, LOSSES, TRUST_REGION_STRATEGIES, SolveOptions

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
        "solver library: fused is our own solver, with block-sparse normal equations; auto uses it",
        choices=BACKENDS,
    )
    error: str = option(
        "log",
        "--error",
        "error of an edge. log: the full logarithm of Z^-1 X_i^-1 X_j, as in GTSAM; g2o: its "
        "translation and its angle, or in 3D the vector part of its quaternion; ceres: the "
        "error of Ceres' pose graph examples",
        choices=POSE_ERRORS,
    )
    init: str = option(
        "lower",
        "--init",
        "start of the solve: the poses of the file, a chain of edges, a tree of edges, or the "
        "chordal relaxation (two linear solves). lower: the chordal relaxation if it costs less "
        "than the file's poses and there is no loss, otherwise the file's poses. auto: the start "
        "that leads to the lowest cost",
        choices=("lower", "file", "odometry", "spanning_tree", "chordal", "auto"),
    )
    information: str = option(
        "file",
        "--information",
        "information of the edges: full as in the file, or isotropic with one number for the "
        "rotation and one for the translation, the means of the diagonal",
        choices=("file", "isotropic"),
    )
    loss: str = option(
        "trivial",
        "--loss",
        "robust loss of the whitened error of an edge. geman-mcclure, dcs, switchable constraints "
        "and gnc-tls are for wrong closures; gnc-tls solves some tens of times and accepts or "
        "rejects each edge. auto: no loss if no closure is suspicious, otherwise the better of dcs "
        "and gnc-tls, which then also uses the set of --consistency",
        choices=GRAPH_LOSSES,
    )
    loss_scale: float = option(
        1.0,
        "--loss-scale",
        "error at which the loss begins to bend, in sigmas; for gnc-tls in radii that contain "
        "99.95 % of the errors of right edges",
        above=0.0,
        metavar="X",
        only_with=("loss", GRAPH_LOSSES[1:]),
    )
    loss_on: str = option(
        "closures",
        "--loss-on",
        "edges to which the loss applies; odometry joins each id with the next one, all other "
        "edges are closures",
        choices=("closures", "all"),
        only_with=("loss", GRAPH_LOSSES[1:]),
    )
    consistency: bool = option(
        False,
        "--consistency",
        "before the solve, find the largest set of closures that agree pairwise along the "
        "odometry, and leave out all others (needs SciPy)",
    )
    certify: bool = option(
        False,
        "--certify",
        "after the solve, test whether it is globally optimal, with a lower bound of chi2; if not, "
        "look for a lower minimum by a convex relaxation, and solve again from there "
        "(docs/certificates.md)",
    )
    trust_region_strategy_type: str = option(
        "gauss_newton",
        "--trust-region",
        "trust region strategy; gauss-newton is levenberg-marquardt with a start without damping",
        choices=("gauss_newton", *TRUST_REGION_STRATEGIES),
    )
    ordering: str = option(
        "auto",
        "--pose-ordering",
        "order in which the poses are eliminated; auto: the cheapest order",
        choices=("auto", "amd", "metis", "natural"),
    )
    max_num_iterations: int = same(SolveOptions, "max_num_iterations")
    function_tolerance: float = same(SolveOptions, "function_tolerance", default=1e-10)
    gradient_tolerance: float = same(
        SolveOptions,
        "gradient_tolerance",
        help="stop when max |gradient entry| <= X, in units of the typical information",
    )
    parameter_tolerance: float = same(SolveOptions, "parameter_tolerance", default=1e-10)
    num_threads: int = same(SolveOptions, "num_threads")


LOOP_LOSSES = ("trivial", "huber", "soft_l1", "cauchy")
"""Losses whose gradient does not vanish for large errors. Before a loop is closed, the errors of
all its closures are large."""


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class LoopOptions(Options):
    """Loop closures, and the loss that separates correct closures from wrong ones."""

    loops: str | None = option(
        None,
        "--loops",
        "file of loop closures. Before the solve, a pose graph of the images closes these loops; "
        "points move with their images. Edges are between image ids: EDGE_SE3:QUAT i j with the "
        "pose of camera j in the frame of camera i, in the length unit of the model near image i",
        metavar="FILE.g2o",
        value="path",
    )
    loop_loss: str = option(
        "cauchy",
        "--loop-loss",
        "robust loss that separates right from wrong closures; at least half of them must be "
        "right; trivial uses all",
        choices=LOOP_LOSSES,
        needs=("loops",),
        late=True,
    )
    loop_loss_scale: float = option(
        1.0,
        "--loop-loss-scale",
        "sigmas at which this loss begins to bend; a closure is right if its error is within 4.9 "
        "times this value",
        metavar="X",
        needs=("loops",),
        late=True,
    )
