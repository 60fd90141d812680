"""`bundle synth`."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flight_synthesis import (
    FLIGHT,
    add_flight_flags,
    refuse_flight_flags,
    run_flight,
)
from bundle.cli.option_flags import add_options, naming_flags, options_given
from bundle.cli.path_checks import PathArgument
from bundle.errors import shown
from bundle.interface.scene_options import SceneOptions
from bundle.io.open import FORMATS
from bundle.model.reprojection import reprojection_error

if TYPE_CHECKING:
    from bundle.synthetic.scene_tally import SceneTally
    from bundle.synthetic.synthesis import SyntheticScene

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "synth"
HELP = "seeded synthetic scenes with ground truth, from toy to millions of observations"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.add_argument(
        "output",
        metavar="OUTPUT",
        type=PathArgument("output", is_data=True),
        help="where the start goes: NAME.txt, .txt.gz and .txt.bz2 are BAL files, other names "
        "folders of COLMAP models; of a flight the folder of a sequence",
    )
    parser.add_argument(
        "--format", choices=FORMATS, help="format of OUTPUT (default: what its name says)"
    )
    parser.add_argument(
        "--ground-truth",
        metavar="PATH",
        type=PathArgument("ground truth", is_data=True, otherwise=_truth_path),
        help="where the true solution goes, with the same observations (default: beside OUTPUT, "
        "OUTPUT_ground_truth)",
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace what stands at these paths (default: stop if there is anything)",
    )
    add_options(parser, SceneOptions, "options of the scene")
    add_flight_flags(parser)


def run(arguments: argparse.Namespace) -> int:
    """Make a scene; write its start to OUTPUT and the truth beside it."""
    if arguments.scene == FLIGHT:
        return run_flight(arguments)
    refuse_flight_flags(arguments)
    from bundle.cli.output import check_new, publish
    from bundle.cli.progress import Progress
    from bundle.io.open import check_target, output_format, save
    from bundle.reports.terminal.synth import synthesized
    from bundle.synthetic.blocks import SceneInBlocks
    from bundle.synthetic.synthesis import assemble

    options = options_given(arguments, SceneOptions)
    path = arguments.output
    truth_path = _truth_path(arguments)
    assert truth_path is not None
    if not arguments.overwrite:
        for target in (path, truth_path):
            check_new(target, "--overwrite")
    with Progress(quiet=arguments.quiet) as progress, naming_flags(SceneOptions):
        progress.stage(f"making {options.num_images} images of {options.num_points} points")
        scene = SceneInBlocks(options)
        images = scene.images()
        format = output_format(images, path, arguments.format)
        check_target(images, path, format)
        check_target(images, truth_path, format)
        is_plain = not any(name.lower().endswith((".gz", ".bz2")) for name in (path, truth_path))
        if format == "bal" and is_plain and scene.num_blocks > 1:
            from bundle.synthetic.streamed import write_bal_scene

            tally = write_bal_scene(scene, Path(path), Path(truth_path), progress.share)
        else:
            made = assemble(scene)
            tally = _tally(made)
            progress.stage(f"writing {shown(path)}")
            save(made.problem, path, format)
            save(made.ground_truth, truth_path, format)
    output = {"path": path, "format": format}
    truth = {"path": truth_path, "format": format}
    report = synthesized(options, images.num_cameras, tally, output, truth)
    publish(report, arguments.json)
    return EXIT_DONE


def _truth_path(arguments: argparse.Namespace) -> str | None:
    """Return where the true solution goes; None of a flight, whose folder has it."""
    if arguments.scene == FLIGHT:
        return None
    truth: str | None = arguments.ground_truth
    return truth or _beside(arguments.output)


def _beside(path: str) -> str:
    """Return "folder_ground_truth" for a folder, "name_ground_truth.txt.bz2" for a BAL file."""
    if path.endswith("/"):
        return path.rstrip("/") + "_ground_truth/"
    return re.sub(r"((\.txt(\.gz|\.bz2)?)?)$", r"_ground_truth\1", path, count=1, flags=re.I)


def _tally(scene: SyntheticScene) -> SceneTally:
    from bundle.synthetic.scene_tally import SceneTally

    problem = scene.problem
    tally = SceneTally(problem.num_images)
    tally.add(problem.observation_image, problem.observation_point, scene.is_outlier)
    tally.errors = {
        "start": reprojection_error(problem),
        "ground_truth": reprojection_error(scene.ground_truth),
    }
    return tally
