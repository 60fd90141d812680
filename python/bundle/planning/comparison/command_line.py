"""Command lines of a solve and of a comparison with given options."""

from __future__ import annotations

import dataclasses
import shlex
from typing import Any

import bundle._core as _core
from bundle.interface.compare_options import COMPARED, CompareOptions
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.planning.comparison.comparison_result import Comparison
from bundle.planning.inspection.inspection_result import Inspection


def command_line(
    options: SolveOptions | PoseGraphOptions, source: str = "INPUT", output: str = "OUTPUT"
) -> str:
    """Return the `bundle refine` command with these options; default values are left out."""
    words = ["bundle", "refine", source, "-o", output]
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if value != field.default:
            words += _flag(field, value)
    return shlex.join(words)


def comparison_command(comparison: Comparison, *, perturb: float) -> str:
    """Return the `bundle compare` command of a comparison, with another perturbation."""
    words = ["bundle", "compare"]
    words += [problem.name if problem.is_file else "INPUT" for problem in comparison.problems]
    words += ["--perturb", f"{perturb:g}"]
    defaults = CompareOptions()
    for name, listed in COMPARED.items():
        of = [m for m in comparison.methods if m.is_iterative or name != "preconditioner_type"]
        values = tuple(dict.fromkeys(getattr(method, name) for method in of))
        usual = (_core.hardware_threads(),) if listed == "threads" else getattr(defaults, listed)
        if values and values != usual:
            words += [f"--{listed.replace('_', '-')}", ",".join(map(str, values)).replace("_", "-")]
    for field in dataclasses.fields(comparison.options):
        value = getattr(comparison.options, field.name)
        if value != field.default:
            words += _flag(field, value)
    return shlex.join(words)


def recommended_command(
    inspection: Inspection, options: SolveOptions, source: str = "INPUT"
) -> str:
    """Return the `bundle refine` command that an inspection recommends; "" without one."""
    if inspection.recommended < 0:
        return ""
    best = inspection.methods[inspection.recommended]
    options = options.replace(
        linear_solver_type=best.linear_solver_type.lower(),
        preconditioner_type=best.preconditioner.lower() or "auto",
        backend="ceres" if best.backend == "CERES" else "auto",
    )
    return command_line(options, source)


def _flag(field: dataclasses.Field[Any], value: Any) -> list[str]:
    flag = field.metadata["flag"]
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag.lstrip('-')}"]
    text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
    named = field.metadata["choices"] is not None or field.name == "refine"
    return [flag, text.replace("_", "-") if named else text]
