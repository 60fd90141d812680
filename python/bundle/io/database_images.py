"""COLMAP's database and project.ini: image sizes, keypoints with their matches; options.

Formats such as Bundler's and NVM have no image sizes. A database of the same photographs has them,
by the name of the image.

The id of a pair of images is ``image_id1 * MOST_IMAGES + image_id2`` with image_id1 < image_id2.
Matrices are stored by rows: keypoints as float32 (x, y, and their shape), matches as uint32 pairs
of keypoint indices in the order of the pair.

Source: src/colmap/scene/database_sqlite.cc of COLMAP.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import numbered_lines
from bundle.errors import InputError, brief, shown
from bundle.interface.colmap_options import ColmapAdjustment, colmap_adjustment

if TYPE_CHECKING:
    import sqlite3


MOST_IMAGES = 2**31 - 1  # COLMAP's ``kMaxNumImages``


def is_database(path: Path) -> bool:
    """Return True for an SQLite file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


@contextmanager
def open_database(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a COLMAP database for reading.

    COLMAP's databases have a write-ahead log, which even a reader creates. Without one, nothing
    writes to the database, and it is read as an immutable file.
    """
    import sqlite3  # late: few inputs are databases

    is_written = path.with_name(f"{path.name}-wal").exists()
    place = f"{path.absolute().as_uri()}?{'mode=ro' if is_written else 'immutable=1'}"
    try:
        with closing(sqlite3.connect(place, uri=True)) as database:
            yield database
    except sqlite3.Error as error:
        raise InputError(
            f"{shown(path)}: expected COLMAP's database, found {brief(str(error))}"
        ) from None


def database_sizes(path: Path, names: Sequence[str]) -> NDArray[np.int64]:
    """Return (num_images, 2) width and height of images by name."""
    place = shown(path)
    with open_database(path) as database:
        rows = database.execute(
            "SELECT images.name, cameras.width, cameras.height "
            "FROM images JOIN cameras ON cameras.camera_id = images.camera_id"
        ).fetchall()
    known = {str(name): size for name, *size in rows}
    sizes = np.zeros((len(names), 2), np.int64)
    for index, name in enumerate(names):
        if not name:
            raise InputError(
                f"{place}: expected image names, to find their sizes in the database, "
                f"found image {index} without a name"
            )
        size = known.get(name)
        if size is None:
            first = f", which has images such as {shown(next(iter(known)))}" if known else ""
            raise InputError(
                f"{place}: expected the image {shown(name)}{first}, found no such name"
            )
        if not all(isinstance(length, int) and 0 < length < 2**31 for length in size):
            raise InputError(
                f"{place}: cameras: expected a width and a height above 0 for {shown(name)}, "
                f"found {size[0]} x {size[1]}"
            )
        sizes[index] = size
    return sizes


class DatabaseMatches(NamedTuple):
    """Keypoints of images, and their verified matches."""

    # for each image, (n, 2) pixels, rounded to float32 by COLMAP
    keypoints: list[NDArray[np.float64]]
    # for each matched pair, two rows of images and (m, 2) indices of their keypoints
    pairs: list[tuple[int, int, NDArray[np.uint32]]]


FEWEST_MATCHES = 15
"""Number of matches below which COLMAP's mapper ignores a pair (``min_num_matches``)."""


def database_matches(path: Path, names: Sequence[str]) -> DatabaseMatches:
    """Return the keypoints of images by name, and the matches among them.

    The matches are the inliers of two-view geometries, in pairs of at least ``FEWEST_MATCHES``.
    """
    place = shown(path)
    if not is_database(path):
        path.open("rb").close()  # an OSError names the cause
        raise InputError(f"{place}: expected COLMAP's database, found another file")
    with open_database(path) as database:
        ids = {
            str(name): key for key, name in database.execute("SELECT image_id, name FROM images")
        }
        missing = [name for name in names if name not in ids]
        if missing:
            first = f", which has images such as {shown(next(iter(ids)))}" if ids else ""
            raise InputError(
                f"{place}: expected the images of the model{first}, found no {shown(missing[0])} "
                f"({len(missing)} of {len(names)} are missing)"
            )
        keypoints = [
            _table(database, place, "keypoints", "image_id", ids[name], "<f4")[:, :2]
            for name in names
        ]
        rows = {ids[name]: row for row, name in enumerate(names)}
        pairs = []
        for (pair_id,) in database.execute(
            "SELECT pair_id FROM two_view_geometries WHERE rows >= ? ORDER BY pair_id",
            (FEWEST_MATCHES,),
        ).fetchall():
            pair = [rows.get(key, -1) for key in divmod(pair_id, MOST_IMAGES)]
            if min(pair) < 0:
                continue
            found = _table(database, place, "two_view_geometries", "pair_id", pair_id, "<u4")
            counts = [len(keypoints[row]) for row in pair]
            if found.shape[1] != 2 or (found >= counts).any():
                raise InputError(
                    f"{place}: two_view_geometries: pair {pair_id}: expected 2 columns with "
                    f"indices of {counts[0]} and {counts[1]} keypoints, found {found.shape[1]} "
                    f"columns and index {found.max()}"
                )
            pairs.append((pair[0], pair[1], found))
    if not pairs:
        raise InputError(
            f"{place}: expected two-view geometries of at least {FEWEST_MATCHES} matches between "
            "images of the model, found 0"
        )
    return DatabaseMatches([xy.astype(np.float64) for xy in keypoints], pairs)


def _table(
    database: sqlite3.Connection, place: str, table: str, column: str, key: int, dtype: str
) -> NDArray[Any]:
    """Return the (rows, cols) matrix of a record; (0, 2) without a record."""
    found = database.execute(
        f"SELECT rows, cols, data FROM {table} WHERE {column} = ?", (key,)
    ).fetchone() or (0, 2, b"")
    rows, cols, data = found[0], found[1], found[2] or b""
    sizes = all(isinstance(size, int) and size >= 0 for size in (rows, cols))
    if not sizes or not isinstance(data, bytes) or cols < 2 or len(data) != 4 * rows * cols:
        raise InputError(
            f"{place}: {table}: expected {rows} x {cols} numbers of 4 bytes for {column} {key}, "
            f"found {len(data)} bytes"
        )
    return np.frombuffer(data, dtype).reshape(rows, cols)


# Reader of COLMAP's project.ini: the options of ``colmap bundle_adjuster``.
#
# The file has lines NAME=VALUE, in sections such as [BundleAdjustment] or with the section in the
# name (BundleAdjustment.refine_focal_length=1); "#" begins a comment. A file that COLMAP writes has
# the sections of all its programs, of which only those of the bundle adjustment are read.


SECTIONS = ("BundleAdjustment", "BundleAdjustmentCeres")
RENAMED = {"refine_extrinsics": "refine_rig_from_world"}
"""Names before COLMAP 3.13, by which a file may still call an option."""


def read_project_ini(path: str | os.PathLike[str]) -> ColmapAdjustment:
    """Read the options of a bundle adjustment; those that the file lacks have COLMAP's default."""
    values: dict[str, str] = {}
    places: dict[str, str] = {}
    section = ""
    for number, line in numbered_lines(path):
        place = f"{shown(path)}:{number}"
        text = line.partition("#")[0].strip()
        if not text:
            continue
        if text.startswith("[") and text.endswith("]"):
            section = text[1:-1].strip()
            continue
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{place}: expected NAME=VALUE or [SECTION], found {brief(text)}")
        owner, _, leaf = f"{section}.{name.strip()}".lstrip(".").rpartition(".")
        if owner not in SECTIONS:
            continue
        leaf = RENAMED.get(leaf, leaf)
        if leaf in values:
            raise InputError(f"{place}: {leaf}: expected one value, found a second one")
        values[leaf], places[leaf] = value.strip(), f"{place}: {owner}.{leaf}"
    if not values:
        raise InputError(
            f"{shown(path)}: expected options of COLMAP's bundle_adjuster in a section "
            "[BundleAdjustment], found 0 options"
        )
    if (backend := values.pop("backend", "CERES").upper()) not in ("CERES", "0"):
        raise InputError(f"{places['backend']}: expected CERES, found {brief(backend)}")
    return colmap_adjustment(values, {}, lambda name: places.get(name, f"{shown(path)}: {name}"))
