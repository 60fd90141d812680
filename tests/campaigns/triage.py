"""Seeded faults that `bundle triage` names, and repeated solves in which it finds only noise.

Every fault is real: the input or the command is changed, both are solved, and both reports are
compared. The exceptions are times, because a test cannot slow its machine down.

python -m tests.campaigns.triage [SEED]
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bundle
from bundle.judging.triage.triage_result import Triage
from tests.campaigns.triage_faults import (
    cautious,
    dense_prior,
    far_start,
    noisy,
    noisy_imu,
    optimistic_closure,
    outliers,
    turned_measurement,
    wrong_closures,
    wrong_mount,
    wrong_tracks,
)
from tests.campaigns.triage_inputs import Workshop


def slower(report: Path, factor: float, **environment: Any) -> Path:
    """The same report with all times longer, as on another machine."""
    content = json.loads(report.read_text())

    def stretched(value: Any, name: str = "") -> Any:
        if isinstance(value, dict):
            return {key: stretched(entry, key) for key, entry in value.items()}
        if isinstance(value, list):
            return [stretched(entry, name) for entry in value]
        is_time = "time" in name or name in ("solve", "total", "build", "save", "load")
        return value * factor if is_time and isinstance(value, float) and value > 0 else value

    options = content["options"]
    content = stretched(content)
    content["options"] = options
    quiet = {"load_before": 0.0, "waiting": 0.0, "preemptions": 0}
    content["environment"] |= {**quiet, **environment}
    path = report.with_name(f"{report.stem}-slower.json")
    path.write_text(json.dumps(content))
    return path


NEAR_START = ("--init", "file")
PAIRS: dict[str, tuple[str, Callable[[Workshop], tuple[Path, Path]]]] = {
    "natural order of a graph": (
        "ordering",
        lambda w: (
            w.run("refine", w.graph(), "--pose-ordering", "metis"),
            w.run("refine", w.graph(), "--pose-ordering", "natural"),
        ),
    ),
    "cameras first in a model": (
        "ordering",
        lambda w: (
            w.run("refine", w.model(), "--solver", "sparse-schur", "--backend", "ceres"),
            w.run(
                *("refine", w.model(), "--solver", "sparse-normal-cholesky", "--backend", "ceres"),
                *("--ordering", "cameras-first"),
            ),
        ),
    ),
    "marginalised landmark": (
        "prior-densifies",
        lambda w: (w.run("refine", w.graph()), w.run("refine", w.graph(dense_prior))),
    ),
    "closures between far places": (
        "fill",
        lambda w: (w.run("refine", w.local_graph(30)), w.run("refine", w.local_graph(0))),
    ),
    "wrong closures": (
        "data",
        lambda w: (w.run("refine", w.graph()), w.run("refine", w.graph(wrong_closures))),
    ),
    "a closure with an optimistic covariance": (
        "data",
        lambda w: (w.run("refine", w.graph()), w.run("refine", w.graph(optimistic_closure))),
    ),
    "angles of another convention": (
        "data",
        lambda w: (w.run("refine", w.graph()), w.run("refine", w.graph(turned_measurement))),
    ),
    "information 52 times too cautious": (
        "data",
        lambda w: (w.run("refine", w.graph()), w.run("refine", w.graph(cautious))),
    ),
    "no loss against wrong closures": (
        "options",
        lambda w: (
            w.run("refine", w.graph(wrong_closures), "--loss", "gnc-tls"),
            w.run("refine", w.graph(wrong_closures)),
        ),
    ),
    "another error of edges": (
        "options",
        lambda w: (
            w.run("refine", w.graph(wrong_closures)),
            w.run("refine", w.graph(wrong_closures), "--error", "g2o"),
        ),
    ),
    "one step only": (
        "options",
        lambda w: (
            w.run("refine", w.graph(), *NEAR_START),
            w.run("refine", w.graph(), *NEAR_START, "--max-iterations", "1"),
        ),
    ),
    "a wrong Jacobian": (
        "jacobian",
        lambda w: (w.factor_report(1.0), w.factor_report(-1.0)),
    ),
    "a Jacobian with which every step succeeds": (
        "jacobian",
        lambda w: (w.factor_report(1.0), w.factor_report(0.0)),
    ),
    "cameras first, without a count of the factor": (
        "ordering",
        lambda w: (
            w.run("refine", w.model(), "--solver", "sparse-schur", "--backend", "ceres"),
            w.run(
                *("refine", w.model(), "--solver", "sparse-schur", "--backend", "ceres"),
                *("--ordering", "cameras-first"),
            ),
        ),
    ),
    "rounds of filtering": (
        "options",
        lambda w: (
            w.run("refine", w.model(outliers)),
            w.run("refine", w.model(outliers), "--rounds", "2"),
        ),
    ),
    "one lens for all images": (
        "options",
        lambda w: (
            w.run("refine", w.model(noisy)),
            w.run("refine", w.model(noisy), "--share-cameras", "all"),
        ),
    ),
    "three times slower": (
        "machine",
        lambda w: (first := slower(w.run("refine", w.graph()), 100.0), slower(first, 3.0)),
    ),
    "another processor": (
        "machine",
        lambda w: (
            first := slower(w.run("vio", w.flight()), 2.0),
            slower(first, 5.0, cpu_model="a slow one"),
        ),
    ),
    "outliers in a model": (
        "data",
        lambda w: (w.run("refine", w.model()), w.run("refine", w.model(outliers))),
    ),
    "noisier keypoints": (
        "data",
        lambda w: (w.run("refine", w.model()), w.run("refine", w.model(noisy))),
    ),
    "focal lengths held": (
        "options",
        lambda w: (
            w.run("refine", w.model()),
            w.run("refine", w.model(), "--refine", "poses,points"),
        ),
    ),
    "a start far away": (
        "convergence",
        lambda w: (w.run("refine", w.model()), w.run("refine", w.model(far_start))),
    ),
    "wrong closures in a comparison": (
        "data",
        lambda w: (
            w.run("compare", w.graph(), "--repeat", 1, "--backends", "fused"),
            w.run("compare", w.graph(wrong_closures), "--repeat", 1, "--backends", "fused"),
        ),
    ),
    "a prior dropped": (
        "options",
        lambda w: (w.run("vio", w.flight()), w.run("vio", w.flight(), "--marginalize", "drop")),
    ),
    "Jacobians at current estimates": (
        "jacobian",
        lambda w: (
            w.run("vio", w.flight(), "--nullity"),
            w.run("vio", w.flight(), "--nullity", "--jacobians", "current"),
        ),
    ),
    "IMU trusted too much": (
        "options",
        lambda w: (
            w.run("vio", w.flight(noisy_imu), "--imu-noise-scale", "20"),
            w.run("vio", w.flight(noisy_imu), "--imu-noise-scale", "1"),
        ),
    ),
    "wrong tracks": (
        "data",
        lambda w: (w.run("vio", w.flight()), w.run("vio", w.flight(wrong_tracks))),
    ),
    "camera turned on the IMU": (
        "data",
        lambda w: (w.run("vio", w.flight()), w.run("vio", w.flight(wrong_mount))),
    ),
    "a vibrating IMU": (
        "data",
        lambda w: (w.run("vio", w.flight()), w.run("vio", w.flight(noisy_imu))),
    ),
    "a short window": (
        "options",
        lambda w: (w.run("vio", w.flight()), w.run("vio", w.flight(), "--window", 4)),
    ),
}
"""Faults by name: the cause that must be named first, and both reports."""

NOISE: dict[str, Callable[[Workshop], tuple[Path, Path]]] = {
    **{
        f"a graph, {' '.join(flags) or 'by default'}": (
            lambda w, flags=flags: (
                w.run("refine", w.graph(), *flags, "--threads", 2),
                w.run("refine", w.graph(), *flags, "--threads", 1),
            )
        )
        for flags in (
            (),
            ("--loss", "dcs"),
            ("--backend", "ceres"),
            ("--init", "file"),
            ("--pose-ordering", "metis"),
            ("--trust-region", "dogleg"),
        )
    },
    **{
        f"a model, {' '.join(flags) or 'by default'}": (
            lambda w, flags=flags: (
                w.run("refine", w.model(), *flags, "--threads", 2),
                w.run("refine", w.model(), *flags, "--threads", 1),
            )
        )
        for flags in (
            (),
            ("--loss", "cauchy"),
            ("--backend", "ceres"),
            ("--solver", "iterative-schur"),
            ("--trust-region", "dogleg"),
            ("--refine", "poses,points"),
        )
    },
    "odometry": lambda w: (w.run("vio", w.flight()), w.run("vio", w.flight())),
    "odometry with its nullity": (
        lambda w: (w.run("vio", w.flight()), w.run("vio", w.flight(), "--nullity"))
    ),
    "a comparison": lambda w: (
        w.run("compare", w.graph(), "--repeat", 1),
        w.run("compare", w.graph(), "--repeat", 1),
    ),
    "a little slower": lambda w: (
        first := slower(w.run("refine", w.graph()), 100.0),
        slower(first, 1.4),
    ),
    "another processor, not slower": lambda w: (
        first := w.run("refine", w.graph()),
        slower(first, 1.2, cpu_model="another one"),
    ),
    "another name": lambda w: (
        w.run("refine", first := w.graph()),
        w.run("refine", shutil.copy(first, first.with_name("copy.g2o"))),
    ),
    "a grid of poses in another order": lambda w: (
        w.run("refine", w.grid()),
        w.run("refine", w.grid(is_permuted=True)),
    ),
    "without Python's checks": lambda w: (
        w.run("refine", w.model()),
        w.run("refine", w.model(), "--no-check-solution"),
    ),
    "a factor graph": lambda w: (w.factor_report(1.0), w.factor_report(1.0)),
}
"""Pairs that differ by noise only."""


def judge(
    workshop: Workshop, pair: Callable[[Workshop], tuple[Path, Path]], **options: float
) -> Triage:
    """Solve both, and compare the reports."""
    return bundle.triage(*pair(workshop), **options)


def campaign(seed: int, folder: Path) -> Iterator[tuple[str, str, Triage]]:
    """Yield each pair with the expected cause ("" for noise), and the verdict."""
    for k, (name, (cause, pair)) in enumerate(PAIRS.items()):
        (place := folder / f"fault{k}").mkdir()
        yield name, cause, judge(Workshop(place, seed), pair)
    for k, (name, pair) in enumerate(NOISE.items()):
        (place := folder / f"noise{k}").mkdir()
        yield name, "", judge(Workshop(place, seed), pair)


if __name__ == "__main__":
    wrong = total = 0
    with tempfile.TemporaryDirectory() as where:
        for name, cause, found in campaign(int(sys.argv[1]) if sys.argv[1:] else 0, Path(where)):
            named = [one.cause for one in found.causes]
            right = cause in named[:2] if cause else not named
            total, wrong = total + 1, wrong + (not right)
            print(f"{'  ' if right else '! '}{name:42} {cause or '-':16} {', '.join(named) or '-'}")
            if not right:
                print("     ", *(one.sentence for one in found.causes), sep="\n      ")
    print(f"{total - wrong} of {total} right")
