"""Digests of an input: which image observes which point, the measurements, and the start.

Two reports compare them. Equal digests prove that a difference of two solves has another cause;
separate digests distinguish changed data from a changed start.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.model.estimates import estimates

if TYPE_CHECKING:
    from bundle.model.pose_graph_arrays import PoseGraph
    from bundle.model.problem import Problem
    from bundle.model.sequence.sequence import Sequence

PARTS = {
    "Problem": {
        "structure": ("observation_image", "observation_point"),
        "measurements": ("observation_xy", "observation_sigma"),
        "start": (),  # all that a solve estimates
    },
    "PoseGraph": {
        "structure": ("ids", "edges", "fixed"),
        "measurements": ("measurements", "information"),
        "start": ("poses",),
    },
    "Sequence": {
        "structure": ("track_timestamps_ns", "track_ids"),
        "measurements": ("gyro", "accel", "imu_timestamps_ns", "xy", "calibration"),
        "start": (),
    },
}
"""Attributes in each digest, by the class of the input."""


def content_digests(given: Problem | PoseGraph | Sequence) -> dict[str, str]:
    """Return a digest of 16 hexadecimal digits for structure, measurements and start."""
    classes = (kind.__name__ for kind in type(given).__mro__)
    parts = next(PARTS[name] for name in classes if name in PARTS)
    values = {name: [getattr(given, one) for one in names] for name, names in parts.items()}
    if parts is PARTS["Problem"]:
        values["start"] = [array for array in estimates(given).values() if len(array)]
    return {name: _digest(of) for name, of in values.items()}


def _digest(values: list[Any]) -> str:
    """Return two checksums of 32 bits, which detect changes but no forgeries."""
    sums = 0, 1
    for value in values:
        is_array = isinstance(value, np.ndarray)
        head = f"{value.dtype.str} {value.shape}" if is_array else repr(value)
        for part in (head.encode(), np.ascontiguousarray(value).data if is_array else b""):
            sums = zlib.crc32(part, sums[0]), zlib.adler32(part, sums[1])
    return "".join(f"{value:08x}" for value in sums)
