"""Refinement of a model whose observations and points are on disk.

The core allocates their arrays in files of the scratch folder (``cpp/core/scratch``), and one
process has the only slice. The result equals that of a model in memory, bit for bit.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.interface.solve_record import Progress
from bundle.io import colmap
from bundle.solving.kept_errors import PixelErrors
from bundle.solving.prepare import Executor, Prepared
from bundle.solving.result import Result
from bundle.solving.slices.scratch_size import RESIDENT_BYTES, refuse_small_disk
from bundle.solving.slices.slice_errors import measure_on_disk, point_errors_on_disk, rmse_on_disk
from bundle.solving.slices.slice_process import Process
from bundle.solving.slices.slice_reading import Survey
from bundle.solving.slices.sliced_refinement import SliceCrew, SlicedRefinement, SliceJob


@contextmanager
def scratch_folder(folder: str) -> Iterator[None]:
    """Allocate the large arrays of the core in files of a folder."""
    if not Path(folder).is_dir():
        raise InputError(f"--out-of-core: expected a folder, found {shown(folder)}")
    try:
        _core.open_scratch(os.fsencode(folder), RESIDENT_BYTES)
    except _core.InputError as error:
        raise InputError(f"--out-of-core: {error}") from None
    try:
        yield
    finally:
        _core.close_scratch()


class LoneMeeting:
    """One process alone; see ``slice_reading.Meeting``."""

    rank = 0
    num_ranks = 1

    def broadcast(self, value: Any = None) -> Any:
        """Return the value."""
        return value

    def gather(self, value: Any) -> list[Any]:
        """Return the value, of the only rank."""
        return [value]

    def ranks(self) -> Any:
        """Raise an error: the solve is not divided."""
        raise NotImplementedError


class LoneCrew:
    """One process alone; see ``sliced_refinement.SliceCrew``."""

    num_ranks = 1
    is_solving = False
    is_told_to_end = False

    def meeting(self) -> LoneMeeting:
        """Return the communication of the only rank."""
        return LoneMeeting()

    def send_to_all(self, job: SliceJob) -> None:
        """Do nothing: there are no others."""

    def release(self) -> None:
        """Do nothing: there are no others."""


class LoneProcess(Process):
    """Process with the complete model on disk."""

    def adjust(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """Return the output of the core from the current values.

        Ceres would keep the problem in memory, so the backend is fused.
        """
        options = prepared.layout.options.asdict() | {"backend": "fused"}
        output = _core.solve(self._part, options, progress, None, None)
        self._move(output)
        return output

    def point_errors(self, num_threads: int) -> list[NDArray[np.float64]]:
        """Return the mean error of each point, as defined in COLMAP's files."""
        found = self._errors_now(num_threads, "auto")
        part = self._part
        lost = colmap.NO_PROJECTION
        return [point_errors_on_disk(*found, part.observation_point, len(part.points), lost)]

    def rmse_global_shutters(self, options: dict[str, Any]) -> float:
        """Return the RMSE at the input if all shutters were global, in pixels."""
        part, cheirality = self.slice.part, options["cheirality"]
        part = part._moved(rolling_shutter=None)
        found = _core.reprojection_errors(part, options["num_threads"], cheirality)
        return rmse_on_disk(PixelErrors(*found, cheirality))

    def _measured(self, before: PixelErrors, after: PixelErrors, limit: float | None) -> Any:
        return measure_on_disk(before, after, limit)


@dataclass(frozen=True)
class OneSlice:
    """Executor on the slice of the only process."""

    process: LoneProcess

    def run(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """See :meth:`Executor.run`."""
        return self.process.adjust(prepared, progress)


class OutOfCoreRefinement(SlicedRefinement):
    """Refinement by one process within :func:`scratch_folder`; see ``SlicedRefinement``."""

    def __init__(self, path: Path, folder: str) -> None:
        self._folder = folder
        super().__init__(cast(SliceCrew, LoneCrew()), path)  # it sends no parts

    def _started(self, crew: SliceCrew, found: Survey) -> tuple[Process, Executor]:
        refuse_small_disk(self._folder, found.num_observations, len(found.owner))
        self._lone = LoneProcess(crew.meeting(), self._path, found)
        return self._lone, OneSlice(self._lone)

    def measure(self, result: Result) -> None:
        """See :meth:`SlicedRefinement.measure`."""
        super().measure(result)
        if result.problem.rolling_shutter is not None:
            vars(result)["rmse_global_shutters"] = self._lone.rmse_global_shutters(self._options)
