"""Arguments of the commands that measure and predict; they do not change the model."""

from __future__ import annotations

import argparse

from bundle.cli.dispatch import GRAPH_FILE, SEVERAL, SHAPE, kind_of_input
from bundle.cli.flags_by_kind import add_pose_graph_flags
from bundle.cli.option_flags import add_fields, add_options
from bundle.cli.path_checks import PathArgument, page_path, reconstruction
from bundle.cli.recording_flags import add_recording_flags
from bundle.cli.shared_arguments import (
    add_georeference,
    add_input,
    add_input_format,
    add_rig_config,
    add_rules,
)
from bundle.interface.options import INFORMATION, LINEARIZATION, PATTERN, SolveOptions

Parser = argparse.ArgumentParser


def add_info(parser: Parser) -> None:
    """Add the arguments of `bundle info`."""
    parser.usage = "bundle info INPUT... [options]"
    add_input(parser, "inputs", nargs="+")
    add_input_format(parser)
    add_rig_config(parser)
    add_recording_flags(parser)
    parser.set_defaults(kind=lambda _: SEVERAL)


def add_inspect(parser: Parser) -> None:
    """Add the arguments of `bundle inspect`."""
    parser.usage = "bundle inspect INPUT [options]\n       bundle inspect --graph FILE [options]"
    parser.add_argument(
        "input",
        metavar="INPUT",
        type=reconstruction,
        nargs="?",
        help=(
            "a BAL file (plain, .gz or .bz2) or the folder of a COLMAP model (binary or text) or a "
            "pose graph (g2o); the format is detected automatically"
        ),
    )
    parser.add_argument(
        "--html",
        metavar="FILE",
        type=page_path("report"),
        help="also write a page with figures, which needs no network",
    )
    parser.add_argument(
        "--recalibrate",
        action="store_true",
        help=(
            "measure the rates of this machine again, which takes seconds (default: measured once, "
            "then stored)"
        ),
    )
    add_options(parser, "SolveOptions", "what is refined", PATTERN)
    add_options(parser, "RankOptions", "several processes (docs/mpi.md)")
    add_options(parser, "GraphFileOptions", "a graph in place of a problem")
    add_options(parser, "ShapeOptions", "numbers in place of a problem")
    parser.set_defaults(kind=_kind_of_inspection)


def _kind_of_inspection(given: argparse.Namespace) -> str:
    if given.shape is not None:
        return SHAPE
    return GRAPH_FILE if given.graph or not given.input else kind_of_input(given)


def add_compare(parser: Parser) -> None:
    """Add the arguments of `bundle compare`."""
    from bundle.interface.planning_options import COMPARED  # only for this command

    parser.usage = "bundle compare INPUT... [options]"
    parser.add_argument(
        "inputs",
        metavar="INPUT",
        type=reconstruction,
        nargs="+",
        help=(
            "BAL files (plain, .gz or .bz2) and folders of COLMAP models; several inputs also give "
            "performance profiles; or one pose graph (g2o)"
        ),
    )
    compared = ("solvers", "backends", "preconditioners", "orderings", "trust_regions", "threads")
    add_options(parser, "CompareOptions", "what is compared: every combination of", compared)
    parser.add_argument(
        "--ordering",
        dest="orders",
        choices=("all",),
        help="compare every elimination order: of a pose graph natural, AMD and METIS, with flops, "
        "nonzeros, predicted and measured times of the factorisations; of a model those of "
        "--orderings",
    )
    group = parser.add_argument_group("options of the comparison")
    add_fields(group, "CompareOptions", ("perturb", "seed", "repeat", "timeout", "memory_cap"))
    group.add_argument(
        "--html", metavar="FILE", type=page_path(), help="also write a page with plots"
    )
    others = [name for name in SolveOptions.__dataclass_fields__ if name not in COMPARED]
    add_options(parser, "SolveOptions", "options of every solve", others)
    add_pose_graph_flags(
        parser,
        ("error", "init", "information", "loss", "loss_on"),
        "a pose graph (.g2o), of which backends and threads are compared too",
    )


