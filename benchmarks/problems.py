"""Which problems there are to measure: every BAL file and COLMAP model under the data folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class BenchmarkProblem:
    """A problem on disk; ``kind`` is "bal" or "colmap"."""

    name: str
    kind: str
    path: Path


def data_folder() -> Path:
    """Return BUNDLE_DATA, by default the folder beside the repository."""
    return Path(os.environ.get("BUNDLE_DATA", ROOT.parent / "shared" / "data")).resolve()


def find(folder: Path) -> list[BenchmarkProblem]:
    """Return the BAL files (bal/problem-*.txt*), then the models (colmap/*), each by name."""
    files = sorted((folder / "bal").glob("problem-*.txt*"))
    found = [BenchmarkProblem(_bal_name(path), "bal", path) for path in files]
    for model in sorted((folder / "colmap").glob("*")):
        if any(model.glob("cameras.*")):
            found.append(BenchmarkProblem(model.name, "colmap", model))
    return found


def _bal_name(path: Path) -> str:
    """problem-16-22106-pre.txt.bz2 -> 16-22106."""
    return path.name.split(".")[0].removeprefix("problem-").removesuffix("-pre")
