"""Arguments of the commands, as the rows of ``bundle.cli.commands`` name them.

INPUT, OUTPUT and other files are declared here and in ``inertial_flags``; options come from their
classes (``option_flags``).
"""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections.abc import Collection
from typing import Any

from bundle.base.words import FORMATS
from bundle.cli.commands import FLIGHT
from bundle.cli.inertial_flags import IMU, ODOMETRY, RECORDING  # noqa: F401 (in rows)
from bundle.cli.option_flags import (  # noqa: F401 (in rows)
    Container,
    Declaration,
    argument,
    either,
    fields,
    file_argument,
    group,
    options,
    own_options,
    widen,
)
from bundle.cli.path_checks import PathArgument, a_path, page_path, reconstruction, report_path
from bundle.errors import InputError
from bundle.georeference.measurements import ROBUST, ROWS, Measurement, fields_of, options_class
from bundle.interface.option_class import option_class
from bundle.interface.options import INFORMATION, LINEARIZATION, PATTERN  # noqa: F401 (in rows)
from bundle.io.formats.read_options import ORIGINS, ReadOptions
from bundle.io.georeference_file import GEOREFERENCE
from bundle.io.recognition import OUTPUT_FORMATS


def pose_graph(
    names: Collection[str] | None = None,
    title: str = "pose graphs (.g2o), beside backend, loss, trust region, tolerances and threads",
) -> Declaration:
    """Declare the options that only pose graphs have; extend the choices of shared options."""

    def add(to: Container) -> None:
        for field in dataclasses.fields(option_class("PoseGraphOptions")):  # type: ignore[arg-type]
            if names is None or field.name in names:
                widen(to, field, "pose graphs")
        own = own_options("PoseGraphOptions", "SolveOptions")
        options(
            "PoseGraphOptions", title, [name for name in own if names is None or name in names]
        )(to)

    return add


# Every command

COMMON = (
    argument(
        "--json",
        metavar="FILE",
        type=report_path,
        help="also write a report for programs; -: to standard output, which then has nothing else",
        use=91,
    ),
    argument("--quiet", action="store_true", help="no progress on standard error (default: shown)"),
    argument(
        "--verbose",
        action="store_true",
        help="show all tables and findings after the headline (default: off)",
        use=92,
    ),
    argument(
        "--dry-run",
        action="store_true",
        help="check the command line, read INPUT, and report what would be read, solved and "
        "written; write nothing (default: off)",
    ),
    argument(
        "--config",
        metavar="FILE.toml",
        type=a_path,
        help="take flags from a TOML file whose keys are their names, such as rounds = 3, at the "
        "top or in the table of a command, such as [refine]; flags replace them (default: none)",
    ),
)


# INPUT


def given_input(name: str = "input", **settings: Any) -> Declaration:
    """Declare the argument INPUT."""
    return argument(
        name,
        metavar="INPUT",
        type=reconstruction,
        help="the folder of a COLMAP model (binary or text), a BAL, Bundler, NVM or OpenMVG file "
        "(plain, .gz or .bz2), or an OpenSfM project; info, refine, compare, inspect, check, "
        "covariance, diagnose, report and convert also take a pose graph (.g2o, plain, .gz or "
        ".bz2), info and convert also the folder of a visual-inertial sequence or of its images "
        "(mav0); the content decides the format",
        **settings,
    )


def a_model(name: str, help: str) -> Declaration:
    """Declare a positional argument for a model."""
    return argument(name, metavar=name.upper(), type=reconstruction, help=help)


def a_report(name: str, which: str) -> Declaration:
    """Declare a positional argument for a report of a run."""
    return argument(
        name,
        metavar=f"{name.upper()}.json",
        type=a_path,
        help=f"the {which} report of bundle refine, vio or compare (--json FILE)",
    )


INPUT = given_input()
INSPECTED = argument(
    "input",
    metavar="INPUT",
    type=reconstruction,
    nargs="?",
    help="a BAL file (plain, .gz or .bz2) or the folder of a COLMAP model (binary or text) or a "
    "pose graph (g2o); the content decides the format",
)
COMPARED = argument(
    "inputs",
    metavar="INPUT",
    type=reconstruction,
    nargs="+",
    help="BAL files (plain, .gz or .bz2) and folders of COLMAP models; several inputs also give "
    "performance profiles; or one pose graph (g2o)",
)
EVALUATED = a_model(
    "a",
    "a COLMAP model, a BAL file, a pose graph (g2o), or a file of poses: TUM, EuRoC, KITTI, or a "
    "list with lines of name qw qx qy qz tx ty tz; the content decides the format",
)
TRUTH = argument(
    "--reference",
    dest="b",
    metavar="B",
    type=reconstruction,
    required=True,
    help="the truth or another model, in the same formats, or check points in a form of --gcp; "
    "errors are in its frame and its length unit",
)
ALIGNED_TO = argument(
    "--reference",
    metavar="MODEL",
    type=reconstruction,
    help="a model with images of the same names; INPUT is moved into its frame (default: none)",
)
READING = ("input_format", "image_size", "image_list", "reconstruction", "pixel_origin")
"""Destinations of the flags of ``INPUT_FORMAT``."""
INPUT_FORMAT = group(
    "INPUT of another program",
    argument(
        "--input-format",
        metavar="FORMAT",
        choices=FORMATS,
        help=f"format of INPUT: {', '.join(FORMATS)} (default: by its content)",
    ),
    argument(
        "--image-size",
        metavar="W,H",
        help="image sizes of a file without sizes (Bundler, NVM): one size in pixels, `unknown`, "
        "or COLMAP's database.db, with a size for each name (default: from the photographs)",
    ),
    file_argument(
        "--image-list",
        help="names of the images of a Bundler model (default: list.txt beside it or in the folder "
        "above)",
    ),
    argument(
        "--reconstruction",
        metavar="N",
        type=int,
        help="number of the reconstruction in a file with several, from 0 (default: the only one)",
    ),
    argument(
        "--pixel-origin",
        choices=ORIGINS,
        help="origin of the pixels of an NVM file: the center of the image, or the upper left "
        f"corner, as COLMAP writes it (default: {ORIGINS[0]})",
    ),
)


