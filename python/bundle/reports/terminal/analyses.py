"""Reports of `bundle check`, `covariance`, `diagnose`, `influence` and `plan`."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnose_graph import NO_MINIMUM
from bundle.analysis.diagnosis.diagnosis_result import Diagnosis
from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.interface.finding import Finding, one_list
from bundle.model.cameras import camera_models
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.reports.sections import Column, Report, Section, Table, fields
from bundle.reports.terminal.inputs import about_input, input_facts

if TYPE_CHECKING:
    from bundle.analysis.uncertainty.influence import Influence
    from bundle.analysis.uncertainty.measurement_plan import Plan, Proposal
    from bundle.analysis.uncertainty.reliability_result import Reliability
    from bundle.checking.gradient_report import GradientReport
    from bundle.graphs.factors.factor_report import FactorCheck

OF_FACTORS = ("ok", "verdict", "num_factors", "num_checked", "findings", "groups", "worst")
"""Properties of a check of factors for programs."""


def checked(
    path: str,
    given: Problem | PoseGraph | None,
    found: GradientReport | FactorCheck,
    options: dict[str, Any],
    wall_time: float,
) -> Report:
    """Return the report on the Jacobians of a problem or a pose graph; None: of Python objects."""
    from bundle.checking import gradient_report  # other reports need none of these
    from bundle.graphs.factors import factor_report

    words: Any = gradient_report
    subject = []
    if isinstance(found, factor_report.FactorCheck):
        words = factor_report
        data = {name: getattr(found, name) for name in OF_FACTORS}
    else:
        subject = gradient_report.subject(found)
        ends = ("low", "high", "count")
        bins = [dict(zip(ends, one, strict=True)) for one in found.histogram]
        data = fields(found) | {"histogram": bins}
        del data["details"]
    is_detail = found.verdict != "wrong"
    return Report(
        command="check",
        input=about_input(path, given),
        headline=[words.outcome(found)],
        sections=[
            Section(text=words.mistakes(found)),
            Section(facts=input_facts(path, given), text=subject, is_detail=True),
            Section(text=words.measurements(found), is_joined=True, is_detail=is_detail),
        ],
        data={"options": options, **data, "wall_time": {"total": wall_time}},
    )


# Report of `bundle covariance` on a reconstruction or on a pose graph.
#
# It contains only sigmas; the command writes the matrices to a file.

MOST_CAMERAS = 10  # number of listed cameras


def uncertainties(
    path: str,
    given: Problem | PoseGraph,
    cov: Covariance,
    options: Mapping[str, Any],
    target: str,
    wall_time: float,
) -> Report:
    """Return the report on a reconstruction or a pose graph; ``target`` has the matrices."""
    pose = _sigmas(cov.pose_covariance)
    cameras: list[Section] = []
    names = ("gauge", "robust", "scale", "sigma0", "dof", "unit", "notes")
    data: dict[str, Any] = {name: getattr(cov, name) for name in names}
    if isinstance(given, Problem):
        unit = f" [{cov.unit}]" * bool(cov.unit)
        spread = [("rotation [rad]", pose[:, :3]), (f"translation{unit}", pose[:, 3:])]
        spread.append((f"point{unit}", _sigmas(cov.point_covariance)))
        gauge, warnings = cov.gauge.replace("_", " "), _null_points(cov)
        cameras = _cameras(given, cov)
        sigmas = zip(cov.camera_ids, _sigmas(cov.camera_covariance), strict=True)
        data["cameras"] = [
            {"id": int(key), "model": given.camera_models[row], "sigma": sigma}
            for row, (key, sigma) in enumerate(sigmas)
        ]
        data["points_without_parallax"] = cov.null_point_ids
    else:
        parts = [pose[:, :2], pose[:, 2:]] if pose.shape[1] == 3 else [pose[:, 3:], pose[:, :3]]
        spread = [*zip(("translation", "rotation [rad]"), parts, strict=True)]
        gauge, warnings = _held(cov), [*cov.notes]
        data["held_pose_ids"] = cov.held_pose_ids
    sigma0 = f"{number(cov.sigma0)} ({plural(cov.dof, 'degree')} of freedom)"
    facts = [("gauge", gauge), ("sigma0", sigma0), ("scale", _scale(cov))]
    pairs = zip(cov.relative_ids, cov.relative_covariance, strict=True)
    return Report(
        command="covariance",
        input=about_input(path, given),
        headline=[
            _sigmas_in_words(spread, cov),
            f"sigma0 {sigma0}; gauge {cov.gauge.replace('_', ' ')}.",
        ],
        warnings=warnings,
        sections=[
            Section(facts=[("output", shown(target))]),
            Section(facts=[*input_facts(path, given), *facts], is_detail=True),
            *_spread(spread),
            *cameras,
        ],
        data={
            "options": dict(options),
            **data,
            "relative": [{"ids": ids, "covariance": values} for ids, values in pairs],
            "output": {"path": target, "format": "npz"},
            "wall_time": {"total": wall_time},
        },
    )


def _held(cov: Covariance) -> str:
    held = {
        "first": f"{plural(len(cov.held_pose_ids or ()), 'pose')} constant, besides fixed ones",
        "inner": "inner constraints (minimum trace)",
        "none": "by fixed poses",
    }
    return f"{cov.gauge}: {held[cov.gauge]}"


def _sigmas_in_words(parts: Sequence[tuple[str, NDArray[np.float64]]], cov: Covariance) -> str:
    said = []
    for name, values in _lengths(parts):
        median, p95 = map(number, np.percentile(values, [50, 95]))
        said.append(f"{name} {median} / {p95}")
    if not said:
        return "No variable is free: there is no standard deviation."
    unit = f", length unit of the {'graph' if cov.is_of_graph else 'model'}" * (not cov.unit)
    return f"Sigma (median / 95th percentile{unit}): {', '.join(said)}."


def _scale(cov: Covariance) -> str:
    if cov.scale != "unit" and cov.robust != "sandwich":
        return "times sigma0"
    if cov.is_of_graph:
        return "the information of the edges"
    if cov.robust == "sandwich":
        return "sandwich, from the scatter of the residuals"
    return "residual sigma of 1 px, or as given"


def _spread(parts: Iterable[tuple[str, NDArray[np.float64]]]) -> list[Section]:
    """Return quantiles of standard deviations; empty if none is known."""
    cells = []
    for name, values in _lengths(parts):
        quantiles = np.percentile(values, [0, 50, 95, 100])
        cells.append((name, f"{len(values)}", *map(number, quantiles)))
    head = ("sigma", "count", "min", "median", "95th pct", "max")
    return [Section(tables=[Table.of(head, cells)], is_detail=True)] if cells else []


def _lengths(
    parts: Iterable[tuple[str, NDArray[np.float64]]],
) -> list[tuple[str, NDArray[np.float64]]]:
    """Return the known standard deviations of each part, as lengths of their vectors."""
    lengths = [(name, np.linalg.norm(sigma, axis=1)) for name, sigma in parts]
    known = [(name, values[np.isfinite(values)]) for name, values in lengths]
    return [(name, values) for name, values in known if len(values)]


def _cameras(problem: Problem, cov: Covariance) -> list[Section]:
    cells = []
    for row in range(min(len(cov.camera_ids), MOST_CAMERAS)):
        model = problem.camera_models[row]
        sigma = _sigmas(cov.camera_covariance[row])
        for j, name in enumerate(camera_models().get(model, ())):
            value = problem.camera_params[row, j]
            shown_sigma = "held" if np.isnan(sigma[j]) else number(float(sigma[j]))
            label = f"{cov.camera_ids[row]} {model}" if j == 0 else ""
            cells.append((label, name, number(float(value)), shown_sigma))
    if not cells:
        return []
    more = len(cov.camera_ids) - MOST_CAMERAS
    table = Table.of(("camera", "parameter", "value", "sigma"), cells, left=2)
    text = [f"and {plural(more, 'camera')} more"] if more > 0 else []
    return [Section(tables=[table], text=text, is_detail=True)]


def _null_points(cov: Covariance) -> list[str]:
    sentences = list(cov.notes)
    null = cov.null_point_ids
    if len(null):
        ids = ", ".join(map(str, null[:8])) + (", ..." if len(null) > 8 else "")
        sentences.append(
            f"{plural(len(null), 'point')} without parallax: the unobservable direction is "
            f"left out (ids {ids})."
        )
    return sentences


def _sigmas(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    return np.sqrt(np.maximum(variances, 0))  # NaN stays NaN


MOST_EIGENVALUES = 4
MOST_EDGES = 10  # number of suspicious edges shown

SUSPICIOUS = (
    Column("suspicious edges", lambda one: f"{one.edge[0]} {one.edge[1]}"),
    Column("line", lambda one: one.line or "-"),
    Column("chi2", "chi2", number),
    Column("test", "test", number),
    Column("degrees of freedom", "degrees"),
)


def diagnosed(
    path: str,
    given: Problem | PoseGraph,
    diagnosis: Diagnosis,
    options: Mapping[str, Any],
    wall_time: float,
    found: Sequence[Finding] = (),
) -> Report:
    """Return the report on a reconstruction or a pose graph, with further findings about it."""
    rows, reliability = diagnosis.suspicious_edges[:MOST_EDGES], diagnosis.reliability
    facts = [
        *input_facts(path, given, rigs=True),
        ("rank", diagnosis.verdict),
        ("eigenvalues", _eigenvalues(diagnosis)),
        ("pieces", _pieces(diagnosis)),
    ]
    problems = [entry for entry in diagnosis.findings if entry.is_problem]
    notes = [entry.sentence for entry in diagnosis.findings if not entry.is_problem]
    return Report(
        command="diagnose",
        title=f"Diagnosis of {path}",
        input=about_input(path, given),
        headline=[*_headline(diagnosis), *(reliability.sentences if reliability else ())],
        findings=one_list(problems, reliability.findings if reliability else (), found),
        sections=[
            *([] if reliability is None else _unnoticed(given, reliability)),
            Section(facts=facts, is_detail=True),
            Section(tables=[_condition(diagnosis)], is_detail=True),
            *([Section(tables=[Table(SUSPICIOUS, rows)])] if rows else []),
            *([Section(notes=notes, is_detail=True)] if notes else []),
        ],
        data={
            "options": dict(options),
            "ok": diagnosis.ok,
            **fields(diagnosis),
            "reliability": None if reliability is None else reliability.entries,
            "rank_gap": diagnosis.rank_gap,
            "findings": one_list(diagnosis.findings, found),
            "digits": {
                "normal_equations": diagnosis.digits_normal_equations,
                "square_root": diagnosis.digits_square_root,
            },
            "wall_time": {"total": wall_time},
        },
    )


MOST_ROWS = 20  # number of rows of a table of reliability

_PERCENT = "{:.0%}".format


def _unnoticed(given: Any, found: Reliability) -> list[Section]:
    """Return the tables of minimal detectable errors and of redundancies."""
    from bundle.figures.residual_figures import redundancy_figure  # with --reliability only

    names = {
        int(key): shown(name) or str(key)
        for key, name in zip(given.image_ids, given.image_names, strict=True)
    }
    worst = (
        Column("error in", lambda one: names.get(one.image_id, "-")),
        Column("of point", "point_id"),
        Column("unnoticed [px]", "minimal_detectable_error", number),
        Column("redundancy", "least_redundancy", "{:.3f}".format),
        Column("bound [sigmas]", "external_bound", number),
        Column("moves point [sigmas]", lambda one: _moved(one, "point")),
        Column("moves image [sigmas]", lambda one: _moved(one, "image")),
    )
    images = (
        Column("image", lambda one: names.get(one.image_id, "-")),
        Column("observations", "num_observations"),
        Column("redundancy", "share", _PERCENT),
    )
    priors = (
        Column("prior", "name"),
        Column("kind", "kind"),
        Column("redundancy", lambda one: f"{one.redundancy:.2f} of {one.num_residuals}"),
        Column("least", "least_redundancy", "{:.3f}".format),
        Column("test (chi2)", "test", number),
        Column("degrees of freedom", "degrees"),
    )
    tables = [Table(worst, found.worst), Table(images, found.images[:MOST_ROWS])]
    if found.priors:
        tables.append(Table(priors, found.priors[:MOST_ROWS]))
    drawn = [redundancy_figure(given, found.redundancy)]
    return [
        Section(figures=drawn, is_page_only=True),
        Section(title="Errors that would go unnoticed", tables=tables, is_detail=True),
        *([Section(notes=found.notes)] if found.notes else []),
    ]


def influenced(
    path: str, given: Problem, found: Influence, options: Mapping[str, Any], wall_time: float
) -> Report:
    """Return the report on what a quantity of a reconstruction depends on."""
    columns = (
        Column("without", "what"),
        Column("share of variance", "share", "{:.1%}".format),
        Column(f"value [{found.unit or 'model units'}]", "value", number),
        Column("change [sigmas]", "sigmas", "{:+.2g}".format),
    )
    return Report(
        command="influence",
        input=about_input(path, given),
        headline=list(found.sentences),
        warnings=found.notes,
        sections=[Section(tables=[Table(columns, found.changes)], is_detail=True)],
        data={"options": dict(options), **found.entries, "wall_time": {"total": wall_time}},
    )


def planned(
    path: str, given: Problem, found: Plan, options: Mapping[str, Any], flags: str, wall_time: float
) -> Report:
    """Return the report on what to measure next; ``flags``: those of the next solve."""
    columns = (
        Column("add", "kind"),
        Column("", "what"),
        Column(f"sigma [{found.unit or 'model units'}] before", "sigma_before", number),
        Column("after", "sigma_after", number),
    )
    headline = list(found.sentences)
    for place, one in enumerate(found.proposals, 1):
        if one.then and one.is_shown:
            said = f"{headline[place].rstrip('.')}; write its lines (--verbose), then "
            headline[place] = said + _use(one, path, flags)
    steps = {one.what: one.lines for one in (*found.proposals, *found.together)}
    facts = [(what, "\n".join(lines)) for what, lines in steps.items() if lines]
    return Report(
        command="plan",
        input=about_input(path, given),
        headline=headline,
        warnings=found.notes,
        sections=[
            Section(tables=[Table(columns, found.together)], is_detail=True),
            Section(title="To write down", facts=facts, is_detail=True),
        ],
        data={"options": dict(options), **fields(found), "wall_time": {"total": wall_time}},
    )


def _use(one: Proposal, path: str, flags: str) -> str:
    """Return the command that uses a proposal once it is measured, with the flags of the run."""
    more = [flag for flag in one.then if flag.split()[0] not in flags.split()]
    return " ".join(
        [shlex.join(["bundle", "refine", path, "-o", "measured"]), *more, flags]
    ).strip()


def _moved(one: Any, what: str) -> str:
    key, sigmas = getattr(one, f"moved_{what}_id"), getattr(one, f"moved_{what}_sigmas")
    return "-" if key is None else f"{key} by {number(sigmas)}"


def _condition(diagnosis: Diagnosis) -> Table:
    digits = (str(diagnosis.digits_normal_equations), str(diagnosis.digits_square_root))
    title, unscaled = "reduced camera system", "as it is"
    if diagnosis.noun == "pose":
        title, unscaled = "normal equations", "as they are"
    return Table.of(
        (title, "condition number", "digits: normal equations", "digits: QR"),
        [
            (unscaled, number(diagnosis.condition_number_unscaled), "", ""),
            ("scaled", number(diagnosis.condition_number), *digits),
        ],
    )


def _headline(diagnosis: Diagnosis) -> list[str]:
    verdict = diagnosis.verdict.rstrip(".")
    held = diagnosis.held_words if np.isfinite(diagnosis.condition_number) else ""
    condition = f"Condition number {number(diagnosis.condition_number)} (scaled{held})"
    found = "; no problem found" if diagnosis.ok else ""
    if any(one.kind == NO_MINIMUM for one in diagnosis.findings):
        found = "; not at a minimum, where alone wrong edges show: refine first, or give its --loss"
    return [f"{verdict[0].upper()}{verdict[1:]}.", f"{condition}; {_pieces(diagnosis)}{found}."]


def _eigenvalues(diagnosis: Diagnosis) -> str:
    if not len(diagnosis.eigenvalues):
        return "-"
    if diagnosis.noun == "pose":
        lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues)
        return f"{lowest}, ... (scaled normal equations)"
    lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues[:MOST_EIGENVALUES])
    null = f"zeros up to {diagnosis.max_null_eigenvalue:.1g}, then " if diagnosis.nullity else ""
    return f"{null}{lowest}, ... (scaled reduced camera system)"


def _pieces(diagnosis: Diagnosis) -> str:
    sizes = [part.size for part in diagnosis.components]
    listed = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
    members = diagnosis.noun if sizes == [1] else f"{diagnosis.noun}s"
    return f"{plural(len(sizes), 'connected component')} ({listed} {members})" if sizes else "none"