def add_check(parser: Parser) -> None:
    """Add the arguments of `bundle check`."""
    add_input(parser)
    group = parser.add_argument_group("options of the check")
    which = group.add_mutually_exclusive_group()
    add_fields(which, "CheckOptions", ("samples_per_image",))
    which.add_argument(
        "--all", action="store_true", help="check every observation, or every factor of a graph"
    )
    add_fields(group, "CheckOptions", ("seed", "tolerance", "num_threads"))
    group.add_argument(
        "--html",
        metavar="FILE",
        type=page_path(),
        help="also write a page: wrong entries, and curves against the step size",
    )
    add_pose_graph_flags(parser, ("error",), "pose graphs (.g2o)")


def add_covariance(parser: Parser) -> None:
    """Add the arguments of `bundle covariance`."""
    parser.usage = "bundle covariance INPUT -o FILE.npz [options]"
    add_input(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE.npz",
        type=PathArgument("file", format="arrays for NumPy (.npz)", own=".npz"),
        required=True,
        help="arrays for NumPy: pose_ids, pose_covariance (n, 6, 6; rotation in radians, left "
        "perturbation of cam_from_world, then translation), point_ids, point_covariance, "
        "camera_ids, camera_covariance, sigma0, dof and others",
    )
    add_options(parser, "CovarianceOptions", "what is wanted")
    add_options(parser, "SolveOptions", "what is refined, as in the solve", INFORMATION)
    add_rules(parser)
    add_georeference(
        parser,
        "The priors of the refine that made INPUT, by the same flags: in metres east, north, up "
        "about the middle of the control points, or of the positions where there are none, where "
        "it has put INPUT. Nothing is moved.",
        "--gps exif",
    )
    add_pose_graph_flags(
        parser, ("error", "information", "loss", "loss_on"), "pose graphs (.g2o), beside the loss"
    )


def add_diagnose(parser: Parser) -> None:
    """Add the arguments of `bundle diagnose`."""
    parser.usage = "bundle diagnose INPUT [options]"
    add_input(parser)
    add_rig_config(parser)
    add_options(parser, "SolveOptions", "what would be refined", LINEARIZATION)
    add_rules(parser)
    add_georeference(
        parser,
        "What a refine with the same flags would be given; the model is looked at in metres about "
        "the middle of the control points, or of the positions where there are none.",
        "--gps exif",
    )
    names = ("error", "information", "loss", "loss_on")
    add_pose_graph_flags(parser, names, "pose graphs (.g2o), beside loss and threads")


def add_report(parser: Parser) -> None:
    """Add the arguments of `bundle report`."""
    parser.usage = "bundle report INPUT -o FILE.html [options]"
    add_input(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE.html",
        type=page_path(),
        required=True,
        help="the page to write, a single file",
    )
    add_rig_config(parser)
    add_rules(parser)
    add_georeference(
        parser,
        "The priors of the refine that made INPUT, by the same flags: how certain it is depends on "
        "them. Nothing is moved.",
        "--gps exif and residuals of the worst images on their photographs",
    )


def add_validate(parser: Parser) -> None:
    """Add the arguments of `bundle validate`."""
    parser.usage = "bundle validate INPUT [options]"
    add_input(parser)
    candidates = ("camera_models", "share", "losses", "refine_sets")
    add_options(parser, "ValidationOptions", "candidates: every combination of", candidates)
    group = parser.add_argument_group("options of the validation")
    add_fields(group, "ValidationOptions", ("num_folds", "seed"))
    group.add_argument(
        "--html", metavar="FILE", type=page_path(), help="also write a page with the curves"
    )
    add_rig_config(parser)
    others = [n for n in SolveOptions.__dataclass_fields__ if n not in ("loss", "refine")]
    add_options(parser, "SolveOptions", "options of every solve", others)
    add_rules(parser)
    add_georeference(
        parser,
        "Priors of every fit. The report has the errors at check points and at positions.",
        "--gps exif",
    )