def read_options(given: argparse.Namespace) -> ReadOptions:
    """Return the values of the flags of ``INPUT_FORMAT``."""
    try:
        return ReadOptions.of(
            given.input_format,
            given.image_size,
            given.image_list,
            given.reconstruction,
            given.pixel_origin or ORIGINS[0],
        )
    except InputError as error:
        raise InputError(f"--{str(error).replace('image_size', 'image-size')}") from None


def given_of(arguments: argparse.Namespace, *names: str) -> tuple[str, ...]:
    """Return flags with their values, for those of ``names`` that were given."""
    values = {name: getattr(arguments, name) for name in names}
    return tuple(
        word
        for name, value in values.items()
        if value is not None
        for word in (f"--{name.replace('_', '-')}", str(value))
    )


# OUTPUT, pages and arrays

FORMAT = argument(
    "--format", choices=OUTPUT_FORMATS, help="format of OUTPUT (default: by its name)"
)


def output(
    *names: str, replaces: tuple[str, ...] = ("input",), **settings: Any
) -> tuple[Declaration, ...]:
    """Declare --format, --overwrite and OUTPUT, which may equal the path arguments ``replaces``."""
    target = argument(
        *names,
        metavar="OUTPUT",
        type=PathArgument("output", is_data=True, replaces=replaces),
        help="output path, which may be INPUT; NAME.txt, .txt.gz and .txt.bz2 are BAL files, .out "
        "Bundler, .nvm NVM, sfm_data.json OpenMVG, NAME/ and existing folders COLMAP models; "
        "other names get the format of INPUT",
        use=1,
        **settings,
    )
    overwrite = argument(
        "--overwrite",
        action="store_true",
        help="replace a model of other images at OUTPUT (default: stop if it exists)",
    )
    return target, FORMAT, overwrite


def page(written: str, help: str) -> Declaration:
    """Declare the flag --html."""
    return argument("--html", metavar="FILE", type=page_path(written), help=help, use=90)


PAGE_OUTPUT = argument(
    "-o",
    "--output",
    metavar="FILE.html",
    type=page_path(),
    required=True,
    help="the page to write, a single file",
    use=1,
)
ARRAYS = argument(
    "-o",
    "--output",
    metavar="FILE.npz",
    type=PathArgument("file", format="arrays for NumPy (.npz)", own=".npz"),
    required=True,
    help="arrays for NumPy: pose_ids, pose_covariance (n, 6, 6; rotation in radians, left "
    "perturbation of cam_from_world, then translation), point_ids, point_covariance, "
    "camera_ids, camera_covariance, sigma0, dof and others",
    use=1,
)
RELIABILITY_ARRAYS = argument(
    "-o",
    "--output",
    metavar="FILE.npz",
    type=PathArgument("file", format="arrays for NumPy (.npz)", own=".npz"),
    help="with --reliability, arrays for NumPy: redundancy (n, 2), least_redundancy, "
    "standardized, minimal_detectable_error [px], external_bound and others",
    use=4,
)
SUFFIX = r"(\.txt(\.gz|\.bz2)?)?$"  # suffix of a BAL file


def path_beside(path: str, what: str, suffix: str) -> str:
    """Return the path next to an output, such as OUTPUT_gravity.txt."""
    return f"{re.sub(SUFFIX, '', path.rstrip('/'), count=1, flags=re.I)}_{what}{suffix}"


def ground_truth_path(arguments: argparse.Namespace) -> str | None:
    """Return the path of a scene's true solution; None for a flight, whose folder contains it."""
    if arguments.scene == FLIGHT:
        return None
    path: str = arguments.output
    if arguments.ground_truth:
        return str(arguments.ground_truth)
    if path.endswith("/"):
        return path.rstrip("/") + "_ground_truth/"
    suffix = re.search(SUFFIX, path, re.I)
    return path_beside(path, "ground_truth", "" if suffix is None else suffix.group())


