"""Arguments of every command: INPUT, OUTPUT and reports; options come from their classes.

``ARGUMENTS`` maps each command to the function that declares its arguments. The function that runs
the command is in ``bundle.cli.dispatch``.
"""

from __future__ import annotations

import argparse
import re

from bundle.cli.analysis_commands import (
    add_check,
    add_compare,
    add_covariance,
    add_diagnose,
    add_info,
    add_inspect,
    add_report,
    add_validate,
)
from bundle.cli.dispatch import FLIGHT
from bundle.cli.flags_by_kind import add_flight_flags, add_pose_graph_flags
from bundle.cli.inertial_flags import add_inertial_flags
from bundle.cli.option_flags import add_fields, add_options
from bundle.cli.path_checks import (
    PathArgument,
    a_path,
    page_path,
    reconstruction,
    telemetry_path,
    trajectory_path,
)
from bundle.cli.recording_flags import add_recording_flags
from bundle.cli.shared_arguments import (
    CONTROL_POINTS,
    POSITIONS,
    ROBUSTNESS,
    add_common,
    add_format,
    add_georeference,
    add_input,
    add_input_format,
    add_output,
    add_rig_config,
    add_rules,
)

__all__ = ["ARGUMENTS", "add_common", "ground_truth_path", "path_beside"]

Parser = argparse.ArgumentParser


def _refine(parser: Parser) -> None:
    parser.usage = "bundle refine INPUT -o OUTPUT [options]"
    add_input(parser)
    add_output(parser, "-o", "--output", required=True)
    add_input_format(parser)
    add_rig_config(parser)
    add_options(parser, "SolveOptions", "options of the solve")
    parser.add_argument(
        "--colmap-options",
        metavar="FILE",
        type=a_path,
        help="take options from the project.ini of `colmap bundle_adjuster`, with COLMAP's "
        "defaults for options that the file lacks; flags replace them (default: none)",
    )
    add_pose_graph_flags(parser)
    add_options(parser, "RoundOptions", "rounds of adjusting and filtering")
    add_options(parser, "HoldOutOptions", "held-out observations")
    add_rules(parser)
    add_georeference(parser)
    add_inertial_flags(parser)
    add_options(parser, "LensOptions", "cameras of OUTPUT")
    add_options(parser, "ShutterOptions", "rolling shutters")
    add_fields(parser, "LocalOptions")
    add_options(parser, "LoopOptions", "loops")
    add_options(parser, "CheckpointOptions", "runs that may be killed")
    add_options(parser, "OutOfCoreOptions", "problems that are larger than the memory")
    parser.add_argument(
        "--html",
        metavar="FILE",
        type=page_path(),
        help="also write a report page, as `bundle report` does, with residuals before and after; "
        "--images DIR has its photographs (default: none)",
    )
    parser.add_argument(
        "--check-gradients",
        action="store_true",
        help=(
            "first check the Jacobians on a sample, as `bundle check` does, and stop with its "
            "report if one is wrong; an undecided check does not stop (default: off)"
        ),
    )


def _align(parser: Parser) -> None:
    parser.usage = "bundle align INPUT -o OUTPUT [--gcp FILE] [--gps exif|FILE] [options]"
    add_input(parser)
    add_output(parser, "-o", "--output", required=True)
    add_options(parser, "GeoreferenceOptions", "ground control points", CONTROL_POINTS)
    add_options(parser, "GeoreferenceOptions", "positions of images", POSITIONS)
    group = parser.add_argument_group("another model")
    group.add_argument(
        "--reference",
        metavar="MODEL",
        type=reconstruction,
        help="a model with images of the same names; INPUT is moved into its frame (default: none)",
    )
    add_options(parser, "GeoreferenceOptions", "robustness", ROBUSTNESS)


def _merge(parser: Parser) -> None:
    parser.usage = "bundle merge A B -o OUTPUT [options]"
    parser.add_argument(
        "a",
        metavar="A",
        type=reconstruction,
        help="a COLMAP model, whose frame, poses and ids stay",
    )
    parser.add_argument(
        "b",
        metavar="B",
        type=reconstruction,
        help="a COLMAP model with some images of the same names",
    )
    add_output(parser, "-o", "--output", required=True, replaces=("a", "b"))
    parser.add_argument(
        "--max-error",
        metavar="PX",
        type=float,
        default=8.0,
        help=(
            "two points at one keypoint are joined if their projections differ by at most this, in "
            "pixels; the difference is the median over the images of both (default: 8)"
        ),
    )


def _evaluate(parser: Parser) -> None:
    parser.usage = "bundle evaluate A --reference B [options]"
    parser.add_argument(
        "a",
        metavar="A",
        type=reconstruction,
        help="a COLMAP model, a BAL file, or a file of poses: TUM, EuRoC, KITTI, or a list with "
        "lines of name qw qx qy qz tx ty tz; told by its content",
    )
    parser.add_argument(
        "--reference",
        metavar="B",
        type=reconstruction,
        required=True,
        help="the truth or another model, in the same formats, or check points in ODM's "
        "gcp_list.txt; errors are in its frame and its length unit",
    )
    add_options(parser, "EvaluateOptions", "options of the comparison")
    parser.add_argument(
        "--html",
        metavar="FILE",
        type=page_path(),
        help="also write a page with errors per image, paths from above and lenses",
    )


