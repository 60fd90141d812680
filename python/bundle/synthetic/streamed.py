"""A scene written to BAL files as it is made, so that it never is in memory as a whole.

Both files, the start and the ground truth, have the same observations, which are formatted once.
In a BAL file points come after all observations: until then they wait in files without a name,
in the folders of the output. In memory are the images, the blocks that are being made and their
tally.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.io import bal
from bundle.io.atomic import atomic_write as atomic
from bundle.synthetic.blocks import SceneInBlocks
from bundle.synthetic.scene_tally import ErrorTally, SceneTally
from bundle.synthetic.start import Start, median_distance

__all__ = ["write_bal_scene"]

# Of the points that wait, read at a time.
_POINTS_AT_A_TIME = 1 << 20


def write_bal_scene(
    scene: SceneInBlocks,
    path: Path,
    truth_path: Path,
    progress: Callable[[float], None] | None = None,
) -> SceneTally:
    """Write the start of a scene and its ground truth, as ``synthesize`` makes them.

    Args:
        scene: what to make.
        path: of the start, a BAL file that is not compressed.
        truth_path: of the ground truth, likewise.
        progress: called with the share of the points that is done, after each block.

    Returns:
        What was written, counted.

    Raises:
        InputError: the scene cannot be made, see ``synthesize``; a BAL file cannot hold its
            cameras; a path cannot be replaced.
        OSError: a file cannot be written. Whatever goes wrong, neither of the files is there.
    """
    options, truth = scene.options, scene.images()
    bal.radial_params(truth)
    tally = SceneTally(truth.num_images)
    errors = {"start": ErrorTally(), "ground_truth": ErrorTally()}
    with ExitStack() as stack:
        # The one that was entered last is put into place first.
        paths = [stack.enter_context(atomic.replace_file(name)) for name in (path, truth_path)]
        waiting = [stack.enter_context(tempfile.TemporaryFile(dir=name.parent)) for name in paths]
        stream = _core.BalStream(list(paths), truth.num_images, options.num_points)
        start: Start | None = None
        moved = truth
        for block in scene.blocks():
            part = scene.part(truth, block)
            if start is None:
                start = Start(
                    scene.start_seed, truth, scene.cameras, median_distance(part), options
                )
                state = {"cam_from_world": start.cam_from_world}
                moved = truth.replace(**state, camera_params=start.camera_params)
            started = start.points(block.points)
            started.tofile(waiting[0])
            block.points.tofile(waiting[1])
            stream.add_observations(bal.radial_params(truth), block.image, block.point, block.xy)
            tally.add(block.image, part.observation_point, block.is_outlier)
            errors["start"].add(scene.part(moved, block).replace(points=started))
            errors["ground_truth"].add(part)
            if progress is not None:
                progress((block.first_point + len(block.points)) / options.num_points)
        for file, (problem, points) in enumerate(zip((moved, truth), waiting, strict=True)):
            stream.add_cameras(file, problem.cam_from_world, bal.radial_params(problem))
            for some in _read_points(points):
                stream.add_points(file, some)
        stream.close()
    tally.errors = {name: found.statistics() for name, found in errors.items()}
    return tally


def _read_points(file: IO[bytes]) -> Iterator[NDArray[np.float64]]:
    """Yield all points (n, 3) of a file, some at a time."""
    file.seek(0)
    while len(some := np.fromfile(file, np.float64, 3 * _POINTS_AT_A_TIME)):
        yield some.reshape(-1, 3)
