"""Damaged tracks that ``bundle.refine_tracks`` restores, against the truth.

    BUNDLE_DATA=... python -m tests.campaigns.tracks [WORK_FOLDER] [FIRST_SEED]

Five damages (tests/track_scenes.py) of

- a synthetic scene of COLMAP: 40 images, 1,500 points, noise of 0.7 px, 95 % of the matches right;
- lund_door: a database made from its 12 photographs by COLMAP's SIFT and exhaustive matching, and
  the model that COLMAP's mapper makes of it;
- crane_mast, whose photographs are not shared: a database of its keypoints, whose matches are all
  pairs of its tracks, and its model.

The truth is exact for the synthetic scene. For the others it is the model with all tracks, refined.
The table has observations and points (start, end, truth), the held-out error of a solve alone and
of these tracks, and the RMSE of the centres against the truth in thousandths of the scene's size,
for a solve alone and for these tracks. The exit code is 1 if the held-out error or the centres of
one are worse with these tracks, by more than 2 % and 5 %.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap

import bundle
from tests.track_scenes import DAMAGES, damaged, synthesize, write_database

HEAD = (
    "| model | damage | observations | points | held out [px] | centres [1/1000] |\n"
    "|---|---|---|---|---|---|"
)


class Scene(NamedTuple):
    """A model with all its tracks, and its database."""

    name: str
    truth: bundle.Problem
    database: Path


class Row(NamedTuple):
    """Observations and points (start, end, truth), and errors (alone, with tracks)."""

    observations: tuple[int, int, int]
    points: tuple[int, int, int]
    held_out: tuple[float, float]
    centres: tuple[float, float]

    @property
    def is_worse(self) -> bool:
        """True if tracks made an error larger."""
        held, centres = self.held_out, self.centres
        return held[1] > 1.02 * held[0] or centres[1] > 1.05 * centres[0]

    def cells(self) -> list[str]:
        """Return the cells of the table."""
        counts = [" / ".join(f"{count:,}" for count in row) for row in self[:2]]
        held, centres = (f"{before:.3f} -> {after:.3f}" for before, after in self[2:])
        return [*counts, held, centres]


def of_photographs(name: str, folder: Path, data: Path) -> Scene:
    """Make a database and a model of the photographs of a shared model."""
    database, images = folder / f"{name}.db", data / "colmap" / name / "images"
    if not database.exists():
        pycolmap.set_random_seed(0)
        one = pycolmap.CameraMode.SINGLE
        pycolmap.extract_features(database, images, camera_mode=one)
        pycolmap.match_exhaustive(database)
    options = pycolmap.IncrementalPipelineOptions(
        random_seed=0, multiple_models=False, extract_colors=False
    )
    output = folder / f"{name}_mapped"
    output.mkdir(exist_ok=True)
    model = pycolmap.incremental_mapping(database, images, output, options)[0]
    return Scene(name, bundle.solve(model).problem, database)


def of_tracks(name: str, folder: Path, data: Path) -> Scene:
    """Make a database of the keypoints and tracks of a shared model."""
    path = folder / f"{name}.db"
    problem = bundle.filter_observations(bundle.solve(data / "colmap" / name).problem).problem
    problem = bundle.solve(problem).problem
    write_database(problem, path)
    return Scene(name, problem, path)


def measured(scene: Scene, kind: str, seed: int = 0) -> Row:
    """Damage the tracks of a scene, restore them, and measure."""
    truth = scene.truth
    size = float(np.linalg.norm(np.ptp(truth.projection_centers, axis=0)))
    start = damaged(truth, kind, seed)
    result = bundle.refine_tracks(start, scene.database)
    alone = bundle.solve(start, loss="soft_l1").problem
    assert result.held_out is not None and result.tracks[0].held_out_rmse is not None
    parts = (start, result.problem, truth)
    return Row(
        tuple(one.num_observations for one in parts),
        tuple(one.num_points for one in parts),
        (result.tracks[0].held_out_rmse, result.held_out.clipped_rmse),
        tuple(
            1000 * bundle.evaluate(one, truth).position.rmse / size
            for one in (alone, result.problem)
        ),
    )


def scenes(folder: Path, data: Path | None) -> Iterator[Scene]:
    """Yield the synthetic scene and, with data, the real ones."""
    made = Path(tempfile.mkdtemp(dir=folder))
    truth = synthesize(made, num_frames_per_rig=40, num_points3D=1500, track_length=20)
    yield Scene("synthetic", truth, made / "database.db")
    if data is not None:
        yield of_photographs("lund_door", folder, data)
        yield of_tracks("crane_mast", folder, data)


def main(folder: Path, seed: int) -> int:
    """Print the table; return the exit code."""
    data = os.environ.get("BUNDLE_DATA")
    print(HEAD)
    worse = 0
    for scene in scenes(folder, None if data is None else Path(data)):
        for kind in DAMAGES:
            row = measured(scene, kind, seed)
            worse += row.is_worse
            mark = " (worse)" if row.is_worse else ""
            print(f"| {' | '.join([scene.name, kind, *row.cells()])}{mark} |", flush=True)
    return int(worse > 0)


if __name__ == "__main__":
    pycolmap.logging.minloglevel = 2
    FOLDER = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="bundle-tracks-"))
    FOLDER.mkdir(exist_ok=True, parents=True)
    sys.exit(main(FOLDER, int(sys.argv[2]) if len(sys.argv) > 2 else 0))
