"""Translation of COLMAP's options of a bundle adjustment to options of a solve.

COLMAP's options have the same names in pycolmap's objects and in a project.ini. An option belongs
to one of three groups:

- Options with a counterpart in a solve. They are translated.
- Options without influence on the minimum: they choose hardware, libraries, messages, or the linear
  solver by the number of images. They are ignored.
- All other options. They are accepted at COLMAP's default only, because they change the path of the
  solver or the minimum in a way that no option of a solve has.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.interface.options import SolveOptions

_REFINED = {
    "refine_rig_from_world": "poses",
    "refine_points3D": "points",
    "refine_focal_length": "focal",
    "refine_principal_point": "principal_point",
    "refine_extra_params": "extra",
}
_DEFAULTS: dict[str, Any] = {
    **dict.fromkeys(_REFINED, True),
    "refine_principal_point": False,
    "refine_sensor_from_rig": True,
    "constant_rig_from_world_rotation": False,
    "min_track_length": 0,
    "print_summary": True,
    "loss_function_type": "trivial",
    "loss_function_scale": 1.0,
    "use_gpu": False,
    "auto_select_solver_type": True,
    "min_num_residuals_for_cpu_multi_threading": 50000,
    "linear_solver_type": "sparse_normal_cholesky",
    "preconditioner_type": "jacobi",
    "trust_region_strategy_type": "levenberg_marquardt",
    "dogleg_type": "traditional_dogleg",
    "initial_trust_region_radius": 1e4,
    "max_num_iterations": 100,
    "max_solver_time_in_seconds": 1e9,
    "num_threads": -1,
    "function_tolerance": 0.0,
    "gradient_tolerance": 1e-4,
    "parameter_tolerance": 0.0,
}
"""COLMAP's defaults of the options that are translated."""

ROUNDING = 1e-13
"""Least relative change of the cost that is no rounding error. At COLMAP's tolerance of 0, a solver
whose gradient is above its tolerance rejects such steps at random, often more than it took.
"""

WITHOUT_INFLUENCE = frozenset(
    {
        *("gpu_index", "min_num_images_gpu_solver"),
        *(f"max_num_images_direct_{kind}_solver" for kind in ("dense_cpu", "sparse_cpu")),
        *(f"max_num_images_direct_{kind}_solver" for kind in ("dense_gpu", "sparse_gpu")),
        *("dense_linear_algebra_library_type", "sparse_linear_algebra_library_type"),
        *("use_explicit_schur_complement", "dynamic_sparsity", "visibility_clustering_type"),
        *("logging_type", "minimizer_progress_to_stdout", "update_state_every_iteration"),
        *("trust_region_problem_dump_directory", "trust_region_problem_dump_format_type"),
        # Only with other options, which are refused.
        *("line_search_direction_type", "line_search_type", "line_search_interpolation_type"),
        *("nonlinear_conjugate_gradient_type", "max_lbfgs_rank"),
        *("use_approximate_eigenvalue_bfgs_scaling", "min_line_search_step_size"),
        *("line_search_sufficient_function_decrease", "max_line_search_step_contraction"),
        *("min_line_search_step_contraction", "max_num_line_search_step_size_iterations"),
        *("max_num_line_search_direction_restarts", "max_line_search_step_expansion"),
        "line_search_sufficient_curvature_decrease",
        *("max_consecutive_nonmonotonic_steps", "inner_iteration_tolerance"),
        *("gradient_check_relative_precision",),
        "gradient_check_numeric_derivative_relative_step_size",
    }
)
_OF_ITERATIVE = frozenset({"min_linear_solver_iterations", "max_linear_solver_iterations", "eta"})
"""Accuracy of an iterative linear solver; no influence unless the options request such a solver."""

_ITERATIVE = ("iterative_schur", "cgnr")


@dataclass(frozen=True, kw_only=True)
class ColmapAdjustment:
    """Options of COLMAP's bundle adjustment as options of a solve."""

    options: SolveOptions  # options of the solve, without constant cameras, images and points
    min_track_length: int  # points with shorter tracks take no part; they are not deleted
    constant_rotations: bool  # True to keep the rotation of rig_from_world
    min_residuals_for_threads: int  # number of residuals below which one thread is used
    max_seconds: float  # time after which the solve stops
    print_summary: bool  # True to print the summary
    asks_for_gpu: bool  # True if the options request a GPU, which no solve uses


