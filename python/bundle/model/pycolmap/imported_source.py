"""Data of a file of another program that its problem lacks.

COLMAP models and BAL files have sources of their own (``problem_source``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.colmap.source_records import SourceRecords


@dataclass(frozen=True, eq=False, kw_only=True)
class ImportedSource:
    """Source of a problem that was read from a file of another program.

    Attributes:
        point_ids: (num_points,) ids of the points of the file.
        point_colors: (num_points, 3) red, green, blue.
        source_rmse: reprojection RMSE in pixels by the formula of the other program.
        rmse: the same by the formula of this package.
        notes: sentences about data of the file that the problem lacks or approximates.
        data: values by name that the writer of the same format uses again.
    """

    point_ids: NDArray[np.int64]
    point_colors: NDArray[np.uint8]
    source_rmse: float = float("nan")
    rmse: float = float("nan")
    notes: tuple[str, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    def records(self) -> SourceRecords:
        """Return the records of COLMAP that this source has: the colours."""
        empty = SourceRecords()

        def contents() -> Any:
            return dataclasses.replace(
                empty.contents(),
                point_ids=self.point_ids,
                point_colors=self.point_colors,
                track_lengths=np.zeros(len(self.point_ids), np.int64),
            )

        return SourceRecords(contents=contents)


def imported_source(problem: Any) -> ImportedSource | None:
    """Return the source of a problem that was read from a file of another program, or None.

    Unlike ``problem.source``, this does not convert a COLMAP model to a reconstruction.
    """
    source = vars(problem)["source"]
    return source if isinstance(source, ImportedSource) else None
