"""`make bench-gate`: the lead over pycolmap per step, against that of the last release.

    python -m benchmarks.gate [--record] [--only NAME,...] [--repeat N] [--threads N]

Both run in turns, so that a slower machine does not count. Exit code 1: on a problem bundle's lead,
pycolmap's time over ours, is below the recorded one by more than ``SLOWER``. ``--record`` writes
the leads to ``gate.json`` instead, with the version; a release does.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import bundle
from benchmarks import machine, problems, rows, series, solvers, table

RECORD = Path(__file__).with_name("gate.json")
OURS, THEIRS = "bundle auto", "pycolmap auto"
NAMES = ("16-22106", "49-7776", "vr_opencv", "video48", "lund_door", "bartoszek", "batmo_rigs")
SLOWER = 0.15

Leads = dict[str, float]


def leads_of(runs: Sequence[rows.Run]) -> Leads:
    """Return pycolmap's median time of a step over ours, by problem, where both have one."""
    leads = {}
    for name in dict.fromkeys(run["problem"] for run in runs):
        steps = []
        for solver in (OURS, THEIRS):
            mine = [run for run in runs if (run["problem"], run["solver"]) == (name, solver)]
            best = rows.best_known_cost(mine)
            steps.append(rows.row(name, solver, mine, best).step if mine else None)
        if steps[0] is not None and steps[1] is not None:
            leads[name] = steps[1].median / steps[0].median
    return leads


def slower(found: Mapping[str, float], recorded: Mapping[str, float]) -> list[str]:
    """Return the problems whose lead is below the recorded one by more than ``SLOWER``."""
    return [
        name
        for name, lead in recorded.items()
        if name in found and found[name] < (1 - SLOWER) * lead
    ]


def measured(names: Sequence[str], options: argparse.Namespace) -> Leads:
    """Return the leads on the problems of the data folder that have these names."""
    wanted = [solver for solver in solvers.SOLVERS if solver.name in (OURS, THEIRS)]
    chosen = [p for p in problems.find(problems.data_folder()) if p.name in names]
    every = [s for p in chosen for s in series.of_problem(p, wanted, options.threads, quick=True)]
    return leads_of(series.run_interleaved(every, options))


def main() -> None:
    """Measure, print the table, and record or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--record", action="store_true", help="write gate.json")
    parser.add_argument("--only", default=",".join(NAMES), metavar="NAME,...")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--threads", type=int, default=min(2, machine.cores()))
    parser.add_argument("--timeout", type=float, default=150.0, help="seconds of one run")
    options = parser.parse_args()
    found = measured(options.only.split(","), options)
    if not found:
        sys.exit(f"error: none of {options.only} is in {problems.data_folder()}")
    if options.record:
        RECORD.write_text(
            json.dumps({"version": bundle.__version__, "leads": found}, indent=1) + "\n"
        )
        print(f"Recorded {len(found)} leads in {RECORD.name}.")
        return
    record = json.loads(RECORD.read_text())
    lines = [
        [name, f"{lead:.1f}x", f"{record['leads'][name]:.1f}x" if name in record["leads"] else ""]
        for name, lead in found.items()
    ]
    print(table.grid(["problem", "lead over pycolmap", record["version"]], lines))
    late = slower(found, record["leads"])
    if late:
        sys.exit(f"error: slower than {record['version']} on {', '.join(late)}")


if __name__ == "__main__":
    main()
