"""Checkpoints of a refinement in slices. Rank 0 writes the same files as a single process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.model.estimates import estimates
from bundle.model.problem import Problem
from bundle.solving.result import Result
from bundle.solving.rounds.checkpoint import check_target, read_by, result_of_record, write
from bundle.solving.rounds.input_digest import digest_of_parts, plain_fingerprint
from bundle.solving.rounds.run_state import State
from bundle.solving.slices.slice_reading import Survey


@dataclass
class Kept:
    """Content of a checkpoint.

    Attributes:
        state: arrays of the entire model, by the names in ``estimates.VARIABLES``.
        so_far: result of the adjustment so far; its problem has no points.
        has_ended: True if nothing is left to do.
    """

    state: dict[str, Any]
    so_far: Result | None
    has_ended: bool


class SlicedCheckpoint:
    """The checkpoint of a run.

    Args:
        path: path of the file.
        cameras: images and cameras of the model as it was read.
        sums: sums over the model's rows (``input_digest.sums_of_rows``).
        found: survey of the model.
        options: options of the run, as the caller gave them.
        interval: iterations from one checkpoint to the next.

    Raises:
        InputError, OSError: for the reasons of ``checkpoint.check_target``.
    """

    def __init__(
        self,
        path: Path,
        cameras: Problem,
        sums: NDArray[np.uint64],
        found: Survey,
        options: SolveOptions,
        interval: int,
    ) -> None:
        check_target(path)
        self._path, self._cameras, self._found = path, cameras, found
        self._fingerprint = plain_fingerprint(digest_of_parts(cameras, sums), options, interval)

    def write(self, result: Result, *, has_ended: bool = False) -> None:
        """Replace the checkpoint by the state after a result, from which the next solve starts.

        Raises:
            OSError: the system refuses: no permission, disk full.
        """
        state = State(
            problem=result.problem,
            observation_mask=np.broadcast_to(True, self._found.num_observations),
            point_mask=np.broadcast_to(True, len(self._found.owner)),
            so_far=result,
            end=result if has_ended else None,
        )
        write(self._path, state, self._fingerprint)

    def read(self, path: Path, options: SolveOptions) -> Kept:
        """Return the content of a checkpoint of this run; ``options`` are the options as used.

        Raises:
            InputError, OSError: for the reasons of ``checkpoint.read``.
        """

        def kept(meta: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Kept:
            expected = {name: of.shape for name, of in estimates(self._cameras).items()}
            expected["points"] = (len(self._found.owner), 3)
            state = {name: freeze(np.array(arrays[name], np.float64)) for name in expected}
            for name, shape in expected.items():
                if state[name].shape != shape or not np.isfinite(state[name]).all():
                    raise ValueError(f"{name}: expected shape {shape}, found {state[name].shape}")
            so_far = meta["so_far"]
            if so_far is not None:
                so_far = result_of_record(so_far, arrays, self._cameras, options)
            return Kept(state, so_far, bool(meta["has_ended"]))

        return read_by(kept, path, self._fingerprint)
