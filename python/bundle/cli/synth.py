"""`bundle synth`."""

from __future__ import annotations

import argparse
import dataclasses
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    from rich.console import RenderableType

    from bundle.synthetic.scene_tally import SceneTally
    from bundle.synthetic.synthesis import SyntheticScene

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "synth"
_ERRORS = ("rmse", "median", "p95", "max")
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
    from bundle.cli.output import check_new, show, write_json
    from bundle.cli.progress import Progress
    from bundle.io.open import check_target, output_format, save
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
    report = _report(options, images.num_cameras, tally, output, truth)
    if arguments.json != "-":
        show(*_tables(report))
    write_json(arguments.json, report)
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


def _report(
    options: SceneOptions,
    num_cameras: int,
    tally: SceneTally,
    output: dict[str, str],
    truth: dict[str, str],
) -> dict[str, Any]:
    """Return the report for programs, which is also what the table for people shows."""
    from bundle import __version__
    from bundle.reports.terminal.json import SCHEMA, plain

    report: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "command": NAME,
            "version": __version__,
            "options": options.asdict(),
            "output": output,
            "ground_truth": truth,
            "num_cameras": num_cameras,
            "num_images": options.num_images,
            "num_points": options.num_points,
            "num_observations": tally.num_observations,
            "num_outliers": tally.num_outliers,
            "track_length": tally.track_length(),
            "observations_per_image": tally.image_size(),
            "reprojection_error": {
                name: dataclasses.asdict(errors) for name, errors in tally.errors.items()
            },
        }
    )
    return report


def _tables(report: dict[str, Any]) -> list[RenderableType]:
    """Return what was written and its statistics."""
    from bundle.base.tables import columns, facts, format_name, number, pixels, plural

    output, truth = report["output"], report["ground_truth"]
    things = ("image", "camera", "point", "observation", "outlier")
    contents = ", ".join(plural(report[f"num_{thing}s"], thing) for thing in things)
    written = [
        ("output", f"{shown(output['path'])} ({format_name(output['format'])})"),
        ("ground truth", f"{shown(truth['path'])} ({format_name(truth['format'])})"),
        ("", contents),
    ]
    spread = [
        (label, *(number(report[name][key]) for key in ("min", "median", "mean", "max")))
        for label, name in (
            ("track length", "track_length"),
            ("observations per image", "observations_per_image"),
        )
    ]
    errors = [
        (label, *(pixels(report["reprojection_error"][name][key]) for key in _ERRORS))
        for label, name in (("start", "start"), ("ground truth", "ground_truth"))
    ]
    return [
        facts(written),
        columns(("", "min", "median", "mean", "max"), spread),
        columns(("error in pixels", *_ERRORS), errors),
    ]
