"""Damaged files: each is refused in one line, or loads and is then solved, described and saved.

python -m tests.campaigns.mutants COUNT [SEED]
"""

from __future__ import annotations

import json
import random
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

import bundle
from bundle.analysis.statistics.description import describe
from tests import scenes
from tests.campaigns import jobs
from tests.io.formats import foreign_files as foreign
from tests.io.mutations import BYTE_MUTATORS, TOKEN_MUTATORS, mutate

STEPS = 2


def sources(folder: Path) -> list[tuple[Path, Path, bool]]:
    """Make small originals and return (what is loaded, the file to damage, is it text)."""
    import pycolmap

    binary, text = folder / "binary", folder / "text"
    bundle.save(scenes.make_problem(num_images=4, num_points=15), binary)
    text.mkdir()
    pycolmap.Reconstruction(binary).write_text(text)
    bal = folder / "problem.txt"
    bundle.save(scenes.scene(num_images=4, num_points=15), bal)
    found = [(binary, path, False) for path in sorted(binary.glob("*.bin"))]
    found += [(text, path, True) for path in sorted(text.glob("*.txt"))]
    return [*found, (bal, bal, True), *foreign_sources(folder)]


def foreign_sources(folder: Path) -> list[tuple[Path, Path, bool]]:
    """The same for files of other programs."""
    own, shared = foreign.small(num_points=15), foreign.small(num_points=15, shared=True)
    bundler, nvm, openmvg = (folder / name for name in ("bundle.out", "model.nvm", "sfm.json"))
    foreign.write_bundler(own, bundler, unregistered=(1,))
    foreign.write_nvm(foreign.small("SIMPLE_PINHOLE", num_points=15), nvm)
    foreign.write_openmvg(shared, openmvg)
    opensfm = folder / "opensfm"
    foreign.write_opensfm(shared, opensfm)
    single = [(path, path, True) for path in (bundler, nvm, openmvg)]
    return single + [(opensfm, path, True) for path in sorted(opensfm.iterdir())]


def write_mutants(folder: Path, count: int, seed: int) -> list[str]:
    """Write `count` damaged copies into `folder`; return the paths to load."""
    (folder / "originals").mkdir()
    originals = sources(folder / "originals")
    paths = []
    for index, (load, damaged, is_text) in enumerate(originals):
        mine = count // len(originals) + (index < count % len(originals))
        mutators = (*TOKEN_MUTATORS, *BYTE_MUTATORS) if is_text else BYTE_MUTATORS
        for name, data in mutate(damaged.read_bytes(), mutators, mine, seed + index):
            target = folder / f"{index:02d}-{damaged.name}-{name}"
            if load.is_dir():
                shutil.copytree(load, target)
                (target / damaged.name).write_bytes(data)
            else:
                target = target.with_suffix(".txt")
                target.write_bytes(data)
            paths.append(str(target))
    random.Random(seed).shuffle(paths)
    return paths


def exercise(path: str) -> str:
    """Load one path; what loads is described, solved by both backends and saved."""
    problem = bundle.load(path)
    describe(problem)
    for backend in ("auto", "ceres"):
        result = bundle.solve(problem, max_num_iterations=STEPS, backend=backend, num_threads=1)
        assert_honest(result)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / ("saved.txt" if problem.format == "bal" else "saved")
        bundle.save(result.problem, target)
        bundle.load(target)
    return "loaded"


def assert_honest(result: bundle.Result) -> None:
    """A usable solution is finite, and its cost is not above that of the start."""
    summary = result.summary
    json.dumps(summary.warnings)
    if not summary.is_solution_usable:
        return
    for name in ("cam_from_world", "camera_params", "points"):
        assert np.isfinite(getattr(result.problem, name)).all(), f"{name} is not finite"
    assert np.isfinite(summary.final_cost), f"usable with the cost {summary.final_cost}"
    assert summary.final_cost <= summary.initial_cost * (1 + 1e-12), (
        f"usable, from {summary.initial_cost} to {summary.final_cost}"
    )


def campaign(count: int, seed: int = 0) -> list[jobs.Outcome]:
    """Make and exercise `count` mutants."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_mutants(Path(folder), count, seed)
        return jobs.run(f"{__spec__.name if __spec__ else __name__}:exercise", paths)


if __name__ == "__main__":
    print(jobs.summarise(campaign(int(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else 0)))
