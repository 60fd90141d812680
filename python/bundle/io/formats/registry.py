"""The registry of formats of other programs: names, recognition by content, reader and writer.

Another package adds a format by an entry point of the group ``bundle.formats``: an object of the
class :class:`Format` whose ``module`` has the functions that the format supports::

    read(path, options) -> bundle.Problem
    write(problem, path) -> sentences on information that is lost
    check(problem, path)           # optional: raises what ``write`` would raise
    write_beside(problem, path)    # optional: writes further files beside the output

``write`` gets a temporary path, or for a format with ``is_folder`` the folder itself. COLMAP models
and BAL files do not go through the registry: they are rewritten in place and read in slices.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bundle.base.records import dataclass
from bundle.base.words import join
from bundle.errors import InputError, shown

GROUP = "bundle.formats"


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of reconstructions.

    Attributes:
        name: name for ``--format``.
        what: kind of content for messages, such as "a Bundler model".
        module: module (or its dotted name) with ``read`` and ``write``, or one of them.
        writer: module with ``write`` and ``check``; None: ``module``.
        pattern: regular expression that matches the first 4096 bytes of a file; empty: none. For a
            format without a reader, it serves to name the content.
        members: names of files that make a folder a project of this format.
        suffixes: ends of names of output files.
        is_folder: True if the output is a folder.
        reads: True if the format has a reader.
        writes: True if it has a writer.
    """

    name: str
    what: str
    module: Any
    writer: Any = None
    pattern: bytes = b""
    members: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = ()
    is_folder: bool = False
    reads: bool = True
    writes: bool = True

    def reading(self) -> Any:
        """Return the module with ``read``."""
        return _module(self.module)

    def writing(self) -> Any:
        """Return the module with ``write``."""
        return _module(self.module if self.writer is None else self.writer)

    def matches(self, beginning: bytes) -> bool:
        """Return True if a file with these first bytes has this format."""
        return bool(self.pattern and re.match(self.pattern, beginning, re.DOTALL))


def _module(given: Any) -> Any:
    return importlib.import_module(given) if isinstance(given, str) else given


_HERE = "bundle.io.formats"
BUILT_IN = (
    Format(
        name="bundler",
        what="a Bundler model",
        module=f"{_HERE}.bundler",
        pattern=rb"\s*#\s*Bundle file",
        members=("bundle.out", "bundle/bundle.out"),
        suffixes=(".out",),
    ),
    Format(
        name="nvm",
        what="an NVM model",
        module=f"{_HERE}.nvm",
        pattern=rb"\s*NVM_V3",
        members=("model.nvm",),
        suffixes=(".nvm",),
    ),
    Format(
        name="openmvg",
        what="an OpenMVG scene",
        module=f"{_HERE}.openmvg",
        pattern=rb'\s*\{.{,2000}"(sfm_data_version|root_path)"\s*:',
        members=("sfm_data.json",),
        suffixes=("sfm_data.json",),
    ),
    Format(
        name="opensfm",
        what="an OpenSfM reconstruction",
        module=f"{_HERE}.opensfm",
        pattern=rb'\s*\[\s*(\{\s*"(cameras|shots|points|reference_lla|biases|rig_\w+)"\s*:|\]\s*$)',
        members=("reconstruction.json",),
        is_folder=True,
    ),
    Format(
        name="transforms",
        what="nerfstudio's transforms.json",
        module=f"{_HERE}.transforms",
        pattern=rb'\s*\{.{,3000}"(transform_matrix|camera_angle_x|fl_x)"\s*:',
        suffixes=("transforms.json",),
        reads=False,
    ),
    Format(
        name="ply",
        what="a point cloud (PLY)",
        module=f"{_HERE}.ply",
        suffixes=(".ply",),
        reads=False,
    ),
    Format(
        name="rerun",
        what="a recording for rerun's viewer",
        module=f"{_HERE}.rerun_recording",
        suffixes=(".rrd",),
        reads=False,
    ),
)

FOLDERS = frozenset({"colmap", "colmap-text", "opensfm"})  # formats whose output is a folder


def names_read() -> str:
    """Return the names of all inputs that are reconstructions, for messages."""
    others = (known.what for known in BUILT_IN if known.reads)
    return join(("the folder of a COLMAP model", "a BAL file", *others))


def names_written() -> str:
    """Return the names of outputs with their formats, for messages."""
    suffixes = (suffix for known in BUILT_IN if known.writes for suffix in known.suffixes)
    return f"a folder (COLMAP) or of a file in .txt, .txt.gz, .txt.bz2 (BAL), {join(suffixes)}"


def _all(*, others: bool = True) -> Iterator[Format]:
    yield from BUILT_IN
    if others:  # late: reading the metadata of all packages takes time
        from importlib.metadata import entry_points

        for entry in entry_points(group=GROUP):
            try:
                found = entry.load()
            except Exception as error:
                raise InputError(f"entry point {GROUP}: {entry.name}: {error}") from error
            if not isinstance(found, Format):
                raise InputError(
                    f"entry point {GROUP}: {entry.name}: expected a bundle.Format, found "
                    f"{type(found).__name__}"
                )
            yield found


def find_format(name: str) -> Format | None:
    """Return the format of a name; None if it is unknown, and for COLMAP and BAL."""
    built_in = next((known for known in BUILT_IN if known.name == name), None)
    if built_in is not None or name in FOLDERS or name == "bal":
        return built_in
    return next((known for known in _all() if known.name == name), None)


def file_at(path: Path, known: Format) -> Path:
    """Return the file to read: the path, or the first member of a folder that exists."""
    if not path.is_dir():
        return path
    for name in known.members:
        if (path / name).is_file():
            return path / name
    raise InputError(
        f"{shown(path)}: expected {known.what}, found a folder without {' or '.join(known.members)}"
    )


def format_at(path: Path, beginning: bytes, *, others: bool = True) -> Format | None:
    """Return the format of a file or folder by its content; None if no format matches.

    Args:
        beginning: first bytes of a file.
        others: also ask the formats of other packages.
    """
    is_folder = path.is_dir()
    for known in _all(others=others):
        if not known.reads:
            continue
        if (
            any((path / name).is_file() for name in known.members)
            if is_folder
            else (known.matches(beginning))
        ):
            return known
    return None


def format_written(path: Path) -> Format | None:
    """Return the format of a file that this package writes and does not read, by its content."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        beginning = file.read(4096)
    return next((f for f in BUILT_IN if not f.reads and f.matches(beginning)), None)


def format_for_name(path: Path) -> Format | None:
    """Return the built-in output format that belongs to the name of a file, or None."""
    name = path.name.lower()
    return next(
        (f for f in BUILT_IN if f.writes and f.suffixes and name.endswith(f.suffixes)), None
    )
