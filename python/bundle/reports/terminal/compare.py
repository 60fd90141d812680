"""Report of `bundle compare`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bundle.base.words import contents, format_name, format_size, number, plural, seconds
from bundle.errors import shown
from bundle.interface.summary import share
from bundle.planning.comparison.comparison_result import GAPS, ComparedProblem, Comparison
from bundle.planning.comparison.measured_run import Measurement, Method, Prediction, Run
from bundle.reports.sections import Column, Report, Section, Table, fields, records
from bundle.reports.terminal.compare_verdict import doubted, findings, headline, sigmas
from bundle.reports.terminal.solve_data import solve_options

if TYPE_CHECKING:
    from bundle.figures.marks import Figure

Pair = tuple[Run, Measurement]

LEGEND = (
    "gap: final cost / best cost - 1; spread: (slowest - fastest) / median of the repeats; sigmas: "
    "distance from the solution of the best cost; MB: peak memory of the process"
)
POINTS = "points: number of points at other positions, which the distance ignores"
DETAILS = (
    "to: seconds until within that gap; cpu/wall: CPU time of all threads / wall time; load: "
    "average of the last minute"
)
PROFILES = (
    "The share of problems that a method solves within a factor of the fastest on each (Dolan and "
    "Moré 2002): the higher and the further left, the better."
)
PREDICTED_LEGEND = "nnz(L): lower triangle with the diagonal; MB: beyond the loaded problem"


def compared(comparison: Comparison) -> Report:
    """Return the report on a comparison.

    In its data, summaries and iterations have the format of `bundle refine`; ``input`` of a run is
    an index into ``inputs``, from 0. Costs are 1/2 sum rho(||r||^2), r in pixels; unknown numbers
    are None.
    """
    count = len(comparison.problems)
    name = comparison.problems[0].name if count == 1 else f"{count} problems"
    sections = [_conditions(comparison)]
    for index, problem in enumerate(comparison.problems):
        sections += _problem(comparison, index, problem)
    if comparison.profiles:
        sections += _profiles(comparison)
    return Report(
        command="compare",
        title=f"Solvers compared: {name}",
        headline=headline(comparison),
        findings=findings(comparison),
        sections=[*sections, *_recommendation(comparison), _environment(comparison)],
        data=comparison_data(comparison),
    )


def _conditions(comparison: Comparison) -> Section:
    most = max((len(run.measurements) for run in comparison.runs), default=0)
    cap = comparison.memory_cap_in_bytes
    words = [
        f"median of {most} runs" if most > 1 else "one run each",
        f"at most {comparison.timeout:g} s",
    ]
    if cap:
        words.append(f"at most {format_size(cap)} beyond the loaded problem")
    took = f"{seconds(comparison.wall_time_in_seconds)} s"
    facts = [("each method", ", ".join(words)), ("all of it took", took)]
    if comparison.perturb:
        facts.append(("start", f"perturbed by {comparison.perturb:g}, seed {comparison.seed}"))
    return Section(facts=facts)


def _environment(comparison: Comparison) -> Section:
    here = comparison.environment
    versions = ", ".join(f"{name} {version}" for name, version in here.versions.items() if version)
    load = f"{here.load_before:.1f} before, {here.load_after:.1f} after"
    return Section(
        facts=[
            ("measured", here.date),
            ("processor", f"{here.cpu_model}, {plural(here.num_cores, 'core')}"),
            ("load", load),
            ("versions", versions),
        ],
        title="Machine",
        is_detail=True,
    )


def _problem(comparison: Comparison, index: int, problem: ComparedProblem) -> list[Section]:
    """Return the tables of one input; runs without a result are below the first table."""
    runs = comparison.runs_of(index)
    names = _Names(comparison)
    facts = [
        ("input", f"{shown(problem.name)} ({format_name(problem.format)})"),
        ("", contents(problem)),
        ("best cost", _cost(comparison.best_cost(index))),
    ]
    usable = [(run, run.measurement) for run in runs if run.is_usable]
    measured = [(run, one) for run, one in usable if one is not None]
    told = [
        f"{names.words(run.method)}: {run.message or run.outcome}"
        for run in runs
        if not run.is_usable
    ]
    several = len(comparison.minima(index)) > 1
    columns = _result_columns(comparison, names, several)
    legend = f"{LEGEND}; {POINTS}" if any(c.title == "points" for c in columns) else LEGEND
    chosen = comparison.recommendation
    methods = [run.method for run, _ in measured]
    best = methods.index(chosen.method) if chosen and chosen.method in methods else None
    results = Table(columns, measured, legend=legend, best=best)
    times = Table(_time_columns(comparison, names), measured, legend=DETAILS)
    shares = Table([*names.columns("share of the time"), *SHARES], measured)
    predicted = [run for run in runs if run.prediction is not None]
    predictions = Table(
        [*names.columns("predicted, measured"), *PREDICTED], predicted, legend=PREDICTED_LEGEND
    )
    return [
        Section(title=f"Input {index + 1}: {shown(problem.name)}", facts=facts),
        *([Section(tables=[results])] if measured else []),
        Section(figures=lambda: _figures(comparison, index), is_page_only=True),
        *([Section(tables=[_minima(comparison, index, names)])] if several else []),
        *([Section(notes=told, is_warning=True)] if told else []),
        *([Section(title="Times", tables=[times], is_detail=True)] if measured else []),
        *([Section(title="Shares", tables=[shares], is_detail=True)] if measured else []),
        *(
            [Section(title="Predictions", tables=[predictions], is_detail=True)]
            if predicted
            else []
        ),
        *_warnings(measured, names),
    ]


def _figures(comparison: Comparison, index: int) -> list[Figure]:
    from bundle.figures.cost_figures import breakdown_figure, time_figure  # for pages only

    is_measured = any(run.is_usable for run in comparison.runs_of(index))
    shares = [breakdown_figure(comparison, index)] if is_measured else []
    return [time_figure(comparison, index, outcomes=True), *shares]


def _result_columns(comparison: Comparison, names: _Names, several: bool) -> list[Column]:
    minimum = Column("minimum", lambda pair: _ordinal(pair[0]))
    points = Column("points", lambda pair: pair[0].num_points_elsewhere)
    elsewhere = any(run.num_points_elsewhere for run in comparison.runs if run.is_usable)
    return [
        *names.columns("method"),
        Column("cost", lambda pair: pair[0].final_cost, "{:#.7g}".format, is_page_only=True),
        Column(
            "gap",
            lambda pair: comparison.gap(pair[0]),
            lambda gap: f"{gap:.0e}" if gap > 0 else "0",
        ),
        Column("sigmas", lambda pair: pair[0].distance_in_sigmas, sigmas),
        *([points] if elsewhere else []),
        *([minimum] if several else []),
        Column("steps", lambda pair: pair[1].num_steps),
        Column("total [s]", lambda pair: pair[1].total_time_in_seconds, seconds),
        Column("spread", lambda pair: _spread(pair[0])),
        Column("MB", lambda pair: pair[0].peak_memory_in_bytes / 1e6, number),
    ]


def _time_columns(comparison: Comparison, names: _Names) -> list[Column]:
    def time_to(gap: float) -> Column:
        title = f"to {gap:.0e}".replace("e-0", "e-")
        return Column(title, lambda pair: comparison.time_to_gap(pair[0], gap), seconds)

    return [
        *names.columns("seconds"),
        Column("s/step", lambda pair: pair[1].time_per_step_in_seconds, number),
        *map(time_to, GAPS),
        Column("cpu/wall", lambda pair: pair[1].cpu_per_wall, _ratio),
        Column("load", lambda pair: pair[1].load, _ratio),
    ]


def _minima(comparison: Comparison, index: int, names: _Names) -> Table:

    def fastest(runs: Sequence[Run]) -> Run:
        return min(runs, key=lambda run: run.total_time_in_seconds)

    columns = [
        Column("minimum", lambda runs: _ordinal(runs[0])),
        Column("fastest method", lambda runs: names.words(fastest(runs).method)),
        Column("total [s]", lambda runs: seconds(fastest(runs).total_time_in_seconds)),
        Column("methods", len),
        Column("cost", lambda runs: _cost(min(run.final_cost for run in runs))),
        Column("sigmas", lambda runs: sigmas(min(run.distance_in_sigmas for run in runs))),
    ]
    return Table(columns, comparison.minima(index), left=2)


def _ordinal(run: Run) -> str:
    """Return the number of a run's minimum, from 1; "-" if it is unknown."""
    return str(run.minimum + 1) if run.minimum >= 0 else "-"