def colmap_adjustment(
    given: Mapping[str, Any],
    defaults: Mapping[str, Any],
    place: Callable[[str], str] = str,
) -> ColmapAdjustment:
    """Translate COLMAP's options.

    Args:
        given: values by COLMAP's names; names of choices in any case.
        defaults: COLMAP's values of the options that are not translated.
        place: function from a name to its place, for messages.

    Raises:
        InputError: no solve can honour an option; the message names it.
    """
    _refuse_others(given, defaults, place)
    known = {
        name: _typed(place(name), given[name], default) if name in given else default
        for name, default in _DEFAULTS.items()
    }
    try:
        options = _solve_options(known)
    except InputError as error:
        name, _, rest = str(error).partition(": ")
        raise InputError(f"{place(_COLMAP_NAMES.get(name, name))}: {rest}") from None
    for name in ("min_track_length", "max_solver_time_in_seconds"):
        if known[name] < 0:
            raise InputError(f"{place(name)}: expected at least 0, found {known[name]}")
    return ColmapAdjustment(
        options=options,
        min_track_length=known["min_track_length"],
        constant_rotations=known["constant_rig_from_world_rotation"],
        min_residuals_for_threads=known["min_num_residuals_for_cpu_multi_threading"],
        max_seconds=known["max_solver_time_in_seconds"],
        print_summary=known["print_summary"],
        asks_for_gpu=known["use_gpu"],
    )


_COLMAP_NAMES = {
    "loss": "loss_function_type",
    "loss_scale": "loss_function_scale",
    "linear_solver_type": "linear_solver_type",
}


def _refuse_others(
    given: Mapping[str, Any], defaults: Mapping[str, Any], place: Callable[[str], str]
) -> None:
    chosen = not given.get("auto_select_solver_type", True)
    solver = str(given.get("linear_solver_type", "")).lower()
    free = WITHOUT_INFLUENCE
    if not (chosen and solver in _ITERATIVE):
        free |= _OF_ITERATIVE
    for name, value in given.items():
        if name in _DEFAULTS or name in free:
            continue
        if name not in defaults:
            raise InputError(
                f"{place(name)}: expected an option that bundle knows, found {brief(value)}"
            )
        if value != defaults[name]:
            raise InputError(
                f"{place(name)}: expected COLMAP's default {defaults[name]}, the only value that "
                f"bundle supports, found {brief(value)}"
            )


def _solve_options(known: Mapping[str, Any]) -> SolveOptions:
    refine = tuple(ours for name, ours in _REFINED.items() if known[name])
    values: dict[str, Any] = {
        name: known[name]
        for name in (
            *("initial_trust_region_radius", "max_num_iterations"),
            *("function_tolerance", "gradient_tolerance", "parameter_tolerance"),
        )
    }
    if 0 <= values["function_tolerance"] < ROUNDING:
        values["function_tolerance"] = ROUNDING
    strategy = known["trust_region_strategy_type"]
    if strategy == "dogleg" and known["dogleg_type"] == "subspace_dogleg":
        strategy = "subspace_dogleg"
    loss = known["loss_function_type"]
    if loss != "trivial":
        values |= {"loss": loss, "loss_scale": known["loss_function_scale"]}
    if not known["auto_select_solver_type"]:
        values["linear_solver_type"] = solver = known["linear_solver_type"]
        if solver in _ITERATIVE:
            values["preconditioner_type"] = known["preconditioner_type"]
    return SolveOptions(
        convergence="colmap",
        refine=refine,
        refine_sensor_from_rig=known["refine_sensor_from_rig"],
        trust_region_strategy_type=strategy,
        num_threads=max(0, known["num_threads"]),
        **values,
    )


def _typed(place: str, value: Any, default: Any) -> Any:
    kind = type(default)
    if isinstance(value, str):
        return _parsed(place, value.strip(), kind)
    number = float(value) if kind is float and not isinstance(value, bool) else value
    if not isinstance(number, kind) or (kind is float and math.isnan(number)):
        raise InputError(f"{place}: expected {_WORDS[kind]}, found {brief(value)}")
    return number


_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a name"}
_BOOLEANS = {"1": True, "true": True, "0": False, "false": False}


def _parsed(place: str, text: str, kind: type) -> Any:
    try:
        if kind is bool:
            return _BOOLEANS[text.lower()]
        number = text.lower() if kind is str else kind(text)
        if not isinstance(number, float) or math.isfinite(number):
            return number
    except (KeyError, ValueError):
        pass
    raise InputError(f"{place}: expected {_WORDS[kind]}, found {brief(text)}") from None
