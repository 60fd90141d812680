"""`bundle covariance`."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.cli.constraint_flags import add_constraint_flags, as_options, constraints_given
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.gps_flags import NAMED, add_gps_flags, check_gps_flags, main_flag
from bundle.cli.option_flags import (
    WHAT_IS_REFINED,
    add_options,
    naming_flags,
    options_given,
    with_named_images,
)
from bundle.cli.parser import add_input
from bundle.cli.path_checks import PathArgument
from bundle.cli.pose_graph_flags import add_pose_graph_flags, refuse_flags_of_graphs
from bundle.interface.options import SolveOptions
from bundle.io.recognition import is_pose_graph_file

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "covariance"
HELP = (
    "how certain poses, points and intrinsics, or the poses of a pose graph are: their marginal "
    "covariances"
)

OPTIONS = (*WHAT_IS_REFINED, "loss", "loss_scale")
"""What decides the information of a problem."""

FLAGS = {name: f"--{name}" for name in ("of", "relative", "gauge", "scale", "robust")}
"""Of the arguments of ``bundle.covariance``."""


def _word(text: str) -> str:
    return text.lower().replace("_", "-")


def _pairs(text: str) -> list[tuple[int, int]]:
    """Return the pairs that "1:2,7:3" names."""
    pairs = []
    for part in text.split(","):
        a, _, b = part.partition(":")
        try:
            pairs.append((int(a), int(b)))
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"expected pairs A:B of image ids such as 1:2,7:3, found {text!r}"
            ) from None
    return pairs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
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
    group = parser.add_argument_group("what is wanted")
    group.add_argument(
        "--of",
        metavar="LIST",
        type=_word,
        help="some of poses, points, intrinsics (default: all)",
    )
    group.add_argument(
        "--relative",
        metavar="A:B,...",
        type=_pairs,
        default=[],
        help="pairs of image ids: covariances of cam_b_from_cam_a; of a pose graph pairs of pose "
        "ids, of X_a^-1 X_b (default: none)",
    )
    group.add_argument(
        "--gauge",
        dest="covariance_gauge",  # it has one more than that of a solve
        type=_word,
        choices=("inner", "two-cameras", "three-points", "none", "first"),
        help="how position, direction and scale of the world are held: inner gives the least trace "
        "(the pseudo-inverse); none: by priors or what is fixed; first, for pose graphs: as a "
        "solve does, by the first pose of each component without a fixed one (default: inner; pose "
        "graphs: first)",
    )
    group.add_argument(
        "--scale",
        type=_word,
        choices=("unit", "sigma0"),
        default="unit",
        help="unit: residuals have a sigma of 1 px; sigma0: the one that they show; priors keep "
        "theirs (default: unit)",
    )
    group.add_argument(
        "--robust",
        type=_word,
        choices=("weights", "sandwich"),
        help="what --loss means: weights of observations, or H^-1 (sum psi psi^T) H^-1, which "
        "holds for residuals of any distribution (default: weights)",
    )
    add_options(parser, SolveOptions, "what is refined, as in the solve", OPTIONS)
    add_constraint_flags(parser)
    add_gps_flags(
        parser,
        "The priors of the refine that made INPUT, by the same flags: in metres east, north, up "
        "about the middle of the control points, or of the positions where there are none, where "
        "it has put INPUT. Nothing is moved.",
    )
    add_pose_graph_flags(
        parser, ("error", "information", "loss", "loss_on"), "pose graphs (.g2o), beside the loss"
    )
    parser.set_defaults(html=None, only_images=None)  # of a refine


def run(arguments: argparse.Namespace) -> int:
    """Compute the covariances of INPUT."""
    started = perf_counter()
    if is_pose_graph_file(arguments.input):
        from bundle.cli.pose_graph_analyses import covariance_of_graph_file

        return covariance_of_graph_file(arguments)
    refuse_flags_of_graphs(arguments)
    from bundle.analysis.uncertainty.compute_covariance import covariance
    from bundle.cli.gps_flags import priors_given
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.open import load
    from bundle.reports.terminal.covariance import uncertainties

    source, target = arguments.input, arguments.output
    options = options_given(arguments, SolveOptions, names_follow=True)
    check_gps_flags(arguments, options)
    rules = constraints_given(arguments)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        problem = load(source, progress.text)
        options = with_named_images(options, arguments, problem)
        known = priors_given(arguments, problem)
        progress.stage("inverting")
        flags = {**FLAGS, **NAMED, "priors": main_flag(arguments)}
        with naming_flags(SolveOptions, **flags):
            found = covariance(
                problem,
                options,
                of=arguments.of or "poses,points,intrinsics",
                relative=arguments.relative,
                gauge=arguments.covariance_gauge or "inner",
                scale=arguments.scale,
                robust=arguments.robust or "weights",
                priors=() if known is None else known.priors,
                constraints=rules,
            )
        progress.stage(f"writing {shown(target)}")
        found.save(target)
    wall = perf_counter() - started
    asked = {name: getattr(options, name) for name in OPTIONS} | as_options(arguments)
    publish(uncertainties(source, problem, found, asked, target, wall), arguments.json)
    return EXIT_DONE
