"""Targets, and their values from the measurements."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks import (
    agreement,
    backend,
    judging,
    practitioners,
    scaling,
    table,
    uncertainty,
    whole,
)
from benchmarks.measure import Spread
from benchmarks.results import Results
from benchmarks.rows import Row
from benchmarks.solvers import REFERENCE

MAIN = "16-22106"
FUSED, FUSED_ITERATIVE, FUSED_SPARSE = (
    f"bundle fused {solver}" for solver in ("auto", "iterative-schur", "sparse-schur")
)
CERES, PEER = "bundle ceres auto", "pycolmap auto"
CERES_SCHUR = (
    CERES,
    "bundle ceres dense-schur",
    "bundle ceres sparse-schur",
    "bundle ceres iterative-schur",
)
BYTES_AN_OBSERVATION = 120.0
MANY_OBSERVATIONS = 5_000
MANY_IMAGES = 1000
FIVE_MILLION = 5_000_000


@dataclass(frozen=True)
class Target:
    """A number and its limit; ``value`` is None if it could not be measured."""

    what: str
    value: float | None
    limit: float
    is_least: bool = True

    @property
    def met(self) -> bool:
        """True if the number meets its limit."""
        if self.value is None:
            return False
        return self.value >= self.limit if self.is_least else self.value <= self.limit


def of(results: Results) -> list[Target]:
    """Return the targets whose problems were among those chosen."""
    return [
        *_main_problem(results),
        *_other_real(results),
        *_whole_models(results),
        *_practitioners(results),
        *_uncertainty(results),
        *_judging(results),
        *_pose_graphs(results),
        *_inertial(results),
        *_large_synthetic(results),
        *_growth(results),
        *_choice(results),
        *_agreement(results),
    ]


def quotient(over: Spread | None, under: Spread | None) -> float | None:
    """Return the ratio of two medians, None without one of them."""
    return over.median / under.median if over and under and under.median else None


def _step(row: Row | None) -> Spread | None:
    return row.step if row else None


def _total(row: Row | None) -> Spread | None:
    return row.total if row else None


def _main_problem(results: Results) -> list[Target]:
    if MAIN not in results.kinds:
        return []
    ours = _step(results.row(MAIN, REFERENCE))
    lines = [
        Target(
            f"{MAIN}, time per step: {peer} / {REFERENCE}",
            quotient(_step(results.row(MAIN, peer)), ours),
            limit,
        )
        for peer, limit in ((PEER, 10.0), (CERES, 7.0))
    ]
    if results.settings["threads"] > 1:
        one = _step(results.row(MAIN, FUSED, threads=1))
        several = _step(results.row(MAIN, FUSED))
        what = f"{MAIN}, time per step, {FUSED}: 1 thread / {results.settings['threads']} threads"
        lines.append(Target(what, quotient(one, several), 1.7))
    if MAIN in results.whole:
        processes = results.whole[MAIN]
        ours, theirs = (whole.spreads(processes[name])[0] for name in (whole.OURS, whole.THEIRS))
        what = f"{MAIN}, whole process, load and save included: ours / pycolmap's"
        lines.append(Target(what, quotient(ours, theirs), 0.7, is_least=False))
    return lines


def _other_real(results: Results) -> list[Target]:
    names = [
        name
        for name in results.problems("bal", "colmap")
        if name != MAIN
        and (
            results.kinds[name] == "bal"
            or results.size(name).get("observations", 0) > MANY_OBSERVATIONS
        )
    ]
    return [
        _extreme(
            f"{what}, {PEER} / {REFERENCE}, least of",
            [
                (name, quotient(of(results.row(name, PEER)), of(results.row(name, REFERENCE))))
                for name in names
            ],
            limit,
        )
        for what, of, limit in (("time per step", _step, 6.0), ("total", _total, 5.0))
        if names
    ]


def _whole_models(results: Results) -> list[Target]:
    """Return the targets of whole processes on COLMAP models, most of whose time is the start."""
    names = [name for name in results.problems("colmap") if name in results.whole]
    if not names:
        return []
    pairs = [(results.whole[name][whole.OURS], results.whole[name][whole.THEIRS]) for name in names]
    return [
        _extreme(
            f"whole process on a COLMAP model, {what}: ours / pycolmap's, most of",
            [
                (name, quotient(of(ours), of(theirs)))
                for name, (ours, theirs) in zip(names, pairs, strict=True)
            ],
            1.0,
            is_least=False,
        )
        for what, of in (("wall time", _wall), ("CPU time", whole.cpu))
    ]


def _practitioners(results: Results) -> list[Target]:
    lines = []
    for title, runs in results.practitioners.items():
        step = practitioners.spread(runs[practitioners.OURS], "step")
        if practitioners.THEIRS in runs:
            peer = practitioners.spread(runs[practitioners.THEIRS], "step")
            what = f"{title}, time per step: pycolmap / bundle"
            lines.append(Target(what, quotient(peer, step), 8.0))
        else:
            filtering = practitioners.spread(runs[practitioners.OURS], "filter")
            lines.append(Target(title, quotient(filtering, step), 2.0, is_least=False))
    return lines


def _uncertainty(results: Results) -> list[Target]:
    lines = []
    for name, runs in results.uncertainty.items():
        of = {
            who: {what: uncertainty.spread(mine, what) for what in ("cpu", "wall", "memory")}
            for who, mine in runs.items()
        }
        if uncertainty.THEIRS in runs:
            theirs = of.pop(uncertainty.THEIRS)["wall"]
            what = f"{name}, covariance of all, wall time: pycolmap"
            lines += [
                Target(f"{what} / {who}", quotient(theirs, mine["wall"]), 20.0)
                for who, mine in of.items()
                if name == uncertainty.STREET_NAME
            ]
            continue
        for who, limit in ((uncertainty.INNER, 20.0), (uncertainty.DIAGNOSIS, 60.0)):
            if who not in of:
                continue
            wall, memory = of[who]["wall"], of[who]["memory"]
            lines.append(
                Target(f"{name}, {who}, seconds", wall.median if wall else None, limit, False)
            )
            if who == uncertainty.INNER:
                value = memory.median / 1e9 if memory else None
                lines.append(Target(f"{name}, {who}, peak memory in GB", value, 3.0, False))
    return lines


def _judging(results: Results) -> list[Target]:
    lines = []
    for name, runs in results.judging.items():
        wall = judging.spread(runs, "wall")
        seconds = wall.median if wall else None
        lines.append(Target(f"{name}, bundle validate, seconds", seconds, judging.LIMIT, False))
    return lines


GRAPH_LIMITS = (
    (("parking-garage", "intel", "M3500", "CSAIL", "MIT"), {backend.GTSAM: 5.0}),
    (("parking-garage", "intel", "M3500", "CSAIL"), {backend.CERES: 3.0}),
    (("intel", "M3500", "CSAIL", "MIT"), {backend.G2O: 2.0}),
    (("sphere2500",), {backend.GTSAM: 4.0, backend.CERES: 2.0}),
)


def _pose_graphs(results: Results) -> list[Target]:
    found = results.pose_graphs
    lines = []
    for names, limits in GRAPH_LIMITS:
        known = [name for name in names if name in found]
        for peer, limit in limits.items() if known else ():
            ratios = [
                (
                    name,
                    quotient(
                        backend.graph_seconds(found, name, peer),
                        backend.graph_seconds(found, name, backend.OURS),
                    ),
                )
                for name in known
            ]
            lines.append(_extreme(f"pose graphs, total: {peer} / bundle, least of", ratios, limit))
    if backend.MANY in found:
        took = backend.graph_seconds(found, backend.MANY, backend.OURS)
        lines.append(
            Target("synthetic pose graph, seconds", took.median if took else None, 2.5, False)
        )
    return lines


def _inertial(results: Results) -> list[Target]:
    lines = []
    if backend.OURS in results.inertial:
        batch, times = list(results.inertial[backend.OURS].items())[-1]
        what = f"preintegration, us per sample in batches of {batch}"
        lines.append(Target(what, statistics.median(times), 0.2, False))
    if results.windows:
        ratio = quotient(
            backend.window_seconds(results.windows, backend.GTSAM),
            backend.window_seconds(results.windows, backend.OURS),
        )
        lines.append(Target("a batch of keyframes, CPU time: GTSAM / bundle", ratio, 5.0))
    return lines


def _wall(runs: Sequence[Mapping[str, Any]]) -> Spread | None:
    return whole.spreads(runs)[0]


def _large_synthetic(results: Results) -> list[Target]:
    names = [
        name
        for name in results.problems("synthetic")
        if results.size(name).get("images", 0) >= MANY_IMAGES and results.tried(name, CERES)
    ]
    ratios = []
    for name in names:
        ours = results.row(name, REFERENCE)
        theirs = [row for solver in CERES_SCHUR if (row := results.row(name, solver))]
        times = [row.reached[-1] for row in theirs if row.reached[-1]]
        best = min((time for time in times if time), key=lambda time: time.median, default=None)
        ratios.append((name, quotient(best, ours.reached[-1] if ours else None)))
    what = f"time to 1e-05, best Schur solver of Ceres / {REFERENCE}, least of"
    return [_extreme(what, ratios, 4.0)] if ratios else []


def _growth(results: Results) -> list[Target]:
    """Return the targets of the largest scenes; none without them."""
    names = results.problems("synthetic")
    large = [n for n in names if results.size(n).get("observations", 0) >= FIVE_MILLION]
    if not large:
        return []
    memory = []
    for name in large:
        row = results.row(name, FUSED_SPARSE)
        added = row.added_memory.median if row and row.added_memory else None
        share = added / results.size(name)["observations"] if added else None
        memory.append((name, share))
    what = f"{FUSED_SPARSE}, bytes an observation beyond the loaded problem, most of"
    return [
        *(
            Target(
                f"{what} of {FUSED_ITERATIVE} grows as observations to the power of",
                scaling.exponent(results, FUSED_ITERATIVE, quantity),
                1.1,
                is_least=False,
            )
            for what, quantity in (("total", scaling.total), ("total a step", scaling.total_a_step))
        ),
        _extreme(what, memory, BYTES_AN_OBSERVATION, is_least=False),
    ]


def _choice(results: Results) -> list[Target]:
    ratios = []
    for name in results.kinds:
        if not results.tried(name, FUSED, CERES):
            continue
        both = [_total(results.row(name, solver)) for solver in (FUSED, CERES)]
        better = min((t for t in both if t), key=lambda time: time.median, default=None)
        ratios.append((name, quotient(_total(results.row(name, REFERENCE)), better)))
    what = f"total, {REFERENCE} / the better of {FUSED} and {CERES}, most of"
    return [_extreme(what, ratios, 1.1, is_least=False)] if ratios else []


def _agreement(results: Results) -> list[Target]:
    found = agreement.found(results)
    return [
        _extreme(f"{what}, fused / ceres - 1, most of", ratios, limit, is_least=False)
        for what, ratios, limit in (
            (f"cost at each of the first {agreement.FIRST} steps", found.first, 1e-8),
            ("final cost", found.final, 1e-9),
        )
        if ratios
    ]


def _extreme(
    what: str, ratios: Iterable[tuple[str, float | None]], limit: float, is_least: bool = True
) -> Target:
    """Return the target over several problems, which its worst decides and is named for.

    One problem without a number leaves the target without one.
    """
    pairs = list(ratios)
    missing = [name for name, ratio in pairs if ratio is None]
    if missing:
        return Target(f"{what} {len(pairs)} ({missing[0]} has none)", None, limit, is_least)
    choose: Callable[..., tuple[str, float | None]] = min if is_least else max
    worst, ratio = choose(pairs, key=lambda pair: pair[1])
    return Target(f"{what} {len(pairs)} ({worst})", ratio, limit, is_least)


def as_table(goals: Sequence[Target]) -> str:
    """Return one line a target: what, the measured value, the limit, and whether it is met."""
    lines = [[goal.what, *_numbers(goal), "yes" if goal.met else "no"] for goal in goals]
    return table.grid(["target", "measured", "limit", "met"], lines)


def in_words(goal: Target) -> str:
    """Return what was measured and wanted."""
    measured, limit = _numbers(goal)
    return f"{goal.what}: {measured}, wanted {limit}"


def _numbers(goal: Target) -> list[str]:
    measured = "not measured" if goal.value is None else f"{goal.value:.3g}"
    return [measured, f"{'at least' if goal.is_least else 'at most'} {goal.limit:g}"]
