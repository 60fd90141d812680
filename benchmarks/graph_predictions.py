"""Predicted steps of pose graphs against measured ones.

    python -m benchmarks.graph_predictions [--few] [--threads N] [--json FILE]

The graphs are the eight of the shared data and 60 seeded ones: chains, grids, closures nearby and
anywhere, hubs, with 100 to 100,000 poses in the plane and in space. Each is solved with the natural
order, AMD and METIS. The rates of the machine are measured anew first. The target: at least 90 % of
the predictions are within a factor 1.3 of the shortest step. Steps that would take longer than
``LONGEST`` are listed, not solved. On one thread a long step counts its processor time.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import bundle
from benchmarks.problems import data_folder
from bundle.planning.inspection.graph_rates import made_graph, step_time
from bundle.planning.inspection.machine_rates import graph_rates

SHARED = (
    *("tinyGrid3D", "smallGrid3D", "parking-garage", "sphere2500"),
    *("intel", "M3500", "CSAIL", "MIT"),
)
KINDS = ("chain", "grid", "near", "loops", "hubs")
POSES = (100, 400, 1600, 6000, 25_000, 100_000)
SIZES = (3, 6)
ORDERS = ("natural", "amd", "metis")
LONGEST = 20.0
FACTOR, SHARE = 1.3, 0.9


@dataclass(frozen=True)
class Row:
    """One graph in one order.

    Attributes:
        graph: name of the graph.
        ordering: elimination order.
        predicted: seconds of a step.
        measured: seconds; NaN if the step was not solved.
    """

    graph: str
    ordering: str
    predicted: float
    measured: float

    @property
    def ratio(self) -> float:
        """Predicted over measured time."""
        return self.predicted / self.measured


def graphs(*, few: bool) -> Iterator[tuple[str, bundle.PoseGraph]]:
    """Yield the graphs by name; with ``few`` three shared ones and the seeded ones up to 1,600."""
    for name in SHARED[:3] if few else SHARED:
        yield name, bundle.load(data_folder() / "g2o" / f"{name}.g2o.bz2")
    seed = 1000
    for kind in KINDS:
        for count in POSES[:3] if few else POSES:
            for size in SIZES:
                seed += 1
                name = f"{kind}-{count}-{'2d' if size == 3 else '3d'}"
                yield name, made_graph(kind, count, size, seed=seed)


def rows_of(name: str, graph: bundle.PoseGraph, threads: int) -> list[Row]:
    """Predict and measure a step of a graph in each order."""
    found = bundle.inspect(graph, num_threads=threads)
    rows = []
    for cost in found.costs:
        if cost.ordering not in ORDERS:
            continue
        predicted = cost.time_per_step_in_seconds
        measured = math.nan
        if predicted < LONGEST:
            measured = step_time(graph, cost.ordering, threads)
        rows.append(Row(name, cost.ordering, predicted, measured))
    print(".", end="", file=sys.stderr, flush=True)
    return rows


def verdict(rows: Sequence[Row]) -> str:
    """Return the share of predictions within the factor, and whether the target is met."""
    known = [row for row in rows if math.isfinite(row.measured)]
    if not known:
        return "No step was measured."
    near = [row for row in known if 1 / FACTOR <= row.ratio <= FACTOR]
    share = len(near) / len(known)
    words = "met" if share >= SHARE else "missed"
    return (
        f"{len(near)} of {len(known)} predictions are within a factor {FACTOR} ({100 * share:.0f} "
        f"%, target {100 * SHARE:.0f} %: {words}); {len(rows) - len(known)} steps not solved."
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, the worst last; return 0 if the target is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--few", action="store_true", help="small graphs only: a minute")
    parser.add_argument("--threads", type=int, default=1, help="threads of every solve")
    parser.add_argument("--json", type=Path, help="also write all rows")
    given = parser.parse_args(arguments)
    graph_rates(given.threads, recalibrate=True)
    rows = [
        row for name, graph in graphs(few=given.few) for row in rows_of(name, graph, given.threads)
    ]
    print(file=sys.stderr)
    print("| graph | order | predicted | measured | ratio |\n|---|---|---|---|---|")
    for row in sorted(rows, key=lambda row: abs(math.log(row.ratio)) if row.ratio > 0 else -1.0):
        print(
            f"| {row.graph} | {row.ordering} | {1e3 * row.predicted:.4g} ms | "
            f"{1e3 * row.measured:.4g} ms | {row.ratio:.2f} |"
        )
    said = verdict(rows)
    print(said)
    if given.json is not None:
        given.json.write_text(json.dumps([asdict(row) for row in rows]))
    return 0 if "(" in said and ": met)" in said else 1


if __name__ == "__main__":
    sys.exit(main())
