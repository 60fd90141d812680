"""Shape of the reports that a triage reads: which entries they have, and of which kind.

A shape is one of the kinds below; a list with the shape of its items; or a table with shapes by
name. A name with a final "?" is optional, "*" is any other name, and ``Maybe`` allows null.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bundle.base.records import dataclass
from bundle.errors import InputError, brief

NUMBER, TEXT, FLAG, ANY = "a number", "a string", "true or false", "any value"
KINDS: Mapping[str, Any] = {NUMBER: int | float, TEXT: str, FLAG: bool, ANY: object}


@dataclass(frozen=True)
class Maybe:
    """A shape, or null."""

    shape: Any


MAYBE_NUMBER = Maybe(NUMBER)

ITERATIONS = [
    {
        **{"step_is_successful": FLAG, "trust_region_radius?": MAYBE_NUMBER},
        "gradient_max_norm?": MAYBE_NUMBER,
    }
]

SUMMARY = {
    **{"initial_cost": MAYBE_NUMBER, "final_cost": MAYBE_NUMBER},
    **{"termination_type": TEXT, "is_solution_usable": FLAG, "warning_kinds": [TEXT]},
    **{"num_successful_steps": NUMBER, "num_unsuccessful_steps": NUMBER},
    **{"num_threads_used": NUMBER, "total_time_in_seconds": NUMBER},
    **{"backend_used": TEXT, "linear_solver_type_used": TEXT, "factor_ordering?": Maybe(TEXT)},
    **{"num_parameters_reduced?": MAYBE_NUMBER, "num_residuals_reduced?": MAYBE_NUMBER},
    **{"num_information_nonzeros?": MAYBE_NUMBER, "num_reduced_nonzeros?": MAYBE_NUMBER},
    **{"num_factor_nonzeros?": MAYBE_NUMBER, "factor_flops?": MAYBE_NUMBER},
    "least_factor_flops?": MAYBE_NUMBER,
}

INPUT = {
    **{"path": Maybe(TEXT), "format": TEXT, "digests?": Maybe({"*": TEXT})},
    **{f"num_{name}?": MAYBE_NUMBER for name in ("poses", "edges", "images", "points")},
    "duration?": MAYBE_NUMBER,
}

COMMON = {
    "options": {"*": ANY},
    "environment?": Maybe(
        {
            **{"cpu_model?": Maybe(TEXT), "versions?": Maybe({"*": Maybe(TEXT)})},
            **{"num_cores?": MAYBE_NUMBER, "load_before?": MAYBE_NUMBER},
            **{"waiting?": MAYBE_NUMBER, "preemptions?": MAYBE_NUMBER},
        }
    ),
    "structure?": Maybe({"densest?": MAYBE_NUMBER}),
}

KEYFRAME = {
    **dict.fromkeys(("num_rows", "num_iterations", "num_rejected", "num_rejected_tracks"), NUMBER),
    **{"costs": {"*": NUMBER}, "alarms": [TEXT], "out_of_time": FLAG},
    **{"nullity": MAYBE_NUMBER, "expected_nullity": NUMBER, "least_radius?": MAYBE_NUMBER},
    **{f"num_{name}?": MAYBE_NUMBER for name in ("columns", "prior_columns")},
    **{f"num_{name}_nonzeros?": MAYBE_NUMBER for name in ("information", "reduced", "factor")},
}

SHAPES = {
    "refine": {"input": INPUT, "summary": SUMMARY, "iterations": ITERATIONS, **COMMON},
    "vio": {
        **{"input": INPUT, "summary": {"is_solution_usable": FLAG}, "keyframes": [KEYFRAME]},
        **{"wall_time": {"solve": NUMBER}, "error": Maybe({"ate": MAYBE_NUMBER})},
        **COMMON,
    },
    "compare": {
        "input": INPUT,
        "runs": [
            {
                **{"name": TEXT, "backend": TEXT, "trust_region_strategy_type": TEXT},
                **{"ordering": TEXT, "num_threads": NUMBER, "time_in_seconds": MAYBE_NUMBER},
                **{"summary": Maybe(SUMMARY), "iterations": Maybe(ITERATIONS)},
            }
        ],
        **COMMON,
    },
    "compare models": {
        "inputs": [INPUT],
        "runs": [
            {
                **{"input": NUMBER, "method": {"num_threads": NUMBER, "*": TEXT}},
                "total_time_in_seconds": MAYBE_NUMBER,
                "measurements": [{"summary": SUMMARY, "iterations": ITERATIONS}],
            }
        ],
        **COMMON,
    },
}


def shape_of(report: Mapping[str, Any]) -> Any:
    """Return the shape of a report of a known command."""
    has_models = report["command"] == "compare" and "inputs" in report
    return SHAPES["compare models" if has_models else report["command"]]


def check_shape(value: Any, shape: Any, place: str, name: str = "") -> None:
    """Refuse a value that lacks entries of its shape.

    Args:
        value: contents of a JSON file.
        shape: expected shape.
        place: name of the file.
        name: names of the entries that lead to the value, such as "summary.final_cost".

    Raises:
        InputError: an entry is missing or of another kind; the message names it.
    """
    if isinstance(shape, Maybe):
        if value is not None:
            check_shape(value, shape.shape, place, name)
    elif isinstance(shape, list):
        _expect(isinstance(value, list), "a list", value, place, name)
        for k, item in enumerate(value):
            check_shape(item, shape[0], place, f"{name}[{k}]")
    elif isinstance(shape, dict):
        _expect(isinstance(value, dict), "a table", value, place, name)
        _check_table(value, shape, place, f"{name}." if name else "")
    else:
        is_kind = isinstance(value, KINDS[shape])
        if shape == NUMBER:
            is_kind = is_kind and not isinstance(value, bool)
        _expect(is_kind, shape, value, place, name)


def _check_table(value: Mapping[str, Any], shape: Any, place: str, parent: str) -> None:
    known = set()
    for entry, part in shape.items():
        key = entry.removesuffix("?")
        known.add(key)
        if key in value:
            check_shape(value[key], part, place, parent + key)
        elif entry == key != "*":
            raise InputError(f"{place}: expected an entry {brief(parent + key)}, it is missing")
    for key in value.keys() - known if "*" in shape else ():
        check_shape(value[key], shape["*"], place, parent + key)


def _expect(is_kind: bool, kind: str, value: Any, place: str, name: str) -> None:
    if not is_kind:
        raise InputError(f"{place}: {name}: expected {kind}, found {brief(value)}")
