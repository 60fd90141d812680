"""`bundle synth`: a reconstruction, or a visual-inertial sequence."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from bundle.cli.commands import ground_truth_path, path_beside
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_flights, refuse_flags_of_scenes
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import check_new, publish
from bundle.cli.progress import Progress
from bundle.errors import InputError, shown
from bundle.georeference.attitude_files import gravity_text, orientation_text
from bundle.georeference.attitude_priors import AttitudePrior, GravityPrior, OrientationPrior
from bundle.interface.scene_options import FlightOptions, SceneOptions
from bundle.io.atomic import atomic_write as atomic
from bundle.io.open import check_target, output_format, save
from bundle.io.rolling_shutter_file import LOST_ROLLING_SHUTTER
from bundle.io.sequences.sequence_folder import check_sequence_target
from bundle.model.problem import Problem
from bundle.model.reprojection import reprojection_error
from bundle.reports.terminal.synth import made_flight, synthesized
from bundle.synthetic.blocks import SceneInBlocks
from bundle.synthetic.streamed import SceneTally, write_bal_scene
from bundle.synthetic.synthesis import SyntheticScene, assemble, filmed, measured_attitudes
from bundle.synthetic.synthetic_flight import save_flight, synthesize_flight

LOSSES = (LOST_ROLLING_SHUTTER,)
"""Losses of a format that a user who asked for a scene does not expect."""


def run(arguments: argparse.Namespace) -> int:
    """Generate a scene; write its start to OUTPUT, and the ground truth next to it."""
    refuse_flags_of_flights(arguments)
    options = options_given(arguments, SceneOptions)
    path = arguments.output
    truth_path = ground_truth_path(arguments)
    assert truth_path is not None
    beside = _files_of_attitudes(options, path, (truth_path, arguments.json))
    if not arguments.overwrite:
        for target in (path, truth_path, *beside.values()):
            check_new(target, "--overwrite")
    with Progress(quiet=arguments.quiet) as progress, naming_flags(SceneOptions):
        progress.stage(f"making {options.num_images} images of {options.num_points} points")
        scene = filmed(options) if options.is_filmed else SceneInBlocks(options)
        images = scene.problem if isinstance(scene, SyntheticScene) else scene.images()
        format = output_format(images.format, path, arguments.format)
        check_target(images, path, format)
        check_target(images, truth_path, format)
        for target in beside.values():
            atomic.check_file(Path(target))
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
        true = scene.ground_truth if isinstance(scene, SyntheticScene) else images
        _write_attitudes(beside, measured_attitudes(true, options), true, format)
    output = {"path": path, "format": format}
    truth = {"path": truth_path, "format": format}
    report = synthesized(options, images.num_cameras, tally, output, truth, beside, lost)
    publish(report, arguments)
    return EXIT_DONE


def _files_of_attitudes(
    options: SceneOptions, path: str, others: Iterable[str | None]
) -> dict[str, str]:
    """Return the paths of the measured attitudes next to OUTPUT, by kind.

    Raises:
        InputError: another output has the same path.
    """
    given = {"gravity": options.gravity_sigma, "orientations": options.orientation_sigma}
    found = {kind: path_beside(path, kind, ".txt") for kind, sigma in given.items() if sigma}
    for kind, target in found.items():
        if any(other and Path(other) == Path(target) for other in others):
            raise InputError(f"{shown(target)}: expected a path for --{kind} alone, found two")
    return found


def _write_attitudes(
    paths: dict[str, str], priors: tuple[AttitudePrior, ...], images: Problem, format: str
) -> None:
    """Write the priors of each kind; a BAL file knows images by their index alone."""
    ids = images.image_ids.tolist()
    words = map(str, range(len(ids))) if format == "bal" else images.image_names
    names = dict(zip(ids, words, strict=True))
    for kind, path in paths.items():
        if kind == "gravity":
            gravity = (prior for prior in priors if isinstance(prior, GravityPrior))
            text = gravity_text(gravity, names.__getitem__)
        else:
            orientations = (prior for prior in priors if isinstance(prior, OrientationPrior))
            text = orientation_text(orientations, names.__getitem__)
        atomic.write_text(Path(path), text)


def _tally(scene: SyntheticScene) -> SceneTally:
    problem = scene.problem
    tally = SceneTally(problem.num_images)
    tally.add(problem.observation_image, problem.observation_point, scene.is_outlier)
    tally.errors = {
        "start": reprojection_error(problem),
        "ground_truth": reprojection_error(scene.ground_truth),
    }
    return tally


def run_flight(arguments: argparse.Namespace) -> int:
    """Generate a flight and write its measurements and ground truth."""
    refuse_flags_of_scenes(arguments)
    options = options_given(arguments, FlightOptions)
    path = arguments.output
    if not arguments.overwrite:
        check_new(path, "--overwrite")
    check_sequence_target(path)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"making {options.duration:g} s of flight")
        with naming_flags(FlightOptions):
            flight = synthesize_flight(options)
        progress.stage(f"writing {shown(path)}")
        save_flight(flight, path)
    publish(made_flight(path, flight.sequence, options), arguments)
    return EXIT_DONE
