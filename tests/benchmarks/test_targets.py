from __future__ import annotations

import pytest
from benchmarks.results import Results

from benchmarks import details, report, scaling, targets

SIZES = {
    "16-22106": (16, 83_718),
    "21-11315": (21, 36_455),
    "model": (10, 5_001),
    "toy": (3, 5_000),
    "street-50": (50, 50_000),
    "street-1000": (1000, 1_000_000),
    "street-5000": (5000, 5_000_000),
    "laps-5000": (5000, 5_000_000),
}
KINDS = {"16-22106": "bal", "21-11315": "bal", "model": "colmap", "toy": "colmap"}


def run(problem, solver, step, *, total=None, threads=2, rule="default", added=0):
    images, observations = SIZES[problem]
    total = 10 * step if total is None else total
    outcome = {
        "build": 0.0,
        "solve": total,
        "minimizer": 5 * step,
        "num_steps": 5,
        "trace": [[0.0, 200.0], [total, 100.0]],
        "final_cost": 100.0,
        "verified_cost": 100.0,
        "peak_memory": 10**9,
        "added_memory": added,
        "notes": ["X"],
        "versions": {"v": "1"},
        "size": {
            "images": images,
            "points": observations // 4,
            "observations": observations,
            "image_pairs": 6 * (observations // 4),
            "cameras": images,
            "camera_columns": 3,
            "rigs": 0,
        },
    }
    return {
        "problem": problem,
        "solver": solver,
        "rule": rule,
        "threads": threads,
        "failure": "",
        "wall": 2.0,
        "cpu": 3.0,
        "outcome": outcome,
    }


def results(runs, whole=None):
    names = [name for name in SIZES if any(run["problem"] == name for run in runs)]
    return Results(
        machine={"date": "d", "cpu": "c", "cores": "2", "system": "s", "load before": "0"},
        command="run",
        settings={
            "threads": 2,
            "repeat": 1,
            "stopping": {"x": 1.0},
            "rates": {"dgemm": 4e10, "copy": 1e10},
        },
        kinds={name: KINDS.get(name, "synthetic") for name in names},
        runs=runs,
        whole=whole or {},
    )


def found(measured, words):
    """The one target whose text has all these words."""
    (target,) = (t for t in targets.of(measured) if all(word in t.what for word in words))
    return target


def test_the_main_problem():
    measured = results(
        [
            run("16-22106", "bundle auto", 0.007),
            run("16-22106", "bundle fused auto", 0.007),
            run("16-22106", "bundle fused auto", 0.0126, threads=1),
            run("16-22106", "bundle ceres auto", 0.056),
            run("16-22106", "pycolmap auto", 0.0693),
        ],
        {
            "16-22106": {
                "bundle refine": [{"failure": "", "wall": 0.6, "peak_memory": 1}],
                "pycolmap script": [{"failure": "", "wall": 1.0, "peak_memory": 1}],
            }
        },
    )
    goals = {target.what: target for target in targets.of(measured)}
    by_limit = {(goal.limit, goal.is_least): goal for goal in goals.values()}
    assert by_limit[10.0, True].value == pytest.approx(9.9)
    assert not by_limit[10.0, True].met
    assert by_limit[7.0, True].value == pytest.approx(8.0)
    assert by_limit[1.7, True].value == pytest.approx(1.8)
    assert by_limit[0.7, False].value == pytest.approx(0.6)
    assert by_limit[1.1, False].value == pytest.approx(1.0)
    assert [goal.met for goal in goals.values()].count(False) == 1


def test_the_worst_of_the_real_problems_decides_and_small_models_do_not_count():
    runs = [run(name, "bundle auto", 0.001) for name in ("21-11315", "model", "toy")]
    runs += [
        run("21-11315", "pycolmap auto", 0.009),
        run("model", "pycolmap auto", 0.0065),
        run("toy", "pycolmap auto", 0.001),
    ]
    goal = found(results(runs), ["time per step", "least of 2 (model)"])
    assert (goal.value, goal.limit, goal.met) == (pytest.approx(6.5), 6.0, True)
    goal = found(results(runs[:-2]), ["time per step", "model has none"])
    assert (goal.value, goal.met) == (None, False)


def test_the_best_ceres_solver_of_large_scenes_counts():
    runs = [
        run("street-1000", "bundle auto", 0.1),
        run("street-1000", "bundle ceres auto", 0.9),
        run("street-1000", "bundle ceres sparse-schur", 0.45),
        run("street-50", "bundle auto", 0.1),
    ]
    goal = found(results(runs), ["best Schur solver", "least of 1 (street-1000)"])
    assert goal.value == pytest.approx(4.5)


def test_growth_and_memory_are_those_of_the_largest_scene():
    solver = "bundle fused iterative-schur"
    runs = [
        run(name, solver, 1.0, total=1e-6 * SIZES[name][1] ** 1.05)
        for name in ("street-50", "street-1000")
    ]
    assert not [goal for goal in targets.of(results(runs)) if "power" in goal.what]
    runs.append(run("street-5000", solver, 1.0, total=1e-6 * 5e6**1.05))
    runs.append(run("street-5000", "bundle fused sparse-schur", 1.0, added=5_000_000 * 130))
    measured = results(runs)
    for what in ("total of", "total a step of"):
        assert found(measured, [what, "power"]).value == pytest.approx(1.05)
        assert found(measured, [what, "power"]).met
    memory = found(measured, ["bytes an observation"])
    assert (memory.value, memory.met) == (pytest.approx(130.0), False)
    assert scaling.exponent(measured, solver, scaling.num_steps) == pytest.approx(0.0, abs=1e-12)
    assert scaling.exponent(measured, "bundle auto") is None
    runs.append(run("laps-5000", "bundle fused sparse-schur", 1.0, added=5_000_000 * 140))
    assert found(results(runs), ["bytes an observation", "(laps-5000)"]).value == pytest.approx(140)


def test_drives_in_laps_have_powers_of_their_own():
    solver = "bundle fused sparse-schur"
    runs = [
        run("street-1000", solver, 1.0, total=2.0),
        run("laps-5000", solver, 1.0, total=9.0),
        run("street-5000", solver, 1.0, total=10.0),
    ]
    measured = results(runs)
    assert [size for size, _ in scaling.points(measured, solver, scaling.LAPS)] == [5_000_000]
    assert scaling.exponent(measured, solver) == pytest.approx(1.0)
    assert scaling.growth_table(measured) and not scaling.growth_table(measured, scaling.LAPS)


def test_auto_is_held_to_the_better_backend():
    runs = [
        run("toy", "bundle auto", 0.12),
        run("toy", "bundle fused auto", 0.1),
        run("toy", "bundle ceres auto", 0.2),
        run("model", "bundle auto", 0.1),
        run("model", "bundle ceres auto", 0.1),
    ]
    goal = found(results(runs), ["the better of", "most of 2 (toy)"])
    assert (goal.value, goal.met) == (pytest.approx(1.2), False)


def whole_runs(wall, cpu, failure=""):
    return [
        {"failure": failure, "wall": wall, "cpu": cpu, "peak_memory": 1, "final_cost": 1.0}
        for _ in range(3)
    ]


def test_whole_processes_on_models_are_judged_by_the_worst():
    runs = [run("model", solver, 0.1) for solver in ("bundle auto", "pycolmap auto")]
    processes = {"bundle refine": whole_runs(0.9, 0.8), "pycolmap script": whole_runs(1.0, 0.5)}
    measured = results(runs, {"model": processes})
    wall = found(measured, ["whole process on a COLMAP model", "wall time", "(model)"])
    cpu = found(measured, ["whole process on a COLMAP model", "CPU time", "(model)"])
    assert (wall.value, wall.met) == (pytest.approx(0.9), True)
    assert (cpu.value, cpu.met) == (pytest.approx(1.6), False)
    page = details.page(measured, report.heading(measured), {})
    line = next(line for line in page.splitlines() if line.startswith("| model | 0.9 s |"))
    assert "1.11x" in line and "0.62x" in line
    processes["pycolmap script"] = whole_runs(1.0, 0.5, "exit 1")
    assert not found(results(runs, {"model": processes}), ["COLMAP model", "wall time"]).met


def test_the_page_has_every_part_and_whole_tables():
    runs = [
        run(name, solver, step)
        for name, step in (("16-22106", 0.01), ("street-50", 0.02), ("street-1000", 0.4))
        for solver in ("bundle auto", "bundle fused dense-schur", "pycolmap auto")
    ]
    runs.append(run("16-22106", "bundle auto", 0.01, rule="tight"))
    runs += [run("16-22106", "pycolmap auto", 0.018, threads=1)]
    measured = results(runs)
    text = details.page(measured, report.heading(measured), {"scaling": "s.png", "gap": "g.png"})
    for title in (
        "Targets",
        "Ratios",
        "Growth",
        "Threads",
        "Share of the limit",
        "Time to 1e-8",
        "Problem by problem",
    ):
        assert f"## {title}" in text
    assert "1.80" in text.split("## Threads")[1].split("##")[0]
    first = text.split("## ")[0]
    assert "`pycolmap auto`" in first and "median of 3 problems" in first
    missed = [goal.what for goal in targets.of(measured) if not goal.met]
    assert missed and all(f"**Not met**: {what}" in first for what in missed)
    assert text.count("<details>") == text.count("</details>") == 3
    assert "(s.png)" in text
    assert "(g.png)" in text
    width = 0
    for line in text.splitlines():
        cells = line.count(" | ")
        assert not line.startswith("|") or width in (0, cells), line
        width = cells if line.startswith("|") else 0


def test_the_short_report_has_a_line_per_shown_problem():
    runs = [
        run(name, solver, step)
        for name, factor in (("16-22106", 1.0), ("street-1000", 3.0), ("street-50", 1.0))
        for solver, step in (
            ("bundle auto", 0.01),
            ("bundle ceres auto", 0.04),
            ("pycolmap auto", 0.05 * factor),
        )
    ]
    measured = results(runs)
    lines = report.short_table(measured).splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [line[:5] for line in cells] == [
        ["16-22106", "83,718", "0.1 s", "5.00x", "4.00x"],
        ["street-1000", "1,000,000", "0.1 s", "15.00x", "4.00x"],
    ]
    bars = [report.bar(measured, *pair) for pair in report.chosen(measured)]
    assert bars == [
        ("16-22106", pytest.approx(5.0), pytest.approx(4.0)),
        ("street-1000", pytest.approx(15.0), pytest.approx(4.0)),
    ]
    text = report.markdown(measured, "p.md", "i.png")
    assert "(i.png)" in text and "(p.md)" in text


def test_the_short_report_of_other_problems_shows_the_first():
    runs = [run("toy", "bundle auto", 0.01), run("toy", "pycolmap auto", 0.02)]
    measured = results(runs)
    assert [ours.problem for ours, _ in report.chosen(measured)] == ["toy"]
    assert report.bar(measured, *report.chosen(measured)[0]) == ("toy", pytest.approx(2.0), None)
