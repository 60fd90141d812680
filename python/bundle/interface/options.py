"""Options of a solve, and of a solve of a factor graph.

Names, defaults and meanings are defined only here. The command line generates its flags from these
fields, the JSON report lists them, and ``bundle._core`` reads them by name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Self

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import (
    REFINABLE,
    SENSORS,
    checked,
    option,
    refined_names,
    sensor_pairs,
    two_sigmas,
    whole_ids,
)

BACKENDS = ("auto", "fused", "ceres")
LINEAR_SOLVER_TYPES = (
    "auto",
    "dense_schur",
    "sparse_schur",
    "iterative_schur",
    "dense_normal_cholesky",
    "sparse_normal_cholesky",
    "dense_qr",
    "cgnr",
)
ORDERINGS = ("points_first", "cameras_first", "automatic")
PRECONDITIONER_TYPES = (
    "identity",
    "jacobi",
    "schur_jacobi",
    "cluster_jacobi",
    "cluster_tridiagonal",
    "schur_power_series_expansion",
    "two_level",
)
SCHUR_COMPLEMENTS = ("auto", "explicit", "implicit")
# Meaning of auto by backend and linear solver. The core decides; predictions look it up here.
AUTO_PRECONDITIONER = {
    ("fused", "iterative_schur"): "two_level",
    ("ceres", "iterative_schur"): "schur_jacobi",
    ("ceres", "cgnr"): "jacobi",
}
LARGEST_RADIUS = 1e16  # largest trust region radius of both backends, with negligible damping
CERES_ONLY = ("min_lm_diagonal", "max_lm_diagonal", "use_nonmonotonic_steps")
"""Options of which other trust regions than Ceres' have no other value than the default."""
TRUST_REGION_STRATEGIES = ("levenberg_marquardt", "dogleg", "subspace_dogleg")
LOSSES = ("trivial", "huber", "soft_l1", "cauchy", "arctan", "tukey")
GAUGES = ("auto", "none", "two_cameras", "three_points")
CHEIRALITIES = ("auto", "algebraic", "zero")
CONVERGENCE_RULES = ("sigmas", "ceres", "colmap")
TWISTS = ("free", "tied", "hard")

