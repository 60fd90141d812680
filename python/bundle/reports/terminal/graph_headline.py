"""Headline of a refined pose graph: chi2 before and after, closures, certificate.

"Before" is the graph as given. If the solve began at other poses, which it composed from the edges,
a sentence has their chi2. chi2 per degree of freedom is about 1 if the information matrices of the
edges state their errors.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np

from bundle.analysis.diagnosis.chi2_kinds import (
    LEAST_DEGREES,
    WORTH_MENTION,
    Chi2Kind,
    chi2_kinds,
    information_sentence,
)
from bundle.base.words import number, plural, rounded
from bundle.graphs.pose_graphs.pose_graph_result import (
    CERTIFIED,
    CHORDAL_MINIMUM,
    ESCAPES,
    NOT_CERTIFIED,
    STAIRCASE,
    Certificate,
    PoseGraphResult,
    Staircase,
)
from bundle.interface.finding import Finding
from bundle.interface.summary import short_outcome
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.sections import Column, Section, fields


def degrees_of_freedom(graph: PoseGraph) -> int:
    """Return the number of measurements in addition to those that determine the poses."""
    return graph.tangent_size * (graph.num_edges - graph.num_poses + graph.num_components)


def graph_headline(solved: PoseGraphResult) -> list[str]:
    """Return the sentences of a result."""
    summary, graph = solved.summary, solved.initial_problem
    if not summary.is_solution_usable and not summary.interrupted:
        return [solved.outcome, "There is no usable solution."]
    done = short_outcome(summary, plural(solved.num_steps, "step"))
    edges = plural(graph.num_edges - len(solved.left_out), "edge", grouped=True)
    all_edges = {0: edges, 1: "the only edge"}.get(graph.num_edges, f"all {edges}")
    all_edges = f"the {edges} kept" if solved.left_out else all_edges
    chi2 = f"chi2 {number(summary.chi2_initial)} -> {number(summary.chi2_final)}"
    return [
        f"{done}: {chi2} on {all_edges}{_per_degree(solved)}.",
        *certificate_sentences(solved),
        *_start(solved),
        *_rejected(solved),
        *_movement(solved),
    ]


def _per_degree(solved: PoseGraphResult) -> str:
    degrees = degrees_of_freedom(solved.initial_problem)
    if degrees <= 0 or solved.options.loss != "trivial" or solved.left_out:
        return ""
    return f", {number(solved.summary.chi2_final / degrees)} per degree of freedom"


def _start(solved: PoseGraphResult) -> list[str]:
    summary = solved.summary
    if summary.init in ("file", *ESCAPES):
        return []
    name = summary.init.replace("_", " ")
    other = "the file has no poses"
    if solved.initial_problem.has_poses:
        other = f"chi2 {number(summary.chi2_initial)} -> {number(summary.chi2_start)}"
    return [f"The solve began at poses composed from the edges ({name}): {other}."]


def _rejected(solved: PoseGraphResult) -> list[str]:
    rejected, left_out = len(solved.rejected), len(solved.left_out)
    if not rejected and not left_out:
        return []
    edges = plural(solved.initial_problem.num_edges, "edge", grouped=True)
    loss = solved.summary.loss.replace("_", "-")
    said = [f"the loss {loss} rejects {rejected:,}"] * bool(rejected)
    said += [f"the test of consistency leaves out {left_out:,}"] * bool(left_out)
    kept = number(float(np.delete(solved.chi2_after, solved.rejected).sum()))
    included = f"; chi2 of the others is {kept}" if rejected and not left_out else ""
    return [f"Of {edges}, {' and '.join(said)}{included}."]


def _movement(solved: PoseGraphResult) -> list[str]:
    graph, last = solved.initial_problem, solved.problem
    if not graph.has_poses:
        return []
    first = slice(0, 2) if graph.dimension == 2 else slice(4, 7)
    moved = np.linalg.norm(last.poses[:, first] - graph.poses[:, first], axis=1)
    center = np.median(last.poses[:, first], axis=0)
    extent = 2 * float(np.median(np.linalg.norm(last.poses[:, first] - center, axis=1)))
    middle, most = float(np.median(moved)), rounded(float(moved.max()))
    share = f"; {rounded(100 * middle / extent)} % of the graph" if extent > 0 else ""
    return [f"Poses moved by {rounded(middle)} (median{share}), at most {most}."]


MOST_FLOPS = 2e10
"""Flops of a factorisation above which chi2 has no expectation by kind: it takes some seconds."""

KINDS = (
    Column("edges", "kind"),
    Column("number", "count"),
    Column("chi2", "chi2", number),
    Column("degrees of freedom", "degrees", number),
    Column("expected (99.9 %)", lambda one: f"{number(one.low)} to {number(one.high)}"),
    Column("information times", lambda one: number(one.scale)),
    Column("", lambda one: one.verdict.replace("-", " ")),
)


def kinds_of(solved: PoseGraphResult) -> tuple[Chi2Kind, ...]:
    """Return chi2 by kind of edge; () without a solution, or if it takes longer than the solve."""
    summary = solved.summary
    if not summary.is_solution_usable or (summary.factor_flops or 0.0) > MOST_FLOPS:
        return ()
    return chi2_kinds(solved)


def about_information(
    path: str, solved: PoseGraphResult, kinds: Sequence[Chi2Kind]
) -> list[Finding]:
    """Return the finding that chi2 contradicts the information; empty if it agrees."""
    sentence = information_sentence(kinds)
    is_large = any(one.verdict == "too-large" for one in kinds)
    last = kinds[-1] if kinds and _per_degree(solved) else None
    if last and last.verdict == "undecided" and last.degrees >= LEAST_DEGREES:
        is_large = last.chi2 > WORTH_MENTION * last.high
        sentence = is_large * (
            "The solve did not reach a minimum, and chi2 is above its expectation (at most "
            f"{number(last.high)}). Some edges are wrong, or more steps are needed."
        )
    command = f"bundle refine {shlex.quote(path)} -o OUTPUT --loss auto" if is_large else ""
    evidence = {"kinds": kinds}
    found = Finding(kind="information", sentence=sentence, command=command, evidence=evidence)
    return [found] if sentence else []


# Certificate in the report of `bundle refine` on a pose graph: sentences, facts and JSON.
#
# The sentences keep two statements apart. The verdict is about the chordal cost F, at the critical
# point next to the solution. The bound of chi2 is about the solution itself.


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
