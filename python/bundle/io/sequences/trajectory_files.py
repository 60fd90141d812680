"""Tables in CSV, and trajectories: the TUM format, EuRoC's ground truth with velocities and biases.

A TUM line is ``timestamp tx ty tz qx qy qz qw`` with the stamp in seconds. An EuRoC line is the
stamp in nanoseconds, position, quaternion **qw first**, velocity, gyroscope and accelerometer bias.
In both, the pose is the IMU's pose in the world.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import Array, check_arrays, declare, refuse_row
from bundle.base.paths import as_path, numbered_lines
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.model.sequence.sequence import stamp_of_seconds

# Reading and writing of CSV tables of integers (nanoseconds) and floating-point numbers.
#
# The reader records the line of each row. Time stamps have 19 digits, more than a double holds, and
# are therefore parsed as integers. Numbers are written with enough digits to read back unchanged.


@dataclass(frozen=True, eq=False)
class CsvTable:
    """Columns of a file."""

    whole: NDArray[np.int64]  # (n, number of integer columns) int64
    numbers: NDArray[np.float64]  # (n, number of other columns)
    lines: NDArray[np.int64]  # (n,) line number of each row in the file, from 1
    name: str  # name of the file, for messages

    def place(self, row: int) -> str:
        """Return "imu.csv: line 12"."""
        return f"{self.name}: line {self.lines[row]}" if row < len(self.lines) else self.name

    def __len__(self) -> int:
        return len(self.lines)


def read_csv(
    path: str | os.PathLike[str],
    whole: Sequence[str],
    numbers: Sequence[str],
    delimiter: str | None = ",",
    extra: bool = False,
) -> CsvTable:
    """Read integer columns, then numbers; skip empty lines, comments and a header.

    Args:
        whole: names of the integer columns, for messages.
        numbers: names of the other columns, which follow the integer columns.
        delimiter: delimiter between columns; None for white space.
    """
    name = shown(path)
    lines, rows = [], []
    for number, line in numbered_lines(path):
        text = line.strip()
        if text and text[0] != "#":
            lines.append(number)
            rows.append(text)
    if rows and rows[0][0].isalpha() and rows[0][:3].lower() not in ("nan", "inf"):
        del lines[0], rows[0]  # a header
    columns = [*whole, *numbers]
    kind = np.dtype([("whole", np.int64, (len(whole),)), ("numbers", np.float64, (len(numbers),))])
    wanted = range(len(columns)) if extra else None
    try:
        table = (
            np.loadtxt(rows, kind, comments=None, delimiter=delimiter, ndmin=1, usecols=wanted)
            if rows
            else np.zeros(0, kind)
        )
    except ValueError:
        for number, text in zip(lines, rows, strict=True):
            _check_line(f"{name}: line {number}", text.split(delimiter), whole, numbers, extra)
        raise
    return CsvTable(
        whole=np.ascontiguousarray(table["whole"]),
        numbers=np.ascontiguousarray(table["numbers"]),
        lines=np.array(lines, np.int64),
        name=name,
    )


def csv_lines(head: str, *columns: Any) -> str:
    """Return the text of a file: a header, then one row for each entry of the 1-D columns."""
    cells = [[repr(value) for value in np.asarray(column).tolist()] for column in columns]
    rows: Iterable[str] = (",".join(row) for row in zip(*cells, strict=True))
    return "\n".join([head, *rows, ""])


def _check_line(
    place: str, words: list[str], whole: Sequence[str], numbers: Sequence[str], extra: bool
) -> None:
    expected = len(whole) + len(numbers)
    if len(words) < expected or (len(words) > expected and not extra):
        raise InputError(
            f"{place}: expected {expected} columns ({', '.join([*whole, *numbers])}), "
            f"found {len(words)}"
        )
    for index, name in enumerate([*whole, *numbers]):
        word = words[index].strip()
        try:
            value = int(word) if index < len(whole) else float(word)
            valid = index >= len(whole) or -(2**63) <= value < 2**63
        except ValueError:
            valid = False
        if not valid:
            sort = "an integer of 64 bits" if index < len(whole) else "a number"
            hint = "; seconds instead of nanoseconds?" if _is_seconds(name, word) else ""
            raise InputError(f"{place}: {name}: expected {sort}, found {brief(word)}{hint}")


def _is_seconds(name: str, word: str) -> bool:
    try:
        return name.startswith("timestamp") and 0 <= float(word) < 1e11
    except ValueError:
        return False


_POSITION, _QUATERNION = ["px", "py", "pz"], ["qw", "qx", "qy", "qz"]
_MOTION = ["vx", "vy", "vz", "bwx", "bwy", "bwz", "bax", "bay", "baz"]
_GROUND_TRUTH_HEAD = "#timestamp [ns]," + ",".join([*_POSITION, *_QUATERNION, *_MOTION])
# Columns of a state, qx qy qz qw px py pz v bg ba, in an EuRoC row.
_FROM_EUROC = [4, 5, 6, 3, 0, 1, 2, *range(7, 16)]  # a permutation that is its own inverse


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the IMU over time.

    Attributes:
        timestamps_ns: (n,) int64, ascending.
        states: (n, 16) rows qx qy qz qw px py pz vx vy vz bgx bgy bgz bax bay baz, world_from_imu;
            nan if the file has no velocities and biases.
    """

    timestamps_ns: NDArray[np.int64]
    states: NDArray[np.float64]

    _ARRAYS = declare(
        timestamps_ns=Array(("n",), dtype=np.int64),
        states=Array(("n", 16)),
    )

    def __post_init__(self) -> None:
        check_arrays(self, self._ARRAYS)

    def __len__(self) -> int:
        return len(self.timestamps_ns)


