"""Damaged files of other programs, against plain readers: the same arrays, or a refusal.

python -m tests.campaigns.foreign_mutants COUNT [SEED]

``mutants`` looks for crashes. Here each mutant is also read by a few lines of Python, ``json`` and
``split``, which know the format, but not the core's cursors, buffers and columns. A file that loads
must have the points and observations that the plain reader finds; a file that the plain reader
cannot parse must be refused.
"""

from __future__ import annotations

import json
import random
import shutil
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

import bundle
from tests.campaigns.mutants import foreign_sources
from tests.io.mutations import BYTE_MUTATORS, TOKEN_MUTATORS, mutate

Rows = list[list[float]]


def openmvg(path: Path) -> tuple[Rows, Rows]:
    """Return points and measurements of a scene."""
    structure = json.loads(path.read_bytes())["structure"]
    points = [landmark["value"]["X"] for landmark in structure]
    seen = [row for landmark in structure for row in landmark["value"]["observations"]]
    return points, [row["value"]["x"] for row in seen]


def opensfm(path: Path) -> tuple[Rows, Rows]:
    """Return the points of a project, and the measurements of its points and shots."""
    (content,) = json.loads((path / "reconstruction.json").read_bytes())
    lines = (path / "tracks.csv").read_bytes().decode(errors="surrogateescape").split("\n")
    rows = [line.rstrip("\r ").split("\t") for line in lines[1:]]
    known = [r for r in rows if r[0] in content["shots"] and r[1:2] and r[1] in content["points"]]
    points = [point["coordinates"] for point in content["points"].values()]
    return points, [[float(r[3]), float(r[4])] for r in known]


def tokens(path: Path) -> tuple[Rows, Rows]:
    """Return points and measurements of a Bundler or NVM file."""
    text = path.read_bytes()
    words = text.split()
    if words[0] == b"#":
        count, at = int(words[5]), 6 + 15 * int(words[4])
    else:  # a line for each camera, whose name may have spaces
        lines = [line for line in text.split(b"\n") if line.strip()]
        words = b" ".join(lines[2 + int(words[1]) :]).split()
        count, at = int(words[0]), 1
    points, measured = [], []
    for _ in range(count):
        points.append([float(word) for word in words[at : at + 3]])
        views, at = int(words[at + 6]), at + 7
        for _ in range(views):
            measured.append([float(words[at + 2]), float(words[at + 3])])
            at += 4
    return points, measured


READERS: dict[str, Callable[[Path], tuple[Rows, Rows]]] = {
    "bundle.out": tokens,
    "model.nvm": tokens,
    "sfm.json": openmvg,
    "opensfm": opensfm,
}


def verdict(path: Path, read: Callable[[Path], tuple[Rows, Rows]], name: str) -> str:
    """Return "refused" or "equal", or what is wrong."""
    try:
        problem = bundle.load(path, image_size=None if name in ("opensfm", "sfm.json") else (8, 6))
    except (bundle.InputError, OSError) as error:
        return "refused" if "\n" not in str(error) else f"two lines: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    try:
        points, measured = (np.array(rows, float) for rows in read(path))
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        return f"loaded, but not by the plain reader: {error}"
    if not np.array_equal(problem.points, points.reshape(-1, 3)):
        return "other points"
    if problem.num_observations != len(measured):
        return f"{problem.num_observations} observations, not {len(measured)}"
    xy = problem.observation_xy
    if name == "opensfm":
        sizes = problem.camera_sizes[problem.image_camera[problem.observation_image]]
        measured = measured * sizes.max(axis=1)[:, None] + sizes / 2
    elif name != "sfm.json":
        measured = measured * (1, -1 if name == "bundle.out" else 1) + np.array([4, 3])
    return "equal" if np.allclose(xy, measured, rtol=1e-12, atol=1e-9) else "other measurements"


def campaign(count: int, seed: int = 0) -> dict[str, Counter[str]]:
    """Return the numbers of verdicts on ``count`` mutants of each file."""
    found: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number, (load, damaged, _) in enumerate(foreign_sources(Path(scratch))):
            target = Path(scratch) / f"damaged{number}" / load.name
            target.parent.mkdir()
            shutil.copytree(load, target) if load.is_dir() else shutil.copy(load, target)
            file = target / damaged.name if load.is_dir() else target
            mutators = (*TOKEN_MUTATORS, *BYTE_MUTATORS)
            verdicts = found.setdefault(damaged.name, Counter())
            mutated = list(mutate(damaged.read_bytes(), mutators, count, seed + number))
            random.Random(seed).shuffle(mutated)
            for _, data in mutated:
                file.write_bytes(data)
                verdicts[verdict(target, READERS[load.name], load.name)] += 1
    return found


if __name__ == "__main__":
    results = campaign(int(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else 0)
    for name, verdicts in results.items():
        print(f"{name}: {', '.join(f'{n} {what}' for what, n in verdicts.most_common())}")
    sys.exit(any(set(verdicts) - {"refused", "equal"} for verdicts in results.values()))