def _spread(run: Run) -> str:
    spread = run.spread
    return "-" if spread is None or spread.num_repeats < 2 else f"{100 * spread.relative:.0f} %"


def _ratio(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"


def _share(phase: str) -> Column:
    return Column(
        phase, lambda pair: share(pair[1].breakdown[phase], pair[1].total_time_in_seconds)
    )


def _count(value: float) -> str:
    return number(value) if value else "-"


def _measured_step(run: Run) -> str:
    return number(run.measurement.time_per_step_in_seconds) if run.measurement else "-"


def _added(run: Run) -> float:
    added = run.measurement.added_memory_in_bytes if run.measurement else -1
    return added / 1e6 if added >= 0 else math.nan


def _note(before: Prediction) -> str:
    return before.note or ("" if before.fits_in_memory else "does not fit in memory")


SHARES = tuple(map(_share, ("residuals", "Jacobians", "linear solver", "rest")))
PREDICTED = (
    Column("ordering", "prediction.ordering", is_page_only=True),
    Column("unknowns", "prediction.num_unknowns", _count, is_page_only=True),
    Column("nnz(S)", "prediction.nnz_reduced", _count, is_page_only=True),
    Column("nnz(L)", "prediction.nnz_factor", _count),
    Column("flops", "prediction.flops", _count),
    Column("s/step", "prediction.time_per_step_in_seconds", number),
    Column("measured", _measured_step),
    Column("MB", lambda run: run.prediction.memory_in_bytes / 1e6, number),
    Column("measured", _added, number),
    Column("note", "prediction", _note, is_page_only=True),
)


def _warnings(measured: Sequence[Pair], names: _Names) -> list[Section]:
    """Return warnings and replaced solvers; each sentence once."""
    said: dict[str, list[str]] = {}
    for run, measurement in measured:
        for sentence in (*_taken(run, measurement), *measurement.summary.warnings):
            said.setdefault(sentence, []).append(names.words(run.method))
    if not said:
        return []
    lines = [
        sentence if len(sayers) == len(measured) else f"{', '.join(sayers)}: {sentence}"
        for sentence, sayers in said.items()
    ]
    return [Section(notes=lines, is_warning=True)]


def _taken(run: Run, measurement: Measurement) -> list[str]:
    summary = measurement.summary
    taken = (summary.backend_used.lower(), summary.linear_solver_type_used)
    if taken == (run.method.backend, run.method.linear_solver_type.upper()):
        return []
    return [f"used {' '.join(taken)}."]


def _profiles(comparison: Comparison) -> list[Section]:
    names = _Names(comparison)
    tables = []
    for gap in GAPS:
        profiles = [profile for profile in comparison.profiles if profile.gap == gap]
        solved = plural(profiles[0].num_problems, "problem")
        title = f"{solved} solved to {gap:.0e} within".replace("e-0", "e-")
        tables.append(Table([*names.columns(title), *FACTORS], profiles))

    def figures() -> list[Figure]:
        from bundle.figures.cost_figures import profile_figure  # for pages only

        return [profile_figure(comparison, gap) for gap in GAPS]

    drawn = Section(
        title="Performance profiles", text=[PROFILES], figures=figures, is_page_only=True
    )
    return [*(Section(tables=[table]) for table in tables), drawn]


def _within(title: str, factor: float) -> Column:
    return Column(title, lambda profile: f"{100 * profile.share(factor):.0f} %")


FACTORS = (
    _within("fastest", 1.0),
    *(_within(f"{factor:g} times", factor) for factor in (1.5, 2.0, 5.0, 10.0)),
    _within("ever", math.inf),
)


def _recommendation(comparison: Comparison) -> list[Section]:
    found = comparison.recommendation
    if found is None:
        return []
    single = len(comparison.problems) == 1  # with several, the reason is the headline
    reason = [("reason", found.reason)] if single else []
    verdict = [("prediction", found.verdict)] if found.verdict else []
    command = "" if doubted(comparison) else found.command
    return [Section(facts=[*reason, *verdict]), *([Section(command=command)] if command else [])]


class _Names:
    """Names of methods, with thread counts if the methods differ in them."""

    def __init__(self, comparison: Comparison) -> None:
        self._with_threads = len({method.num_threads for method in comparison.methods}) > 1

    def columns(self, title: str) -> list[Column]:
        """Return the columns about a method; a row has a run and its measurement."""
        names = [Column(title, lambda row: _method_of(row).name)]
        threads = [Column("threads", lambda row: _method_of(row).num_threads)]
        return names + (threads if self._with_threads else [])

    def words(self, method: Method) -> str:
        """Return the name of a method for use within a sentence."""
        return f"{method.name}, {method.threads}" if self._with_threads else method.name


def _method_of(row: Any) -> Method:
    found: Method = row[0].method if isinstance(row, tuple) else row.method
    return found


def _cost(value: float) -> str:
    return f"{value:.10g}" if math.isfinite(value) else "-"


OF_COMPARISON = (
    *("environment", "perturb", "seed", "repeat", "memory_cap_in_bytes", "interrupted"),
)
OF_RUN = (
    *("message", "final_cost", "total_time_in_seconds", "spread", "distance_in_sigmas"),
    *("num_points_elsewhere", "prediction"),
)
OF_MEASUREMENT = ("total_time_in_seconds", "time_per_step_in_seconds", "breakdown")
"""Properties for programs."""


def comparison_data(comparison: Comparison) -> dict[str, Any]:
    """Return the data of `--json` in addition to the heading."""
    best, problems = comparison.recommendation, range(len(comparison.problems))
    return {
        "inputs": [_input(problem) for problem in comparison.problems],
        "options": solve_options(comparison.options),
        **{name: getattr(comparison, name) for name in OF_COMPARISON},
        "timeout_in_seconds": comparison.timeout,
        "best_costs": [comparison.best_cost(index) for index in problems],
        "at_minimum": [comparison.is_at_minimum(index) for index in problems],
        "runs": [_run(comparison, run) for run in comparison.runs],
        "profiles": [fields(one) | {"method": _method(one.method)} for one in comparison.profiles],
        "recommendation": best
        and {
            **{name: getattr(best, name) for name in ("reason", "command", "verdict")},
            "method": _method(best.method),
            "foreseen": [one and _method(one) for one in best.foreseen],
        },
        "wall_time": {"total": comparison.wall_time_in_seconds},
    }


def _input(problem: ComparedProblem) -> dict[str, Any]:
    counts = fields(problem)
    is_file, name = counts.pop("is_file"), counts.pop("name")
    return {"path": name if is_file else None, **counts}


def _method(method: Method) -> dict[str, Any]:
    return {
        name: value.upper() if isinstance(value, str) else value
        for name, value in fields(method).items()
    }


def _run(comparison: Comparison, run: Run) -> dict[str, Any]:
    times = [(gap, comparison.time_to_gap(run, gap)) for gap in GAPS]
    return {
        "input": run.problem,
        "method": _method(run.method),
        "outcome": run.outcome.upper(),
        **{name: getattr(run, name) for name in OF_RUN},
        "gap": comparison.gap(run),
        "time_to_gap": [{"gap": gap, "time_in_seconds": time} for gap, time in times],
        "minimum": run.minimum if run.minimum >= 0 else None,
        "peak_memory_in_bytes": run.peak_memory_in_bytes or None,
        "measurements": [_measurement(one) for one in run.measurements],
        "unfinished": run.unfinished and records(run.unfinished),
    }


def _measurement(measurement: Measurement) -> dict[str, Any]:
    added = measurement.added_memory_in_bytes
    return {
        **fields(measurement),
        **{name: getattr(measurement, name) for name in OF_MEASUREMENT},
        "added_memory_in_bytes": added if added >= 0 else None,
        "iterations": records(measurement.iterations),
    }