REFINED = (
    *("num_threads", "refine", "fixed_camera_ids", "fixed_image_ids", "fixed_point_ids"),
    *("refine_sensor_from_rig", "fixed_sensors"),
    *("twists", "twist_sigma", "refine_readout"),
)
"""Options of the commands that examine a problem without solving it, and the thread count."""
PATTERN = (*REFINED, "gauge")
INFORMATION = (*REFINED, "loss", "loss_scale")
LINEARIZATION = (*REFINED, "gauge", "loss", "loss_scale")
"""Options on which the sparsity pattern, the information matrix and the linearization depend."""


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class SolveOptions(Options):
    """Options of :func:`bundle.solve`, with Ceres' names if Ceres has the option.

    Choices are accepted in any case, with hyphens or underscores ("sparse-schur", "SPARSE_SCHUR").

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
            For combinations that no backend supports, :func:`bundle.solve` raises this error.
    """

    backend: str = option(
        "auto",
        "--backend",
        "solver library: fused is our own solver, which eliminates points; auto uses fused if it "
        "supports the problem, otherwise Ceres, and reports the reason",
        choices=BACKENDS,
    )
    linear_solver_type: str = option(
        "auto",
        "--solver",
        "linear solver; auto chooses by predicted cost and reports the reason",
        choices=LINEAR_SOLVER_TYPES,
    )
    linear_solver_ordering: str = option(
        "points_first",
        "--ordering",
        "blocks that are eliminated first",
        choices=ORDERINGS,
        only_with=(
            "linear_solver_type",
            (
                "auto",
                "dense_schur",
                "sparse_schur",
                "iterative_schur",
                "sparse_normal_cholesky",
            ),
        ),
        idle="note",
    )
    preconditioner_type: str = option(
        "auto",
        "--preconditioner",
        "preconditioner of iterative-schur and cgnr; auto: two-level for iterative-schur (fused), "
        "schur-jacobi for iterative-schur (Ceres), jacobi for cgnr",
        choices=("auto", *PRECONDITIONER_TYPES),
        only_with=("linear_solver_type", ("auto", "iterative_schur", "cgnr")),
        idle="note",
    )
    schur_complement: str = option(
        "auto",
        "--schur-complement",
        "reduced camera system of iterative-schur: a matrix (explicit), or products with it in "
        "passes over the points (implicit), which are faster if points have long tracks in many "
        "images; auto: by predicted time (fused), implicit (Ceres)",
        choices=SCHUR_COMPLEMENTS,
        only_with=("linear_solver_type", ("auto", "iterative_schur")),
        idle="note",
    )
    trust_region_strategy_type: str = option(
        "levenberg_marquardt",
        "--trust-region",
        "trust region strategy",
        choices=TRUST_REGION_STRATEGIES,
    )
    initial_trust_region_radius: float = option(
        1e4,
        "--initial-trust-region-radius",
        "trust region radius of the first step: the reciprocal of Levenberg-Marquardt's damping, "
        "or the length of a dogleg's step, both relative to the columns of the Jacobian. A good "
        "start needs fewer steps with 1e6, a bad start may need more or end at a higher cost",
        above=0.0,
        maximum=LARGEST_RADIUS,
        metavar="X",
        only_with=("trust_region_strategy_type", TRUST_REGION_STRATEGIES),
    )
    max_trust_region_radius: float = option(
        LARGEST_RADIUS,
        "--max-trust-region-radius",
        "largest trust region radius of Levenberg-Marquardt; a smaller value keeps the damping "
        "lambda = 1 / radius above a bound",
        above=0.0,
        maximum=LARGEST_RADIUS,
        metavar="X",
        only_with=("trust_region_strategy_type", ("levenberg_marquardt",)),
    )
    min_trust_region_radius: float = option(
        1e-32,
        "--min-trust-region-radius",
        "trust region radius at which the solve ends",
        minimum=0.0,
        metavar="X",
    )
    min_relative_decrease: float = option(
        1e-3,
        "--min-relative-decrease",
        "a step is accepted if its decrease of the cost, divided by the decrease that the model "
        "predicts, exceeds X",
        minimum=0.0,
        below=1.0,
        metavar="X",
    )
    max_num_consecutive_invalid_steps: int = option(
        10,
        "--max-invalid-steps",
        "consecutive steps without a solution of the linear system after which the solve fails "
        "(Ceres' default is 5)",
        minimum=1,
        metavar="N",
    )
    min_lm_diagonal: float = option(
        1e-6,
        "--min-lm-diagonal",
        "lower bound of the diagonal of J^T J (scaled columns) "
        "in Levenberg-Marquardt's damping; other values need --backend ceres",
        above=0.0,
        metavar="X",
    )
    max_lm_diagonal: float = option(
        1e32,
        "--max-lm-diagonal",
        "upper bound of the diagonal of J^T J (scaled columns) "
        "in Levenberg-Marquardt's damping; other values need --backend ceres",
        above=0.0,
        metavar="X",
    )
    use_nonmonotonic_steps: bool = option(
        False,
        "--use-nonmonotonic-steps",
        "accept steps that raise the cost for some steps; needs Ceres as the backend",
    )
    max_consecutive_nonmonotonic_steps: int = option(
        5,
        "--max-nonmonotonic-steps",
        "consecutive steps that may raise the cost",
        minimum=1,
        metavar="N",
        only_with=("use_nonmonotonic_steps", (True,)),
    )
    loss: str = option(
        "trivial", "--loss", "robust loss of a reprojection error", choices=LOSSES, use=10
    )
    loss_scale: float = option(
        1.0,
        "--loss-scale",
        "error at which the loss begins to bend, in pixels",
        above=0.0,
        metavar="PIXELS",
        only_with=("loss", LOSSES[1:]),
        use=11,
    )
    max_num_iterations: int = option(
        100, "--max-iterations", "maximum number of steps to try", minimum=0, metavar="N", use=80
    )
    convergence: str = option(
        "sigmas",
        "--convergence",
        "stopping rule without a loss. sigmas: the function tolerance is reached, and the minimum "
        "is less than about 0.1 standard deviations away. ceres: the function tolerance is "
        "reached. colmap: as ceres, and gradients of rotations are moves of unit quaternions",
        choices=CONVERGENCE_RULES,
    )
    function_tolerance: float = option(
        1e-6,
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
        1e-8,
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
        use=81,
    )
    deterministic: bool = option(
        False,
        "--deterministic",
        "the same result, bit for bit, for any number of threads; results of different instruction "
        "sets (AVX-512, AVX2, baseline) still differ in the last bits",
    )
    refine: tuple[str, ...] = option(
        ("poses", "points", "focal", "extra"),
        "--refine",
        "parameters to refine, out of "
        + ", ".join((*REFINABLE, SENSORS)).replace("_", "-")
        + "; --refine-sensor-from-rig adds the last, the poses of sensors on their rigs",
        metavar="LIST",
        use=30,
    )
    fixed_camera_ids: tuple[int, ...] = option(
        (),
        "--fix-cameras",
        "ids of cameras with constant intrinsics",
        metavar="IDS",
        value="ids",
    )
    fixed_image_ids: tuple[int, ...] = option(
        (),
        "--fix-images",
        "images with constant poses; the frames of such images on a rig are constant, too, and "
        "their sensors are not refined",
        metavar="IMAGES",
        value="images",
        use=61,
    )
    fixed_point_ids: tuple[int, ...] = option(
        (), "--fix-points", "ids of constant points", metavar="IDS", value="ids"
    )
    refine_sensor_from_rig: bool = option(
        False,
        "--refine-sensor-from-rig",
        "refine the poses of sensors on their rigs, except for rigs whose reference sensor "
        "observes nothing",
    )
    fixed_sensors: tuple[tuple[int, int], ...] = option(
        (),
        "--fix-sensors",
        "sensors with a constant pose on their rig, each given by the ids of rig and camera",
        metavar="SENSORS",
        value="sensors",
    )
    twists: str = option(
        "free",
        "--twists",
        "motion of a rolling-shutter camera during readout. free: six parameters per image. tied: "
        "the same, with a prior that the motion equals the readout times the motion per frame "
        "between the neighbours in the video. hard: exactly this value; all standard deviations "
        "are then too small",
        choices=TWISTS,
    )
    twist_sigma: tuple[float, ...] = option(
        (),
        "--twist-sigma",
        "standard deviations of tied twists per frame height: of the rotation in radians, and of "
        "the translation in the reconstruction's length unit",
        metavar="W,V",
        late=True,
        only_with=("twists", ("tied",)),
    )
    refine_readout: bool = option(
        False,
        "--refine-readout",
        "refine the readout of each camera, from tied or hard twists",
        only_with=("twists", ("tied", "hard")),
    )
    gauge: str = option(
        "auto",
        "--gauge",
        "how the gauge is fixed: position, rotation and scale of the world (7 degrees of freedom, "
        "fewer with fixed points, images or baselines of rigs). auto: none for BAL and with "
        "positions or other factors, otherwise two-cameras. two-cameras fixes exactly the free "
        "degrees. three-points fixes 9 numbers, 2 too many, as in COLMAP: the cost is higher, and "
        "covariances are smaller",
        choices=GAUGES,
    )
    cheirality: str = option(
        "auto",
        "--cheirality",
        "residual of an observation that its camera does not see. zero: none, as in COLMAP, but an "
        "observation that moves behind its camera during the solve has a constant cost. algebraic: "
        "the value of the formula. auto: algebraic for BAL and for wide lenses whose formula "
        "continues beyond 90 degrees, otherwise zero",
        choices=CHEIRALITIES,
    )
    check_solution: bool = option(
        True,
        "--check-solution",
        "search for signs of a wrong Jacobian after the solve and count the nonzeros of the "
        "information matrix; an invalid result is detected in any case",
    )

    def _check(self, fields: Iterable[dataclasses.Field[Any]]) -> None:
        super()._check(fields)
        for low, high in (
            ("initial_trust_region_radius", "max_trust_region_radius"),
            ("min_trust_region_radius", "initial_trust_region_radius"),
            ("min_lm_diagonal", "max_lm_diagonal"),
        ):
            least, most = getattr(self, low), getattr(self, high)
            if least > most:
                raise InputError(f"{low}: expected at most {high} ({most:g}), found {least:g}")
        if SENSORS in self.refine:
            refine = tuple(name for name in self.refine if name != SENSORS)
            object.__setattr__(self, "refine", refine)
            object.__setattr__(self, f"refine_{SENSORS}", True)

        if self.refine_readout and self.twists == "free":
            raise InputError(
                "refine_readout: expected tied or hard twists, found free ones, which determine "
                "only the product of readout and motion"
            )
        if self.twists == "tied" and not self.twist_sigma:
            raise InputError("twist_sigma: expected two numbers above 0 if tied, found None")

    def _checked(self, field: dataclasses.Field[Any], value: Any) -> Any:
        if field.name == "twist_sigma":
            return two_sigmas(value)
        if field.name == "refine":
            return refined_names(value)
        if field.name == "fixed_sensors":
            return sensor_pairs(value)
        if field.name.startswith("fixed_"):
            return whole_ids(field.name, value)
        return checked(field, value)


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class GraphOptions(SolveOptions):
    """Options of :meth:`bundle.FactorGraph.solve`: the SolveOptions, and Gauss-Newton."""

    trust_region_strategy_type: str = option(
        "levenberg_marquardt",
        "--trust-region",
        "trust region strategy; gauss_newton is levenberg_marquardt with a start without damping",
        choices=("gauss_newton", *TRUST_REGION_STRATEGIES),
    )

    @classmethod
    def of(cls, options: Options | None, changes: Mapping[str, Any], caller: str) -> Self:
        """Return the options with some changed; ``options`` may also be plain SolveOptions."""
        if isinstance(options, SolveOptions) and not isinstance(options, cls):
            options = cls(**options.asdict())
        return super().of(options, changes, caller)