def _triage(parser: Parser) -> None:
    parser.usage = "bundle triage OLD.json NEW.json [options]"
    for name, which in (("old", "earlier"), ("new", "later")):
        parser.add_argument(
            name,
            metavar=f"{name.upper()}.json",
            type=a_path,
            help=f"the {which} report of bundle refine, vio or compare (--json FILE)",
        )
    add_options(parser, "TriageOptions", "noise")


def _vio(parser: Parser) -> None:
    parser.usage = "bundle vio SEQUENCE -o FILE.tum [options]"
    parser.add_argument(
        "sequence",
        metavar="SEQUENCE",
        type=reconstruction,
        help="images and IMU samples: EuRoC's or TUM-VI's mav0 or its parent, a ROS 1 or 2 bag, or "
        "a video with --imu; or tracks in place of images: a folder with imu.csv, tracks.csv and "
        "calibration.yaml, or a table of both that bundle convert reads",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE.tum",
        type=trajectory_path,
        required=True,
        help=(
            "poses world_from_imu of the solved images, one per line: timestamp in seconds, tx ty "
            "tz, qx qy qz qw; z is up"
        ),
    )
    parser.add_argument(
        "--ground-truth",
        metavar="FILE",
        type=a_path,
        help="compare with it: EuRoC's csv or a TUM file",
    )
    parser.add_argument(
        "--telemetry",
        metavar="FILE.jsonl",
        type=telemetry_path,
        help="one line of JSON per keyframe, written when the keyframe is complete",
    )
    parser.add_argument(
        "--html",
        metavar="PAGE",
        type=page_path(),
        help="a page with the curves of the telemetry and the path, a single file",
    )
    loops = parser.add_argument_group("two loops")
    loops.add_argument(
        "--publish",
        metavar="FILE.tum",
        type=trajectory_path,
        help=(
            "a pose per IMU sample: the last solution of the window, propagated and corrected by "
            "closures"
        ),
    )
    loops.add_argument(
        "--loops",
        metavar="FILE",
        type=a_path,
        help="closures: csv of first_timestamp_ns, second_timestamp_ns, tx ty tz, qx qy qz qw of "
        "the IMU at the second time in its frame at the first, sigmas in metres and degrees; or a "
        "g2o file whose ids are the stamps",
    )
    loops.add_argument(
        "--real-time",
        action="store_true",
        help="replay at the rate of the sensors and report how late the poses are",
    )
    add_recording_flags(parser)
    add_options(parser, "WindowOptions", "the window")


def _convert(parser: Parser) -> None:
    add_input(parser)
    add_output(parser, "output")
    add_input_format(parser)
    add_rig_config(parser)
    add_recording_flags(parser)
    add_options(parser, "LensOptions", "cameras of OUTPUT")
    parser.add_argument(
        "--global-shutter",
        action="store_true",
        help=(
            "move the observations of a rolling shutter to where a global shutter would have read "
            "them, for programs that know only global shutters"
        ),
    )


def _synth(parser: Parser) -> None:
    parser.add_argument(
        "output",
        metavar="OUTPUT",
        type=PathArgument("output", is_data=True),
        help=(
            "output path of the start: NAME.txt, .txt.gz and .txt.bz2 are BAL files, other names "
            "folders of COLMAP models; for a flight the folder of a sequence"
        ),
    )
    add_format(parser)
    parser.add_argument(
        "--ground-truth",
        metavar="PATH",
        type=PathArgument("ground truth", is_data=True, otherwise=ground_truth_path),
        help=(
            "output path of the true solution, with the same observations (default: "
            "OUTPUT_ground_truth, next to OUTPUT)"
        ),
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace existing files at these paths (default: stop if a file exists)",
    )
    add_options(parser, "SceneOptions", "options of the scene")
    add_flight_flags(parser)
    parser.set_defaults(kind=lambda given: FLIGHT if given.scene == FLIGHT else "scene")


def _demo(parser: Parser) -> None:
    parser.usage = "bundle demo [FOLDER] [options]"
    parser.add_argument(
        "output",
        metavar="FOLDER",
        nargs="?",
        default="bundle_demo",
        type=a_path,
        help="new or empty folder, or that of another demo (default: bundle_demo)",
    )


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


SUFFIX = r"(\.txt(\.gz|\.bz2)?)?$"
"""Suffix of a BAL file."""


def path_beside(path: str, what: str, suffix: str) -> str:
    """Return the path next to an output, such as OUTPUT_gravity.txt."""
    return f"{re.sub(SUFFIX, '', path.rstrip('/'), count=1, flags=re.I)}_{what}{suffix}"


ARGUMENTS = {
    "info": add_info,
    "inspect": add_inspect,
    "refine": _refine,
    "compare": add_compare,
    "validate": add_validate,
    "check": add_check,
    "covariance": add_covariance,
    "diagnose": add_diagnose,
    "align": _align,
    "merge": _merge,
    "evaluate": _evaluate,
    "report": add_report,
    "triage": _triage,
    "vio": _vio,
    "convert": _convert,
    "synth": _synth,
    "demo": _demo,
}
"""Functions that declare the arguments of the commands."""
