"""Reader of COLMAP's project.ini: the options of ``colmap bundle_adjuster``.

The file has lines NAME=VALUE, in sections such as [BundleAdjustment] or with the section in the
name (BundleAdjustment.refine_focal_length=1); "#" begins a comment. A file that COLMAP writes has
the sections of all its programs, of which only those of the bundle adjustment are read.
"""

from __future__ import annotations

import os

from bundle.base.paths import numbered_lines
from bundle.errors import InputError, brief, shown
from bundle.interface.colmap_options import ColmapAdjustment, colmap_adjustment

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
            "[BundleAdjustment], found 0"
        )
    if (backend := values.pop("backend", "CERES").upper()) not in ("CERES", "0"):
        raise InputError(f"{places['backend']}: expected CERES, found {brief(backend)}")
    return colmap_adjustment(values, {}, lambda name: places.get(name, f"{shown(path)}: {name}"))
