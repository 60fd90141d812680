"""Report parts that several kinds of input share: options, times, rules, loops, processes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from bundle.base.own_process import Waiting
from bundle.base.records import dataclass
from bundle.base.words import change, few, format_size, number, pixels, plural, seconds
from bundle.errors import shown
from bundle.interface.environment import Environment
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.summary import ProcessPart, ProcessRecord, Summary, share, solver_phases
from bundle.reports.sections import Column, Section, Table, fields, records
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.solving.constraints.ends import PriorEnd, RuleEnd, TieEnd

_full = "{:.9e}".format

ROUNDS = (
    Column("round", "round"),
    Column("cost before", "initial_cost", _full),
    Column("cost after", "cost", _full),
    Column("observations", "num_observations"),
    Column("removed", "num_observations_removed"),
    Column("points", "num_points"),
    Column("removed", "num_points_removed"),
)
TRACKS = (
    Column("round", "round"),
    Column("triangulated", "triangulated"),
    Column("completed", "completed"),
    Column("merged", "merged"),
    Column("deleted", "deleted"),
    Column("observations", "num_observations"),
    Column("points", "num_points"),
    Column("held out [px]", lambda one: pixels(one.held_out_rmse or math.nan)),
)
ERRORS = {
    "rmse": "RMSE [px]",
    "mean": "mean error [px]",
    "median": "median error [px]",
    "p95": "95th percentile [px]",
    "max": "max error [px]",
}


def round_tables(solved: Result) -> list[Table]:
    """Return the tables of the rounds and of their tracks; empty without any."""
    tables = [Table(ROUNDS, solved.rounds)] if solved.rounds else []
    return [*tables, Table(TRACKS, solved.tracks)] if solved.tracks else tables


def before_and_after(solved: Result) -> Table:
    """Return the table of costs, errors and counts before and after a solve."""
    before, after = solved.reprojection_error_before, solved.reprojection_error_after
    rows = [
        *(
            [("cost", f"{solved.summary.initial_cost:.9e}", f"{solved.summary.final_cost:.9e}")]
            if not solved.rounds  # costs of different rounds are not comparable
            else []
        ),
        *([("held cost", "-", f"{held:.9e}")] if (held := solved.summary.held_cost) else []),
        *(
            (title, pixels(getattr(before, name)), pixels(getattr(after, name)))
            for name, title in ERRORS.items()
        ),
        ("observations", str(before.num_observations), str(after.num_observations)),
        ("behind camera", str(before.num_behind_camera), str(after.num_behind_camera)),
    ]
    return Table.of(("", "before", "after"), rows)


def result_data(solved: Result) -> dict[str, Any]:
    """Return options, summary, iterations and reprojection errors of a solve."""
    return {
        "options": solve_options(solved.options),
        "summary": solved.summary,
        "iterations": records(solved.iterations),
        "reprojection_error": {
            "before": solved.reprojection_error_before,
            "after": solved.reprojection_error_after,
            "kept": solved.kept,
        },
    }


def solve_options(options: SolveOptions | PoseGraphOptions) -> dict[str, Any]:
    """Return all options by name, enumerations in upper case."""
    values = options.asdict()
    for field in dataclasses.fields(options):
        if field.metadata["choices"] is not None:
            values[field.name] = values[field.name].upper()
    return values


def factor_fact(summary: Summary) -> list[tuple[str, str]]:
    """Return the size and cost of the factor; empty without a factorisation."""
    if summary.num_factor_nonzeros is None:
        return []
    words = (
        f"{plural(summary.num_factor_columns or 0, 'column')}, {summary.factor_ordering} order, "
        f"{number(summary.num_factor_nonzeros)} nonzeros, "
        f"{number(summary.factor_flops or 0.0)} flops, analysed in "
        f"{seconds(summary.symbolic_time_in_seconds or 0.0)} s"
    )
    return [("factor", words)]


@dataclass(frozen=True, kw_only=True)
class WallTime:
    """Wall-clock seconds of a command by stage; ``total`` includes time outside all stages.

    ``statistics`` is the time for reprojection errors before and after, if a command computes them.
    """

    load: float
    build: float
    solve: float
    save: float = 0.0
    statistics: float = 0.0
    total: float


def environment_data(waiting: Waiting | None) -> dict[str, Any]:
    """Return machine, load and versions at the end of a command, and its waiting for cores."""
    waited = {} if waiting is None else fields(waiting)
    return {**fields(Environment.now().finished()), **waited}


def wall_section(summary: Summary, wall: WallTime) -> Section:
    """Return the stages of a command, including the phases of the solve, with their shares."""
    total, solver = wall.total, summary.total_time_in_seconds
    rows = [_stage("load", wall.load, total), _stage("build", wall.build, total)]
    rows.append(("solve", seconds(wall.solve), "", share(wall.solve, total)))
    rows += [
        (f"  {name}", seconds(time), share(time, solver), share(time, total))
        for name, time in solver_phases(summary)
    ]
    rows.append(_stage("save", wall.save, total))
    if wall.statistics > 0:
        rows.append(_stage("statistics", wall.statistics, total))
    rest = total - wall.load - wall.build - wall.solve - wall.save - wall.statistics
    rows.append(_stage("everything else", max(rest, 0.0), total))
    rows.append(_stage("total", total, total))
    return Section(tables=[Table.of(("time", "seconds", "of the solve", "of all"), rows)])


def _stage(name: str, time: float, total: float) -> tuple[str, str, str, str]:
    return name, seconds(time), "", share(time, total)


MOST_ROWS = 8  # number of listed priors, bounds and ties


BOUNDS = (
    Column("active bound", lambda bound: f"camera {bound.camera_id}"),
    Column("parameter", "parameter"),
    Column("side", "side"),
    Column("at", "value", "{:.7g}".format),
)


def constraint_sections(rules: Sequence[RuleEnd]) -> list[Section]:
    """Return the state of the rules after the solve; empty without rules."""
    held = [shown(rule.rule) for rule in rules if rule.kind == "fixed"]
    more = [f"{plural(len(held) - 3, 'other rule')} as well"] if len(held) > 3 else []
    priors = [prior for rule in rules for prior in rule.priors]
    bounds = [bound for rule in rules for bound in rule.active_bounds]
    ties = dict.fromkeys(tie for rule in rules for tie in rule.ties)
    is_free = any(rule.kind == "bounds" for rule in rules) and not bounds
    strongest = sorted(priors, key=lambda prior: -abs(prior.pull))
    parts = [
        *([Section(facts=[("held", "; ".join(held[:3]))], notes=more)] if held else []),
        *_listed(PRIORS, strongest, 2, "other prior", " pull less"),
        *_listed(BOUNDS, bounds, 3, "other parameter", " on a bound as well"),
        *([Section(facts=[("bounds", "no parameter ends on one")])] if is_free else []),
        *_listed(TIES, list(ties), 1, "other tie", ""),
    ]
    return [replace(part, is_joined=index > 0) for index, part in enumerate(parts)]


def _listed(
    columns: Sequence[Column], rows: Sequence[Any], left: int, noun: str, words: str
) -> list[Section]:
    def others(count: int) -> str:
        return f"{plural(count, noun)}{words}; --json FILE lists all"

    table = Table(columns, rows, left=left, most=MOST_ROWS, others=others)
    return [Section(tables=[table])] if rows else []


def _known(prior: PriorEnd) -> str:
    if prior.parameter == "rotation":
        return "start value"
    return ", ".join(f"{value:.7g}" for value in prior.known)


def _sigma(prior: PriorEnd) -> str:
    if prior.relative:
        return f"{100 * prior.sigma[0]:.3g} %"
    unit = " deg" if prior.parameter == "rotation" else ""
    same = len(set(prior.sigma)) == 1
    return ", ".join(f"{sigma:.3g}" for sigma in (prior.sigma[:1] if same else prior.sigma)) + unit


def _moved(prior: PriorEnd) -> str:
    if prior.parameter == "rotation":
        return f"turned {prior.pull * prior.sigma[0]:.3g} deg"
    if len(prior.known) == 1:
        return f"{prior.after[0]:.7g}"
    return f"off by {math.dist(prior.known, prior.after):.3g}"


def _members(tie: TieEnd) -> str:
    return few(
        f"{name} of camera {camera}"
        for camera, name in zip(tie.camera_ids, tie.parameters, strict=True)
    )


PRIORS = (
    Column("prior", lambda prior: f"{prior.subject} {prior.id}"),
    Column("parameter", "parameter"),
    Column("known", _known),
    Column("sigma", _sigma),
    Column("after", _moved),
    Column(
        "pull [sigmas]",
        lambda prior: f"{prior.pull:+.2f}" if len(prior.known) == 1 else f"{prior.pull:.2f}",
    ),
)
TIES = (
    Column("one number", _members),
    Column("first before", lambda tie: f"{tie.before[0]:.7g}"),
    Column("first after", lambda tie: f"{tie.after[0]:.7g}"),
)


MOST_CLOSURES = 10  # number of closures shown, the rejected ones first


_short = "{:.3g}".format

CLOSURES = (
    Column("closure", lambda one: f"{one.image_ids[0]} {one.image_ids[1]}"),
    Column("", lambda one: "used" if one.used else "rejected"),
    Column("rotation [deg]", "rotation_before", _short),
    Column("after", "rotation_after", _short),
    Column("translation", "translation_before", _short),
    Column("after", "translation_after", _short),
    Column("chi2", "chi2_after", _short),
)


def loops_section(closed: LoopClosing) -> Section:
    """Return the state of the closures after the solve."""
    graph = f"{plural(closed.num_nodes, 'pose')}, {plural(closed.num_edges, 'edge')}"
    pieces = f", {closed.num_components} pieces" if closed.num_components > 1 else ""
    rows = [
        ("loops", f"{closed.num_used} used, {closed.num_rejected} rejected"),
        ("", f"{graph} between images that share points{pieces}"),
        ("", f"cost of the graph {change(closed.cost_before, closed.cost_after)}"),
    ]
    if closed.has_free_scales:
        least, largest = closed.scale_range
        rows.append(("", f"images scaled by {least:.4g} to {largest:.4g}"))
    if closed.factors:
        kept = plural(len(closed.factors), "closure")
        rows.append(("", f"{kept} of images that share few points kept in bundle adjustment"))

    def others(count: int) -> str:
        return f"{plural(count, 'other closure')} have smaller errors; --json FILE lists all"

    order = sorted(closed.closures, key=lambda closure: (closure.used, -closure.chi2_after))
    table = Table(CLOSURES, order, left=2, most=MOST_CLOSURES, others=others)
    return Section(facts=rows, tables=[table])


_PHASES = (
    ("preprocessor", "preprocessor_time_in_seconds"),
    ("Jacobians, elimination", "jacobian_evaluation_time_in_seconds"),
    ("reduced linear solver", "linear_solver_time_in_seconds"),
    ("back-substitution, residuals", "residual_evaluation_time_in_seconds"),
    ("messages and waiting", "waiting_time_in_seconds"),
    ("total", "total_time_in_seconds"),
)


MESSAGES = (
    Column("messages", "what"),
    Column("number", "num_messages"),
    Column("size", "num_bytes", format_size),
    Column("seconds", "seconds", seconds),
)


def process_sections(record: ProcessRecord) -> list[Section]:
    """Return balance, times and messages of several processes."""
    parts = record.parts
    observations = [part.num_observations for part in parts]
    memory = [part.peak_memory_in_bytes for part in parts]
    balance = (
        f"{min(observations)} to {max(observations)} observations each, "
        f"the most {100 * (record.balance - 1):.2g} % above the mean"
    )
    times = [(name, *_slowest(parts, field)) for name, field in _PHASES]
    facts = [
        ("processes", f"{len(parts)}, {balance}"),
        ("", f"peak memory {format_size(min(memory))} to {format_size(max(memory))}"),
    ]
    head = ("time of the processes", "slowest", "process", "mean")
    return [
        Section(facts=facts),
        Section(tables=[Table.of(head, times)]),
        Section(tables=[Table(MESSAGES, record.traffic)]),
    ]


def _slowest(parts: tuple[ProcessPart, ...], field: str) -> tuple[str, str, str]:
    times = [getattr(part, field) for part in parts]
    slowest = max(times)
    return seconds(slowest), str(times.index(slowest)), seconds(sum(times) / len(times))
