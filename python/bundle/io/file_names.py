"""Suffixes of output files, and suffixes of other formats.

A name without a suffix, or with an unknown one (``run.v2``), is accepted.
"""

from __future__ import annotations

import os
from pathlib import PurePath

from bundle.errors import InputError, shown

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
        own: accepted suffixes, separated by spaces.
        compressed: suffixes that are accepted before ".gz" or ".bz2".

    Raises:
        InputError: the suffix belongs to another format or to an unsupported compression.
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
