"""`make bench`: every solver on every problem, one process a run, repeats interleaved."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import json
import shlex
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import machine, measure, problems, report, solvers, whole
from benchmarks.rows import Run

RESULTS = problems.ROOT / "benchmarks" / "results"
# Ceres' names; the first three tolerances are bundle's defaults, which are Ceres' own.
STOPPING = {
    "max_num_iterations": 100,
    "function_tolerance": 1e-6,
    "gradient_tolerance": 1e-10,
    "parameter_tolerance": 1e-8,
}
# For the best known cost: run once, by the peer, never timed.
MARK_STOPPING = {
    "max_num_iterations": 300,
    "function_tolerance": 1e-12,
    "gradient_tolerance": 1e-12,
    "parameter_tolerance": 1e-14,
}
MARK_SOLVER = solvers.Solver("pycolmap_", "dense-schur")
REPEAT_BELOW = 20.0


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--repeat", type=int, default=3, metavar="N", help="runs of each pair (default 3)")
    add("--problems", default="", metavar="LIST", help="names; default: all in BUNDLE_DATA")
    add(
        "--solvers",
        default=",".join(sorted({s.name.split()[0] for s in solvers.SOLVERS})),
        metavar="LIST",
        help="beginnings of names, such as bundle,pycolmap-auto (default: all)",
    )
    add("--threads", type=int, default=machine.cores(), metavar="N", help="default: all cores")
    add("--timeout", type=float, default=90.0, metavar="SECONDS", help="of one run (default 90)")
    add("--update-readme", action="store_true", help="put tables into README.md, plot into docs/")
    add("--output", type=Path, default=RESULTS, metavar="FOLDER", help="default benchmarks/results")
    return parser.parse_args()


def run_once(
    problem: problems.BenchmarkProblem,
    solver: solvers.Solver,
    stopping: dict[str, float],
    options: argparse.Namespace,
) -> Run:
    """Run one solver on one problem in its own process."""
    run: Run = {"problem": problem.name, "solver": solver.name, "outcome": None}
    reason = solver.reason_against(problem.kind)
    if reason:
        return {**run, "failure": reason, "wall": 0.0, "cpu": 0.0}
    if importlib.util.find_spec(solver.runner.rstrip("_")) is None:
        return {**run, "failure": "not installed", "wall": 0.0, "cpu": 0.0}
    with tempfile.TemporaryDirectory() as folder:
        request, answer = Path(folder) / "request.json", Path(folder) / "answer.json"
        fields = {"path": str(problem.path), "kind": problem.kind, "solver": solver.solver}
        request.write_text(json.dumps({**fields, "threads": options.threads, **stopping}))
        module = f"benchmarks.runners.{solver.runner}"
        command = [sys.executable, "-m", module, str(request), str(answer)]
        env = measure.environment(problems.ROOT, options.threads)
        child = measure.run_child(command, env, options.timeout)
        outcome: dict[str, Any] = {}
        if not child.failure:
            outcome = json.loads(answer.read_text())
    failure = child.failure or outcome.get("failure", "")
    return {
        **run,
        "failure": failure,
        "wall": child.wall,
        "cpu": child.cpu,
        "outcome": None if failure else outcome,
    }


def run_all(
    chosen: list[problems.BenchmarkProblem],
    options: argparse.Namespace,
) -> tuple[list[Run], list[Run]]:
    """Return all runs and the runs that only set the best known cost.

    What failed, and what took longer than REPEAT_BELOW, is not repeated.
    """
    runs: list[Run] = []
    marks: list[Run] = []
    for problem in chosen:
        marks.append(run_once(problem, MARK_SOLVER, MARK_STOPPING, options))
        left = solvers.chosen(options.solvers)
        for repeat in range(options.repeat):
            for solver in list(left):
                run = run_once(problem, solver, STOPPING, options)
                runs.append(run)
                said = run["failure"] or f"{run['wall']:.1f} s"
                print(f"{problem.name}: {solver.name}, run {repeat + 1}: {said}", file=sys.stderr)
                if run["failure"] or run["wall"] > REPEAT_BELOW:
                    left.remove(solver)
    return runs, marks


def run_whole(
    chosen: list[problems.BenchmarkProblem], options: argparse.Namespace, folder: Path
) -> dict[str, dict[str, list[dict[str, Any]]]]:
    """Run the whole processes, interleaved; the last run of each also has its output's cost."""
    env = measure.environment(problems.ROOT, options.threads)
    results: dict[str, dict[str, list[dict[str, Any]]]] = {}
    outputs: list[tuple[dict[str, Any], Path, str]] = []
    for problem in chosen:
        results[problem.name] = {whole.OURS: [], whole.THEIRS: []}
        for repeat in range(options.repeat):
            target = folder / f"{problem.name}-{repeat}"
            target.mkdir()
            for name, job in whole.jobs(problem, STOPPING, options.threads, target).items():
                run = whole.run(job, env, options.timeout)
                results[problem.name][name].append(run)
                said = run["failure"] or f"{run['wall']:.2f} s"
                print(f"{problem.name}: {name}, run {repeat + 1}: {said}", file=sys.stderr)
                if repeat == options.repeat - 1 and not run["failure"]:
                    outputs.append((run, job.output, problem.kind))
    for run, output, kind in outputs:
        run["final_cost"] = whole.final_cost(output, kind)
    return results


def plot(results: report.Results, folder: Path, readme: bool) -> str:
    """Draw the BAL problems; return the image's path relative to the report, "" without one."""
    if importlib.util.find_spec("matplotlib") is None:
        print("no plot: matplotlib is not installed", file=sys.stderr)
        return ""
    from benchmarks import plot as plotting

    names = [name for name, kind in results.kinds.items() if kind == "bal"]
    panels = [(name, results.of(name), results.best_cost(name)) for name in names]
    if not panels:
        return ""
    paths = [folder / "bench.png", folder / "bench.svg"]
    if readme:
        paths.append(problems.ROOT / "docs" / "bench.png")
    plotting.draw(panels, paths)
    return "docs/bench.png" if readme else "bench.png"


def main() -> int:
    """Measure, then write JSON, tables and plot."""
    options = arguments()
    options.output.mkdir(parents=True, exist_ok=True)
    found = problems.find(problems.data_folder())
    wanted = [name for name in options.problems.split(",") if name]
    chosen = [problem for problem in found if not wanted or problem.name in wanted]
    if not chosen:
        names = ", ".join(problem.name for problem in found) or "nothing"
        print(f"error: no problem chosen; {problems.data_folder()} has {names}", file=sys.stderr)
        return 2
    described = machine.describe()
    runs, marks = run_all(chosen, options)
    with tempfile.TemporaryDirectory() as folder:
        processes = run_whole(chosen, options, Path(folder))
    settings = {"threads": options.threads, "repeat": options.repeat, "stopping": STOPPING}
    results = report.Results(
        machine=described,
        command=shlex.join(["python", "benchmarks/run.py", *sys.argv[1:]]),
        settings={**settings, "repeat_below": REPEAT_BELOW},
        kinds={problem.name: problem.kind for problem in chosen},
        runs=runs,
        marks=marks,
        whole=processes,
    )
    (options.output / "bench.json").write_text(json.dumps(dataclasses.asdict(results), indent=1))
    text = report.markdown(results, plot(results, options.output, options.update_readme))
    (options.output / "bench.md").write_text(text)
    print(text)
    if options.update_readme:
        report.put_into(problems.ROOT / "README.md", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
