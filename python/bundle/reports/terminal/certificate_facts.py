"""Certificate in the report of `bundle refine` on a pose graph: sentences, facts and JSON.

The sentences keep two statements apart. The verdict is about the chordal cost F, at the critical
point next to the solution. The bound of chi2 is about the solution itself.
"""

from __future__ import annotations

import math
from typing import Any

from bundle.base.words import number, plural
from bundle.graphs.pose_graphs.pose_graph_result import (
    CERTIFIED,
    CHORDAL_MINIMUM,
    NOT_CERTIFIED,
    STAIRCASE,
    Certificate,
    PoseGraphResult,
    Staircase,
)
from bundle.reports.sections import Section, fields


def certificate_sentences(solved: PoseGraphResult) -> list[str]:
    """Return the verdict and the bound of chi2; empty without a certificate."""
    found = solved.certificate
    if found is None:
        return []
    return [_verdict(found, solved.summary.init), *_bound(solved, found)]


def _verdict(found: Certificate, init: str) -> str:
    stairs = found.staircase
    if init == STAIRCASE and stairs is not None:
        was = "not certified" if found.verdict == NOT_CERTIFIED else "not a minimum"
        return (
            f"The first solution was {was} (eigenvalue {found.min_eigenvalue:.6g}, F "
            f"{number(found.cost)}). A relaxation of rank {stairs.rank} led to this one. "
            f"{_of_staircase(stairs, found)}"
        )
    moved = f"{number(found.initial_cost)} -> {number(found.cost)}"
    if init == CHORDAL_MINIMUM:
        return (
            f"Not certified: the first solution (chi2 {number(found.chi2)}) was not optimal. A "
            f"solve from the minimum of the chordal cost F next to it ({moved}) led to this one."
        )
    if found.verdict == CERTIFIED:
        return _optimal(found.gap, found.cost, found)
    if found.verdict == NOT_CERTIFIED:
        return (
            f"Not certified: eigenvalue {found.min_eigenvalue:.6g}. The chordal cost F is "
            f"{number(found.cost)} here and at least {number(_best_bound(found))} at any poses"
            f"{_without_escape(found)}."
        )
    if not found.is_settled:
        return (
            "No certificate: the poses are not a minimum. Continue the solve "
            "(--max-iterations), then certify."
        )
    return (
        "No certificate: the solve has converged, but the chordal cost F has no minimum here: "
        f"Newton's method moves the poses away from it (F {moved})."
    )


def _optimal(gap: float, cost: float, found: Certificate) -> str:
    limit = "" if found.is_isotropic else " for isotropic weights"
    return (
        f"Certified{limit}: the minimum of the chordal cost here (F {number(cost)}) is globally "
        f"optimal within {number(gap)}."
    )


def _of_staircase(stairs: Staircase, found: Certificate) -> str:
    if stairs.verdict == CERTIFIED:
        return _optimal(stairs.gap, stairs.cost, found)
    least = number(max(stairs.lower_bound, 0.0))
    return f"Not certified: F {number(stairs.cost)}, at least {least} at any poses."


def _best_bound(found: Certificate) -> float:
    of_stairs = found.staircase.lower_bound if found.staircase is not None else 0.0
    return max(found.lower_bound, of_stairs, 0.0)


def _without_escape(found: Certificate) -> str:
    if found.staircase is None:
        return ""
    return f"; a relaxation up to rank {found.staircase.rank} led to no lower chi2"


def _bound(solved: PoseGraphResult, found: Certificate) -> list[str]:
    if not math.isfinite(found.chi2_lower_bound):
        return ["chi2 has no lower bound: the information of an edge is singular."]
    here, least = solved.summary.chi2_final, found.chi2_lower_bound
    if not least > 0:
        return []
    more = 100 * max(here - least, 0.0) / least
    return [
        f"chi2 of any poses is at least {number(least)}, and here {number(here)} "
        f"({number(more)} % more)."
    ]


def certificate_section(solved: PoseGraphResult) -> list[Section]:
    """Return the facts of a certificate."""
    found = solved.certificate
    if found is None:
        return []
    facts = [
        ("certificate", found.verdict),
        ("chordal cost", f"{found.cost:.9g} ({found.initial_cost:.9g} at the first solution)"),
        ("lower bound", f"{found.lower_bound:.9g}"),
        ("gap", f"{found.gap:.3g}"),
        ("eigenvalue", f"{found.min_eigenvalue:.6g}; next {found.eigenvalues[0]:.6g}"),
        ("Newton", plural(found.num_steps, "step")),
    ]
    stairs = found.staircase
    if stairs is not None:
        facts += [
            ("staircase", f"{stairs.verdict} at rank {stairs.rank}"),
            ("", f"F {stairs.cost:.9g}, relaxation {stairs.relaxed_cost:.9g}"),
            ("", f"gap {stairs.gap:.3g}, eigenvalue {stairs.min_eigenvalue:.6g}"),
        ]
    return [Section(facts=facts)]


def certificate_data(found: Certificate | None) -> dict[str, Any]:
    """Return the entry "certificate" of JSON; empty without a certificate."""
    if found is None:
        return {}
    stairs = found.staircase
    data = _fields(found) | {"staircase": None if stairs is None else _fields(stairs)}
    return {"certificate": data}


def _fields(found: Certificate | Staircase) -> dict[str, Any]:
    return {k: v for k, v in fields(found).items() if k != "problem"} | {"gap": found.gap}
