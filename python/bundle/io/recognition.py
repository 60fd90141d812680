"""Recognition of files and folders by content, suffixes of outputs, objects of user code."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
import traceback
from codecs import BOM_UTF8
from enum import StrEnum
from pathlib import Path, PurePath
from types import ModuleType
from typing import Any, TypeGuard

from bundle.base.paths import as_path
from bundle.base.words import FORMATS
from bundle.errors import InputError, nearest, shown
from bundle.io.atomic.replaced_paths import MODEL_FILES, missing_model_files
from bundle.io.formats.registry import BUILT_IN, Format, format_at, format_written

# Objects of a user's Python file: FILE.py:NAME.
#
# The file runs as a module of its own name, with its folder first in the search path, as ``python
# FILE.py`` does. A function is called without arguments.


NAMES = ("make_graph", "graph")  # objects that are used if no name is given

_PYTHON = re.compile(r"(?P<path>.+\.py)(?::(?P<name>[^:/\\]*))?$", re.IGNORECASE | re.DOTALL)


def is_python_object(path: object) -> bool:
    """Return True for text such as "factors.py" and "factors.py:make_graph"."""
    found = _PYTHON.match(path) if isinstance(path, str) else None
    return found is not None and not Path(path if isinstance(path, str) else "").is_dir()


def load_object(text: str) -> Any:
    """Run a Python file and return its object, or what its function returns.

    ``text``: FILE.py:NAME; without a name ``make_graph`` or ``graph``.
    """
    found = _PYTHON.match(text)
    if found is None:
        raise InputError(f"{shown(text)}: expected FILE.py:NAME")
    path, name = as_path(found["path"]), found["name"]
    with path.open("rb"):  # a missing file is an error of the system, not of Python
        pass
    module = _run(path)
    if name is None:
        name = next((known for known in NAMES if hasattr(module, known)), "")
        if not name:
            raise InputError(
                f"{shown(path)}: expected {' or '.join(NAMES)}, or {shown(path)}:NAME, "
                f"found {_names(module)}"
            )
    if not hasattr(module, name):
        raise InputError(
            f"{shown(path)}: expected an object {name}, found {_names(module)}"
            f"{nearest(name, [*vars(module)])}"
        )
    thing = getattr(module, name)
    if not callable(thing):
        return thing
    try:
        return thing()
    except Exception as error:
        hint = " (check residuals by bundle.check_gradients)" * ("argument" in str(error))
        place = f"{shown(path)}: {name}(), called without arguments{hint}"
        raise user_error(place, error, path) from error


def user_error(place: str, error: Exception, path: Path | None = None) -> InputError:
    """Return an exception of user code as one line, with the file and line that raised it.

    ``path``: file whose last line in the traceback is named; None: that of the last frame.
    """
    if isinstance(error, InputError):
        return InputError(f"{place}: {error}")
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if path is None or Path(frame.filename) == path.resolve()]
    line = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else None
    if line is None and own:
        line = own[-1].lineno
    notes = "".join(f"{note}: " for note in getattr(error, "__notes__", ())[:1])
    where = f" (line {line})" if line else ""
    message = error.msg if isinstance(error, SyntaxError) else str(error)
    return InputError(f"{place}: {notes}{type(error).__name__}: {message}{where}")


def _run(path: Path) -> ModuleType:
    folder, stem = str(path.resolve().parent), path.stem
    name = stem if stem.isidentifier() and stem not in sys.modules else f"_{abs(hash(path))}"
    spec = importlib.util.spec_from_file_location(name, path.resolve())
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # for dataclasses and pickle
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        failed = error if isinstance(error, Exception) else RuntimeError("sys.exit was called")
        raise user_error(shown(path), failed, path) from error
    return module


def _names(module: ModuleType) -> str:
    own = [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and not isinstance(value, ModuleType)
        and getattr(value, "__module__", module.__name__) == module.__name__
    ]
    return ", ".join(own[:5]) or "an empty file"


OUTPUT_FORMATS = (
    *(name for name in FORMATS if name in ("bal", "colmap")),
    "colmap-text",
    *(known.name for known in BUILT_IN if known.writes),
)
"""Formats in which reconstructions can be written."""

_HEADER = re.compile(rb"\s*\d+\s+\d+\s+\d+\s+\d+\s+\d+\s+[-+.\d]")  # counts, first observation
_RECORD = re.compile(
    rb"(?:\s*#[^\n]*\n)*\s*"
    rb"(?:VERTEX_SE[23]|EDGE_SE[23]|FIX\s+\d|PARAMS_SE[23]|(?:VERTEX|EDGE)[23]?\s+\d|EQUIV\s+\d|"
    rb"(?:ROBOT|RAW)LASER1\s)"
)
_SUFFIXES = (".g2o", ".g2o.gz", ".g2o.bz2")
_ENOUGH = 4096
_OTHER_PROGRAMS = {
    rb"<\?xml[^>]*>\s*<document\b": "a project of Metashape, whose XML has no tie points; "
    "export COLMAP or Bundler",
    rb"<\?xml[^>]*>\s*<(BlocksExchange|SpatialReferenceSystems)\b": "BlocksExchange XML; export "
    "COLMAP or Bundler",
    rb"<x:xmpmeta\b": "XMP of a photograph, such as RealityCapture's; export COLMAP or Bundler",
    rb"#(cameras\s+\d+|name,x,y)": "a table of RealityCapture, which has no tie points; export "
    "COLMAP or Bundler",
    rb"<\?xml[^>]*>\s*<cereal>": "XML of OpenMVG; openMVG_main_ConvertSfM_DataFormat makes JSON",
    rb'\{\s*"version"\s*:.{,3000}"(featuresFolders|views)"': "a scene of AliceVision or Meshroom; "
    "export COLMAP",
}
"""Beginnings of files of other programs that have a way to this package, as patterns."""
_BEGINNINGS = {
    b"SQLite format 3": "a database, such as COLMAP's of features and matches",
    b"ply": "a point cloud or mesh (PLY)",
    b"# Camera list": "a file of a COLMAP model without the others",
    b"# Image list": "a file of a COLMAP model without the others",
    b"# 3D point list": "a file of a COLMAP model without the others",
    b"<?xml": "XML",
    b"<": "a page or XML",
    b"{": "JSON",
    b"[": "JSON",
    b"%PDF": "a document (PDF)",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"PK\x03\x04": "an archive or file of arrays (zip)",
}
"""First bytes of files in formats that this package does not read."""
SEQUENCE_FILES = ("imu.csv", "tracks.csv", "calibration.yaml")
RECORDINGS = {
    "mav": "a folder with cam0 and imu0",
    "rosbag": "a ROS bag",
    "video": "a video",
}
"""Sequences with images in place of tracks."""
_VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".360", ".lrv", ".mts")


class Kind(StrEnum):
    """Kinds of inputs."""

    RECONSTRUCTION = "a reconstruction"
    POSE_GRAPH = "a pose graph"
    SEQUENCE = "a sequence"
    PYTHON = "a Python file"


def recognize(path: object) -> Kind:
    """Return the kind of an input by its content, or by its name if it cannot be read.

    An input that is neither a pose graph nor a sequence counts as a reconstruction; the
    reconstruction reader then raises the precise error. Pipes are not opened.
    """
    if is_pose_graph_file(path):
        return Kind.POSE_GRAPH
    if is_python_object(path):
        return Kind.PYTHON
    return Kind.SEQUENCE if sequence_at(path) else Kind.RECONSTRUCTION


def reconstruction_at(path: Path) -> str | None:
    """Return the kind of reconstruction at a path, such as "a COLMAP model", or None."""
    if path.is_dir() and not missing_model_files(path):
        return "a COLMAP model"
    imported = imported_format(path, others=False)
    if imported is not None:
        return imported.what
    if path.is_dir():
        return None
    if path.name in MODEL_FILES and path.exists() and not missing_model_files(path.parent):
        return "a file of a COLMAP model"
    if path.is_file() and _HEADER.match(_beginning(path)):
        return "a BAL file"
    return "a pose graph" if is_pose_graph_file(path) else None


def imported_format(path: Path, *, others: bool = True) -> Format | None:
    """Return the format of a file or folder of another program by its content, or None.

    Pipes are not opened. With ``others``, formats of other packages are asked, too, unless the file
    begins as a BAL file does.
    """
    if path.is_dir():
        return format_at(path, b"", others=others) if missing_model_files(path) else None
    if not path.is_file():
        return None
    beginning = _beginning(path)
    return format_at(path, beginning, others=others and not _HEADER.match(beginning))


def format_by_members(path: Path) -> Format | None:
    """Return the format of a JSON object by the names of its members, in any order, or None.

    Other programs may have sorted the names, so that those of the format are not at the beginning.
    """
    if not path.is_file() or not _beginning(path).lstrip().startswith(b"{"):
        return None
    import json  # only for files without a known beginning

    try:
        names = "".join(f'"{name}":' for name in json.loads(path.read_bytes()))
    except (OSError, ValueError, RecursionError):
        return None
    return format_at(path, f"{{{names}".encode(errors="replace"), others=False)


def is_pose_graph_file(path: object) -> TypeGuard[str | os.PathLike[str]]:
    """Return True if a path leads to a g2o file; pipes are not opened."""
    if not isinstance(path, str | os.PathLike):
        return False
    try:
        file = Path(os.fspath(path))
        if not file.is_file():  # the name decides for a missing file
            return not file.exists() and file.name.lower().endswith(_SUFFIXES)
    except (TypeError, ValueError, OSError):  # bytes, zeros in a name, a name too long
        return False
    return file.name.lower().endswith(_SUFFIXES) or bool(_RECORD.match(_beginning(file)))


def other_format_at(path: Path) -> str | None:
    """Return the format of a file that is neither a BAL file nor a pose graph.

    The content decides first, then the name. None for pipes, for files that begin with a number, as
    BAL files do, and for unknown text in a file with the name of a BAL file.
    """
    if not path.is_file():
        return None
    beginning = _beginning(path).lstrip()
    if not beginning or beginning[:1].isdigit():
        return None
    for pattern, words in _OTHER_PROGRAMS.items():
        if re.match(pattern, beginning, re.DOTALL):
            return words
    if path.stem == "sfm_data" and path.suffix in (".bin", ".xml", ".ply", ".baf"):
        return "OpenMVG's, but not JSON; openMVG_main_ConvertSfM_DataFormat makes sfm_data.json"
    written = format_written(path)
    if written is not None:
        return f"{written.what}, which has cameras and no tracks"
    known = (words for begin, words in _BEGINNINGS.items() if beginning.startswith(begin))
    is_bal = path.suffix.lower() in (".txt", *_COMPRESSIONS)
    by_name = None if is_bal else format_of_name(path) or "no known format"
    return next(known, by_name)


def sequence_at(path: object) -> str | None:
    """Return the format of a visual-inertial sequence, or None.

    "sequence": a folder with tracks; "track csv": the format in which GTSAM's examples store the
    EuRoC flights; one of ``RECORDINGS``: images and samples.
    """
    if not isinstance(path, str | os.PathLike):
        return None
    try:
        place = Path(os.fspath(path))
        if place.is_dir():
            found = [name for name in SEQUENCE_FILES if (place / name).is_file()]
            if found == ["tracks.csv"] and format_at(place, b"", others=False) is not None:
                return None  # a project of OpenSfM
            return "sequence" if found else _recording_folder(place)
        if not place.is_file():
            return None
        if place.suffix.lower() in _VIDEOS:
            return "video"
        beginning = _beginning(place)
    except (TypeError, ValueError, OSError):
        return None
    known = {b"row_type,": "track csv", b"#ROSBAG V": "rosbag"}
    return next((name for begin, name in known.items() if beginning.startswith(begin)), None)


def is_recording(path: object) -> bool:
    """Return True for images and samples, in which features have to be tracked first."""
    return sequence_at(path) in RECORDINGS


def sequence_format(path: object) -> str:
    """Return the format's name in reports: "track_csv", "mav", ..., otherwise "sequence"."""
    return (sequence_at(path) or "sequence").replace(" ", "_")


