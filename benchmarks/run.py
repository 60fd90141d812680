"""`make bench`: every solver on every problem, one process a run, repeats interleaved."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import importlib.util
import json
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import (
    details,
    judging,
    machine,
    measure,
    practitioners,
    problems,
    report,
    scaling,
    series,
    solvers,
    synthetic,
    uncertainty,
    whole,
)
from benchmarks.problems import BenchmarkProblem
from benchmarks.results import Results

RESULTS = problems.ROOT / "benchmarks" / "results"
DOCS = problems.ROOT / "docs"
QUICK_SOLVERS = "bundle,pycolmap-auto"
QUICK_OBSERVATIONS = 200_000


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--repeat", type=int, metavar="N", help="runs of each pair (default 5; 1 if --quick)")
    add("--only", default="", metavar="LIST", help="names of problems; default: all there are")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--synthetic", action="store_true", help="synthetic scenes only")
    which.add_argument("--no-synthetic", action="store_true", help="real data only")
    add("--solvers", metavar="LIST", help="beginnings of names, such as bundle,pycolmap-auto")
    add(
        "--quick",
        action="store_true",
        help="a look: one run of each pair, no COLMAP models, small scenes, "
        f"the default stopping rule alone, --solvers {QUICK_SOLVERS}",
    )
    add("--threads", type=int, metavar="N", help="default: 2, or all cores if there are fewer")
    add("--timeout", type=float, default=150.0, metavar="SECONDS", help="of one run (default 150)")
    add(
        "--update-readme",
        action="store_true",
        help="put the short report into README.md, all tables and plots into docs/",
    )
    add(
        "--from-json",
        type=Path,
        metavar="FILE",
        nargs="+",
        help="the tables of older runs, again; what several files measured is that of the last",
    )
    add("--output", type=Path, default=RESULTS, metavar="FOLDER", help="default benchmarks/results")
    options = parser.parse_args()
    every = ",".join(sorted({solver.family for solver in solvers.SOLVERS}))
    options.repeat = options.repeat or (1 if options.quick else 5)
    options.solvers = options.solvers or (QUICK_SOLVERS if options.quick else every)
    options.threads = options.threads or min(2, machine.cores())
    return options


def choose(options: argparse.Namespace) -> list[BenchmarkProblem]:
    """Return the chosen problems; empty, with a line on standard error, if there is none."""
    found: list[BenchmarkProblem] = []
    if not options.synthetic:
        found += problems.find(problems.data_folder())
    if not options.no_synthetic:
        found += [synthetic.problem(scene) for scene in synthetic.SCENES]
    wanted = [name for name in options.only.split(",") if name]
    chosen = [problem for problem in found if not wanted or problem.name in wanted]
    if options.quick and not wanted:
        chosen = [
            problem
            for problem in chosen
            if problem.kind == "bal" and problem.num_observations <= QUICK_OBSERVATIONS
        ]
    unknown = set(wanted) - {problem.name for problem in chosen}
    if unknown or not chosen:
        missing = ", ".join(sorted(unknown)) or "nothing found"
        names = ", ".join(problem.name for problem in found) or "nothing"
        print(
            f"error: no problem chosen: {missing}; {problems.data_folder()} and the synthetic "
            f"scenes have {names}",
            file=sys.stderr,
        )
        return []
    return chosen


def run_whole(
    chosen: list[BenchmarkProblem], options: argparse.Namespace, folder: Path
) -> dict[str, dict[str, list[dict[str, Any]]]]:
    """Run the whole processes, interleaved; the last run of each also has its output's cost."""
    env = measure.environment(problems.ROOT, None)  # each command is told its threads
    results: dict[str, dict[str, list[dict[str, Any]]]] = {}
    outputs: list[tuple[dict[str, Any], Path, str]] = []
    for problem in chosen:
        results[problem.name] = {whole.OURS: [], whole.THEIRS: []}
        repeats = options.repeat if problem.kind == "bal" else max(options.repeat, whole.REPEATS)
        for repeat in range(repeats):
            target = folder / f"{problem.name}-{repeat}"
            target.mkdir()
            for name, job in whole.jobs(problem, series.STOPPING, options.threads, target).items():
                run = whole.run(job, env, options.timeout)
                results[problem.name][name].append(run)
                said = run["failure"] or f"{run['wall']:.2f} s"
                print(f"{problem.name}: {name}, run {repeat + 1}: {said}", file=sys.stderr)
                if repeat == repeats - 1 and not run["failure"]:
                    outputs.append((run, job.output, problem.kind))
    for run, output, kind in outputs:
        run["final_cost"] = whole.final_cost(output, kind)
    return results


