"""`bundle synth` of a reconstruction."""

from __future__ import annotations

import argparse
from pathlib import Path

from bundle.cli.commands import ground_truth_path
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_flights
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import check_new, publish
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.scene_options import SceneOptions
from bundle.io.open import check_target, output_format, save
from bundle.io.rolling_shutter_file import LOST_ROLLING_SHUTTER
from bundle.model.reprojection import reprojection_error
from bundle.reports.terminal.synth import synthesized
from bundle.synthetic.blocks import SceneInBlocks
from bundle.synthetic.streamed import SceneTally, write_bal_scene
from bundle.synthetic.synthesis import SyntheticScene, assemble, filmed

__all__ = ["run"]

LOSSES = (LOST_ROLLING_SHUTTER,)
"""Losses of a format that a user who asked for a scene does not expect."""


def run(arguments: argparse.Namespace) -> int:
    """Generate a scene; write its start to OUTPUT, and the ground truth next to it."""
    refuse_flags_of_flights(arguments)
    options = options_given(arguments, SceneOptions)
    path = arguments.output
    truth_path = ground_truth_path(arguments)
    assert truth_path is not None
    if not arguments.overwrite:
        for target in (path, truth_path):
            check_new(target, "--overwrite")
    with Progress(quiet=arguments.quiet) as progress, naming_flags(SceneOptions):
        progress.stage(f"making {options.num_images} images of {options.num_points} points")
        scene = filmed(options) if options.is_filmed else SceneInBlocks(options)
        images = scene.problem if isinstance(scene, SyntheticScene) else scene.images()
        format = output_format(images.format, path, arguments.format)
        check_target(images, path, format)
        check_target(images, truth_path, format)
        lost: list[str] = []
        is_plain = not any(name.lower().endswith((".gz", ".bz2")) for name in (path, truth_path))
        streams = format == "bal" and is_plain
        if streams and isinstance(scene, SceneInBlocks) and scene.num_blocks > 1:
            tally = write_bal_scene(scene, Path(path), Path(truth_path), progress.share)
        else:
            made = assemble(scene) if isinstance(scene, SceneInBlocks) else scene
            tally = _tally(made)
            progress.stage(f"writing {shown(path)}")
            save(made.problem, path, format)
            lost = [one for one in save(made.ground_truth, truth_path, format) if one in LOSSES]
    output = {"path": path, "format": format}
    truth = {"path": truth_path, "format": format}
    report = synthesized(options, images.num_cameras, tally, output, truth, lost)
    publish(report, arguments)
    return EXIT_DONE


def _tally(scene: SyntheticScene) -> SceneTally:
    problem = scene.problem
    tally = SceneTally(problem.num_images)
    tally.add(problem.observation_image, problem.observation_point, scene.is_outlier)
    tally.errors = {
        "start": reprojection_error(problem),
        "ground_truth": reprojection_error(scene.ground_truth),
    }
    return tally