def mav_root(path: Path) -> Path | None:
    """Return the folder with ``cam0`` or ``imu0``: the path, or ``mav0`` in it; None if neither."""
    for folder in (path, path / "mav0"):
        if any((folder / name / "data.csv").is_file() for name in ("cam0", "imu0")):
            return folder
    return None


def _recording_folder(place: Path) -> str | None:
    if mav_root(place) is not None:
        return "mav"
    bag = place / "metadata.yaml"
    return "rosbag" if bag.is_file() and b"rosbag2_bagfile" in _beginning(bag) else None


def _beginning(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            start = file.read(_ENOUGH)
        if start.startswith(b"\x1f\x8b"):
            import gzip
            import zlib

            try:
                with gzip.open(path, "rb") as packed:
                    return packed.read(_ENOUGH)
            except zlib.error:
                return b""
        if start.startswith(b"BZh"):
            import bz2

            with bz2.open(path, "rb") as packed:
                return packed.read(_ENOUGH)
        return start.removeprefix(BOM_UTF8)
    except (OSError, EOFError):
        return b""


# Suffixes of output files, and suffixes of other formats.
#
# A name without a suffix, or with an unknown one (``run.v2``), is accepted.

PAGE = ("a page (.html)", ".html .htm .xhtml")
"""Name of a page in messages, and the suffixes of its files."""

_COMPRESSIONS = (".gz", ".bz2")

_FORMATS = {
    "a Bundler model": ".out",
    "an NVM model": ".nvm",
    "a Meshroom project": ".sfm .mg",
    "a file of a COLMAP model": ".bin",
    "a database": ".db .sqlite .sqlite3",
    "a scene of another program": ".mvs .abc .p4d .psx .psz .rcproj .blend .fbx .dae",
    "a point cloud or mesh": ".ply .pcd .las .laz .e57 .obj .stl .off .glb .gltf .splat .pts",
    "a page": ".html .htm .xhtml",
    "a document": ".pdf .md .rst .tex .ps .eps .docx .doc .odt .xlsx .xls .ods",
    "a picture": ".png .jpg .jpeg .tif .tiff .svg .webp .bmp .gif .heic .dng .exr",
    "a video or bag": ".mp4 .avi .mov .mkv .bag .mcap",
    "JSON": ".json .jsonl .ndjson",
    "XML": ".xml .kml .xmp .rdf",
    "YAML": ".yaml .yml",
    "a BAL or text file": ".txt",
    "a table": ".csv .tsv .parquet",
    "a file of coordinates": ".geojson .kmz .gpx .shp .gpkg",
    "a file of arrays": ".npz .npy .mat .h5 .hdf5 .pkl .pickle .pt .safetensors",
    "a pose graph": ".g2o",
    "a trajectory": ".tum .kitti",
    "an archive": ".zip .tar .tgz .7z .rar .xz .zst .lz4",
    "a program": ".py .ipynb .sh .m .cpp .h .js .css",
}
_OWNERS = {suffix: format for format, names in _FORMATS.items() for suffix in names.split()}


def format_of_name(path: str | os.PathLike[str]) -> str | None:
    """Return the format of a suffix, such as "an NVM model", or None."""
    return _OWNERS.get(PurePath(path).suffix.lower())


def check_name(
    path: str | os.PathLike[str], what: str, own: str = "", compressed: str = ""
) -> None:
    """Raise an error if a name has the suffix of another format.

    Args:
        path: output path; with a trailing slash it is a folder, and any name is accepted.
        what: kind of the output, such as "a page (.html)".
        compressed: suffixes that are accepted before ".gz" or ".bz2".
    """
    name = os.fspath(path)
    if name.endswith("/"):
        return
    base = PurePath(name.lower())
    suffix = base.suffix
    packed = suffix in _COMPRESSIONS
    if packed:
        allowed, suffix = compressed.split(), PurePath(base.stem).suffix
    else:
        allowed = own.split()
    if suffix in allowed or (suffix not in _OWNERS and (not packed or compressed)):
        return
    found = _OWNERS.get(suffix, "a compressed file")
    raise InputError(f"{shown(path)}: expected a name of {what}, found a name of {found}")
