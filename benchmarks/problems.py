"""Problems to measure: real data under the data folder, and synthetic scenes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Everything that is made once and kept: scenes, peers that are built. Ignored by git.
CACHE = ROOT / "build" / "bench"


@dataclass(frozen=True)
class BenchmarkProblem:
    """A problem on disk.

    Attributes:
        kind: "bal" or "colmap".
        is_synthetic: made by ``bundle.synthesize``.
        is_for_pair: measured with our default and pycolmap's only.
        num_images, num_observations: where they are known without reading the file; 0 otherwise.
    """

    name: str
    kind: str
    path: Path
    is_synthetic: bool = False
    num_images: int = 0
    num_observations: int = 0
    is_for_pair: bool = False


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
