"""COLMAP's database: access, and image sizes from the tables images and cameras.

Formats such as Bundler's and NVM have no image sizes. A database of the same photographs has them,
by the name of the image.

Source: src/colmap/scene/database_sqlite.cc of COLMAP.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief, shown

if TYPE_CHECKING:
    import sqlite3


def is_database(path: Path) -> bool:
    """Return True for an SQLite file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


@contextmanager
def open_database(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a COLMAP database for reading.

    Raises:
        InputError: the database is damaged, or lacks what the context asks for.
    """
    import sqlite3  # late: few inputs are databases

    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            yield database
    except sqlite3.Error as error:
        raise InputError(
            f"{shown(path)}: expected COLMAP's database, found {brief(str(error))}"
        ) from None


def database_sizes(path: Path, names: Sequence[str]) -> NDArray[np.int64]:
    """Return (num_images, 2) width and height of images by name.

    Raises:
        InputError: the database is damaged, or lacks an image.
        OSError: the file cannot be read.
    """
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
