"""What a solve can be asked for.

Names, defaults and meaning stand here once: the command line makes its flags from these fields, the
JSON report lists them, and ``bundle._core`` reads them by name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from bundle.errors import InputError
from bundle.option_fields import checked, choice, option

__all__ = ["SolveOptions"]

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
# What auto means, by backend and linear solver; the core decides, this is for who asks beforehand.
AUTO_PRECONDITIONER = {
    ("fused", "iterative_schur"): "two_level",
    ("ceres", "iterative_schur"): "schur_jacobi",
    ("ceres", "cgnr"): "jacobi",
}
TRUST_REGION_STRATEGIES = ("levenberg_marquardt", "dogleg", "subspace_dogleg")
LOSSES = ("trivial", "huber", "soft_l1", "cauchy", "arctan", "tukey")
REFINABLE = ("poses", "points", "focal", "principal_point", "extra")
GAUGES = ("auto", "none", "two_cameras", "three_points")
CHEIRALITIES = ("auto", "algebraic", "zero")


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """Options of :func:`bundle.solve`; Ceres' names wherever Ceres has the thing.

    Choices are accepted in any case, with hyphens or underscores ("sparse-schur", "SPARSE_SCHUR").

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
            Combinations that no backend can serve are refused by :func:`bundle.solve`.
    """

    backend: str = option(
        "auto",
        "--backend",
        "who solves: our own solver, made for eliminating points, or Ceres; auto takes the first "
        "for all that it supports and says why if not",
        choices=BACKENDS,
    )
    linear_solver_type: str = option(
        "auto",
        "--solver",
        "linear solver; auto chooses from the shape of the problem and says why",
        choices=LINEAR_SOLVER_TYPES,
    )
    linear_solver_ordering: str = option(
        "points_first", "--ordering", "what is eliminated first", choices=ORDERINGS
    )
    preconditioner_type: str = option(
        "auto",
        "--preconditioner",
        "of iterative-schur and cgnr; auto: two-level for the first by our own solver, "
        "schur-jacobi by Ceres; jacobi for the second",
        choices=("auto", *PRECONDITIONER_TYPES),
    )
    trust_region_strategy_type: str = option(
        "levenberg_marquardt", "--trust-region", "step strategy", choices=TRUST_REGION_STRATEGIES
    )
    loss: str = option("trivial", "--loss", "robust loss of a reprojection error", choices=LOSSES)
    loss_scale: float = option(
        1.0,
        "--loss-scale",
        "where the loss bends, in pixels",
        above=0.0,
        metavar="PIXELS",
    )
    max_num_iterations: int = option(
        100, "--max-iterations", "steps to try at most", minimum=0, metavar="N"
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
        "stop when the largest gradient entry is <= X",
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
        0, "--threads", "threads, at most one a core; 0: all cores", minimum=0, metavar="N"
    )
    deterministic: bool = option(
        False,
        "--deterministic",
        "the same result, bit for bit, for any number of threads",
    )
    refine: tuple[str, ...] = option(
        ("poses", "points", "focal", "extra"),
        "--refine",
        "what to refine, out of " + ",".join(REFINABLE).replace("_", "-"),
        metavar="LIST",
    )
    fixed_camera_ids: tuple[int, ...] = option(
        (), "--fix-cameras", "cameras whose intrinsics stay, by id", metavar="IDS"
    )
    fixed_image_ids: tuple[int, ...] = option(
        (), "--fix-images", "images whose pose stays, by id", metavar="IDS"
    )
    fixed_point_ids: tuple[int, ...] = option(
        (), "--fix-points", "points that stay, by id", metavar="IDS"
    )
    gauge: str = option(
        "auto",
        "--gauge",
        "how the gauge (7 degrees of freedom) is fixed; auto: two-cameras for COLMAP, none for BAL",
        choices=GAUGES,
    )
    cheirality: str = option(
        "auto",
        "--cheirality",
        "an observation behind its camera counts as zero (COLMAP) or keeps its algebraic residual "
        "(BAL); auto: as the input's format does",
        choices=CHEIRALITIES,
    )

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _checked(field, getattr(self, field.name)))

    def replace(self, **changes: Any) -> SolveOptions:
        """Return a copy with some options changed."""
        return dataclasses.replace(self, **changes)

    def asdict(self) -> dict[str, Any]:
        """Return every option by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}


def _checked(field: dataclasses.Field[Any], value: Any) -> Any:
    """Return the value in canonical form, or raise an InputError that names option and value."""
    if field.name == "refine":
        return _names(value)
    if field.name.startswith("fixed_"):
        return _ids(field.name, value)
    return checked(field, value)


def _names(value: Any) -> tuple[str, ...]:
    names = value.split(",") if isinstance(value, str) else list(value)
    given = [str(name).strip() for name in names]
    chosen = {choice("refine", name, REFINABLE) for name in given if name}
    return tuple(name for name in REFINABLE if name in chosen)


def _ids(name: str, value: Iterable[Any]) -> tuple[int, ...]:
    try:
        return tuple(sorted({int(entry) for entry in value}))
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected whole numbers, found {value!r}") from None