def rates(threads: int) -> dict[str, float]:
    """Return the rates of this machine (flops.measure_rates), measured in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.flops", str(threads)]
    env = measure.environment(problems.ROOT, threads)
    done = subprocess.run(command, env=env, capture_output=True, check=True, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def measure_all(chosen: list[BenchmarkProblem], options: argparse.Namespace) -> Results:
    """Make what is missing, run everything, and return what was measured."""
    for problem in chosen:
        if problem.is_synthetic:
            synthetic.ensure(problem)
    described = machine.describe()
    runs = []
    for problem in chosen:
        wanted = solvers.chosen(options.solvers)
        mine = series.of_problem(problem, wanted, options.threads, options.quick)
        runs += series.run_interleaved(mine, options)
    real = [] if options.quick else [problem for problem in chosen if not problem.is_synthetic]
    with tempfile.TemporaryDirectory() as folder:
        processes = run_whole(real, options, Path(folder))
    further, certain, judged = {}, {}, {}
    graphs, inertia, windows = None, None, None
    if not (options.quick or options.synthetic or options.only):
        further = practitioners.measured(options.repeat, options.threads, options.timeout)
        env = measure.environment(problems.ROOT, 1)  # OpenBLAS'; bundle is told its own
        repeat, threads = ["--repeat", str(options.repeat)], ["--threads", str(options.threads)]
        sets = ["--no-synthetic"] if options.no_synthetic else []
        graphs = measure.run_module(
            "benchmarks.pose_graphs", [*repeat, *threads, *sets], env, 10 * options.timeout
        )
        inertia, windows = (
            measure.run_module(module, repeat, env, options.timeout)
            for module in ("benchmarks.inertial", "benchmarks.windows")
        )
        if not options.no_synthetic:
            judged = judging.measured(options.repeat, options.threads, options.timeout)
            certain = uncertainty.measured(options.repeat, options.threads, options.timeout)
    return Results(
        machine=described,
        command=shlex.join(["python", "benchmarks/run.py", *sys.argv[1:]]),
        settings={
            "threads": options.threads,
            "repeat": options.repeat,
            "stopping": series.STOPPING,
            "rates": rates(options.threads),
        },
        kinds={
            problem.name: "synthetic" if problem.is_synthetic else problem.kind
            for problem in chosen
        },
        runs=runs,
        whole=processes,
        practitioners=further,
        uncertainty=certain,
        judging=judged,
        pose_graphs=graphs or {},
        inertial=inertia or {},
        windows=windows or {},
    )


def plot(results: Results, folders: list[Path]) -> dict[str, str]:
    """Draw the plots into every folder; return the names of those that there are."""
    if importlib.util.find_spec("matplotlib") is None:
        print("no plots: matplotlib is not installed", file=sys.stderr)
        return {}
    from benchmarks import plot as plotting

    drawn = {}
    panels = [
        (name, results.of(name), results.best_cost(name))
        for name in results.problems("bal")
        if any(run["outcome"] for run in results.of(name))
    ]
    if panels:
        plotting.draw(panels, [folder / "bench.png" for folder in folders])
        drawn["gap"] = "bench.png"
    bars = [report.bar(results, ours, peer) for ours, peer in report.chosen(results)]
    if bars:
        plotting.draw_totals(bars, [folder / "bench_totals.png" for folder in folders])
        drawn["totals"] = "bench_totals.png"
    names = [solver.name for solver in solvers.SOLVERS]
    paths = [folder / "bench_scaling.png" for folder in folders]
    if scaling.growth_table(results) and plotting.draw_scaling(results, names, paths):
        drawn["scaling"] = "bench_scaling.png"
    return drawn


def write(results: Results, options: argparse.Namespace) -> None:
    """Write JSON, tables and plots; with --update-readme also those of the repository."""
    text = json.dumps(dataclasses.asdict(results), indent=1)
    (options.output / "bench.json").write_text(text)
    folders = [options.output, *([DOCS] if options.update_readme else [])]
    plots = plot(results, folders)
    page = details.page(results, report.heading(results), plots)
    for folder in folders:
        (folder / "benchmarks.md").write_text(page)
    short = report.markdown(results, "benchmarks.md", plots.get("totals", ""))
    (options.output / "bench.md").write_text(short)
    print(short)
    if options.update_readme:
        image = f"docs/{plots['totals']}" if "totals" in plots else ""
        report.put_into(
            problems.ROOT / "README.md", report.markdown(results, "docs/benchmarks.md", image)
        )


def main() -> int:
    """Measure, then write JSON, tables and plots."""
    options = arguments()
    options.output.mkdir(parents=True, exist_ok=True)
    if options.from_json:
        older = [Results(**json.loads(path.read_text())) for path in options.from_json]
        write(functools.reduce(Results.followed_by, older), options)
        return 0
    chosen = choose(options)
    if not chosen:
        return 2
    write(measure_all(chosen, options), options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