SCENE_OUTPUTS = (
    argument(
        "output",
        metavar="OUTPUT",
        type=PathArgument("output", is_data=True),
        help="output path of the start: NAME.txt, .txt.gz and .txt.bz2 are BAL files, other names "
        "folders of COLMAP models; for a flight the folder of a sequence",
    ),
    FORMAT,
    argument(
        "--ground-truth",
        metavar="PATH",
        type=PathArgument("ground truth", is_data=True, otherwise=ground_truth_path),
        help="output path of the true solution, with the same observations (default: "
        "OUTPUT_ground_truth, next to OUTPUT)",
        use=16,
    ),
    argument(
        "--overwrite",
        action="store_true",
        help="replace existing files at these paths (default: stop if a file exists)",
    ),
)
DEMO_FOLDER = argument(
    "output",
    metavar="FOLDER",
    nargs="?",
    default="bundle_demo",
    type=a_path,
    help="new or empty folder, or that of another demo (default: bundle_demo)",
)


# Knowledge besides the pixels

RIG_CONFIG = file_argument(
    "--rig-config",
    help="make rigs by COLMAP's rig_config.json: images whose names differ only in their prefix "
    "form a frame; missing poses of sensors are means over the frames (default: the rigs of INPUT)",
)
RULES = options(
    "RuleOptions",
    "constraints",
    description="Knowledge in addition to the pixels, such as --set 'cameras *: f prior 2 %' or "
    "--set 'camera 3: cx,cy fixed'. Focal lengths and the principal point are in pixels, positions "
    "in the unit of the model (metres with --gps), rotations in degrees.",
)
MOVED = (
    "The model is first moved to metres east, north, up. The origin is the middle of the control "
    "points or, if there are none, of the GPS positions. "
    f"{GEOREFERENCE} in the folder OUTPUT, or beside the file OUTPUT, describes this frame."
)


def measurements(
    meaning: str = MOVED,
    images_are_for: str = "--gps exif, --orientations xmp, --velocities xmp and --html",
) -> tuple[Declaration, ...]:
    """Declare the flags of all measurements, in the order of their options."""
    images = f"folder of the images, for {images_are_for}"
    kind = options_class()
    names, groups = kind.names(), dict[str, list[Measurement]]()
    for row in sorted(ROWS, key=lambda row: names.index(row.source)):
        groups.setdefault(row.title, []).append(row)
    return (
        *(
            options(kind, title, fields_of(*rows), rows[0].meaning or meaning, images=images)
            for title, rows in groups.items()
        ),
        options(kind, "robustness of all of these", ROBUST),
    )


def placing() -> tuple[Declaration, ...]:
    """Declare the flags of measurements that place a model."""
    rows = [row for row in reversed(ROWS) if row.places]
    return tuple(options(options_class(), row.title, row.fields) for row in rows)


# Single commands

COLMAP_OPTIONS = file_argument(
    "--colmap-options",
    help="take options from the project.ini of `colmap bundle_adjuster`, with COLMAP's "
    "defaults for options that the file lacks; flags replace them (default: none)",
)
CHECK_GRADIENTS = argument(
    "--check-gradients",
    action="store_true",
    help="first check the Jacobians on a sample, as `bundle check` does, and stop with its "
    "report if one is wrong; an undecided check does not stop (default: off)",
)
RECALIBRATE = argument(
    "--recalibrate",
    action="store_true",
    help="measure the rates of this machine again, which takes seconds (default: measured once, "
    "then stored)",
)
METHODS = ("solvers", "backends", "preconditioners", "orderings", "trust_regions", "threads")
EVERY_ORDER = argument(
    "--ordering",
    dest="orders",
    choices=("all",),
    help="compare every elimination order: natural, AMD and METIS for a pose graph, with flops, "
    "nonzeros, predicted and measured times of the factorisations; those of --orderings for a "
    "model",
)


def compared_options() -> Collection[str]:
    """Return the options of a solve that a comparison varies."""
    from bundle.interface.planning_options import COMPARED  # only for this command

    return COMPARED


ALL = argument(
    "--all", action="store_true", help="check every observation, or every factor of a graph"
)
MERGE_ERROR = argument(
    "--max-error",
    metavar="PX",
    type=float,
    default=8.0,
    help="two points at one keypoint are joined if their projections differ by at most this, in "
    "pixels; the difference is the median over the images of both (default: 8)",
)
GLOBAL_SHUTTER = argument(
    "--global-shutter",
    action="store_true",
    help="move the observations of a rolling shutter to where a global shutter would have read "
    "them, for programs that know only global shutters",
)


def FLIGHTS(to: Container) -> None:  # noqa: N802 (a declaration as the others)
    """Declare the scene "flight" and its own options."""
    action = to._option_string_actions["--scene"]
    action.choices = [*(action.choices or ()), FLIGHT]
    action.help = (
        f"{action.help}; {FLIGHT}: a visual-inertial sequence, samples of an IMU and tracks, with "
        "ground_truth.csv in its folder"
    )
    title = f"options of --scene {FLIGHT}, beside --pixel-noise, --outlier-share and --seed"
    options("FlightOptions", title, own_options("FlightOptions", "SceneOptions"))(to)