def load_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory: lines with commas have EuRoC's format, other lines TUM's.

    Raises:
        InputError: a line has neither format; one line with file, line, expected and actual value.
        OSError: the file cannot be read.
    """
    for _, line in numbered_lines(as_path(path)):
        if line.strip() and not line.startswith("#"):
            return load_ground_truth(path) if "," in line else load_tum(path)
    raise InputError(f"{shown(as_path(path))}: expected poses, found an empty file")


def load_ground_truth(path: str | os.PathLike[str], *, in_order: bool = True) -> Trajectory:
    """Read EuRoC's ground truth; velocities and biases are nan in a file with poses only.

    ``in_order``: require ascending time stamps; otherwise, sort the poses.
    """
    path = as_path(path)
    first = [line for _, line in numbered_lines(path) if line.strip() and line[0] != "#"][:1]
    whole = bool(first) and first[0].count(",") >= 16
    names = [*_POSITION, *_QUATERNION, *(_MOTION if whole else [])]
    table = read_csv(path, ["timestamp"], names, extra=True)
    states = np.full((len(table), 16), np.nan)
    states[:, : len(names)] = table.numbers[:, _FROM_EUROC[: len(names)]]
    return _checked(table.whole[:, 0], states, table.place, in_order)


def load_tum(path: str | os.PathLike[str], *, in_order: bool = True) -> Trajectory:
    """Read a TUM trajectory; stamps keep their nanoseconds.

    ``in_order``: require ascending time stamps; otherwise, sort the poses.
    """
    names = ["timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]
    path = as_path(path)
    table = read_csv(path, [], names, delimiter=None)
    words = {
        number: line.split(None, 1)[0] for number, line in numbered_lines(path) if line.strip()
    }
    stamps = [
        stamp_of_seconds(words[line], table.place(row))
        for row, line in enumerate(table.lines.tolist())
    ]
    states = np.full((len(table), 16), np.nan)
    states[:, :4], states[:, 4:7] = table.numbers[:, 4:], table.numbers[:, 1:4]
    return _checked(np.array(stamps, np.int64), states, table.place, in_order)


def save_tum(path: str | os.PathLike[str], timestamps_ns: ArrayLike, states: ArrayLike) -> None:
    """Write a TUM trajectory: stamps in seconds with nine decimals; numbers read back unchanged.

    ``timestamps_ns``: (n,) time stamps in nanoseconds. ``states``: (n, 7) or more columns: qx qy qz
    qw px py pz, world_from_imu.
    """
    rows = np.asarray(states, np.float64)[:, [4, 5, 6, 0, 1, 2, 3]].tolist()
    stamps = np.asarray(timestamps_ns, np.int64).tolist()
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, row in zip(stamps, rows, strict=True):
        sign, size = "-" * (stamp < 0), abs(stamp)
        second = f"{sign}{size // 10**9}.{size % 10**9:09d}"
        lines.append(" ".join([second, *map(repr, row)]))
    atomic.write_text(as_path(path), "\n".join([*lines, ""]))


def save_ground_truth(
    path: str | os.PathLike[str], timestamps_ns: ArrayLike, states: ArrayLike
) -> None:
    """Write states, (n, 16), in the format of EuRoC's ground truth."""
    columns = np.asarray(states, np.float64)[:, _FROM_EUROC].T
    text = csv_lines(_GROUND_TRUTH_HEAD, np.asarray(timestamps_ns, np.int64), *columns)
    atomic.write_text(as_path(path), text)


def _checked(
    stamps: NDArray[np.int64],
    states: NDArray[np.float64],
    place: Callable[[int], str],
    in_order: bool,
) -> Trajectory:
    if not len(stamps):
        raise InputError(f"{place(0)}: expected poses, found an empty file")
    norm = np.linalg.norm(states[:, :4], axis=1)
    refuse_row(
        ~(np.abs(norm - 1) < 0.01) | ~np.isfinite(states[:, :7]).all(axis=1),
        lambda row: (
            f"{place(row)}: expected finite numbers and a quaternion of norm 1, found norm "
            f"{norm[row]:g}"
        ),
    )
    order = np.arange(len(stamps)) if in_order else np.argsort(stamps, kind="stable")
    back = np.flatnonzero(np.diff(stamps[order]) <= 0)
    if len(back):
        before, row = (int(order[back[0] + k]) for k in (0, 1))
        trouble = "time goes back" if in_order else "a second pose at one time"
        raise InputError(
            f"{place(row)}: {trouble}: expected more than {stamps[before]} ns, found {stamps[row]}"
        )
    states[:, :4] /= norm[:, None]
    return Trajectory(stamps[order], states[order])
