"""`bundle synth`: a reconstruction or a visual-inertial sequence; and `bundle demo`.

The scene of the demo is a synthetic street of 32 images with 1 % gross outliers
(data/street_colmap), which the package carries. The command unpacks it into FOLDER/scene and runs
`bundle refine` on it, so that the commands that the report proposes work there, too.
"""

from __future__ import annotations

import argparse
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from bundle.cli.commands import FLIGHT
from bundle.cli.declarations import ground_truth_path, path_beside
from bundle.cli.error_lines import EXIT_DONE, print_out
from bundle.cli.option_flags import naming_flags, own_options
from bundle.cli.output import check_new
from bundle.cli.run import given_flags
from bundle.errors import InputError, shown
from bundle.interface.scene_options import FlightOptions, SceneOptions
from bundle.io.atomic import atomic_write as atomic
from bundle.reports.sections import Report

if TYPE_CHECKING:
    from bundle.cli.run import Run
    from bundle.georeference.attitude_priors import AttitudePrior
    from bundle.model.problem import Problem
    from bundle.synthetic.blocks import SceneTally
    from bundle.synthetic.synthesis import SyntheticScene


def make_scene(run: Run) -> Report:
    """Generate a scene; write its start to OUTPUT, and the ground truth next to it."""
    from bundle.io.open import check_target, output_format, save
    from bundle.io.rolling_shutter_file import LOST_ROLLING_SHUTTER
    from bundle.reports.terminal.outputs import synthesized
    from bundle.synthetic.blocks import SceneInBlocks, write_bal_scene
    from bundle.synthetic.synthesis import SyntheticScene, assemble, filmed, measured_attitudes

    arguments, progress, path = run.arguments, run.progress, run.target
    for flag in given_flags(arguments, own_options("FlightOptions", "SceneOptions")):
        scene_given = arguments.scene or SceneOptions().scene
        raise InputError(f"{flag}: valid only with --scene {FLIGHT}, found --scene {scene_given}")
    options = run.given(SceneOptions)
    truth_path = str(ground_truth_path(arguments))
    beside = _files_of_attitudes(options, path, (truth_path, arguments.json))
    if not arguments.overwrite:
        for target in (path, truth_path, *beside.values()):
            check_new(target, "--overwrite")
    with naming_flags(SceneOptions):
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
            # Users of a scene expect no other loss.
            told = (LOST_ROLLING_SHUTTER,)
            lost = [one for one in save(made.ground_truth, truth_path, format) if one in told]
        true = scene.ground_truth if isinstance(scene, SyntheticScene) else images
        _write_attitudes(beside, measured_attitudes(true, options), true, format)
    output = {"path": path, "format": format}
    truth = {"path": truth_path, "format": format}
    return synthesized(options, images.num_cameras, tally, output, truth, beside, lost)


def _files_of_attitudes(
    options: SceneOptions, path: str, others: Iterable[str | None]
) -> dict[str, str]:
    """Return the paths of the measured attitudes next to OUTPUT, by kind."""
    given = {"gravity": options.gravity_sigma, "orientations": options.orientation_sigma}
    found = {kind: path_beside(path, kind, ".txt") for kind, sigma in given.items() if sigma}
    for kind, target in found.items():
        if any(other and Path(other) == Path(target) for other in others):
            raise InputError(
                f"{shown(target)}: expected a path that only --{kind} writes, found two outputs"
            )
    return found


def _write_attitudes(
    paths: dict[str, str], priors: tuple[AttitudePrior, ...], images: Problem, format: str
) -> None:
    """Write the priors of each kind; a BAL file identifies images by index only."""
    from bundle.georeference.attitude_priors import (
        GravityPrior,
        OrientationPrior,
        gravity_text,
        orientation_text,
    )

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
    from bundle.model.residuals import reprojection_error
    from bundle.synthetic.blocks import SceneTally

    problem = scene.problem
    tally = SceneTally(problem.num_images)
    tally.add(problem.observation_image, problem.observation_point, scene.is_outlier)
    tally.errors = {
        "start": reprojection_error(problem),
        "ground_truth": reprojection_error(scene.ground_truth),
    }
    return tally


def make_flight(run: Run) -> Report:
    """Generate a flight and write its measurements and ground truth."""
    from bundle.io.sequences.sequence_folder import check_sequence_target
    from bundle.reports.terminal.vio_reports import made_flight
    from bundle.synthetic.synthetic_flight import save_flight, synthesize_flight

    names = own_options("SceneOptions", "FlightOptions")
    scenes = [name for name in names if name != "scene"]
    for flag in given_flags(run.arguments, (*scenes, "format", "ground_truth")):
        raise InputError(f"{flag}: valid only with other scenes, found --scene {FLIGHT}")
    options, path = run.given(FlightOptions), run.target
    if not run.arguments.overwrite:
        check_new(path, "--overwrite")
    check_sequence_target(path)
    run.progress.stage(f"making {options.duration:g} s of flight")
    with naming_flags(FlightOptions):
        flight = synthesize_flight(options)
    run.write(path, lambda _: save_flight(flight, path))
    return made_flight(path, flight.sequence, options)


_SCENE = Path(__file__).parent / "assets" / "street.zip"
_REFINE = ("--loss", "cauchy", "--rounds", "3", "--overwrite")


def demo(arguments: argparse.Namespace) -> int:
    """Unpack the scene, refine it, and print the path of the page."""
    folder = Path(arguments.output)
    scene, refined, page = folder / "scene", folder / "refined", folder / "report.html"
    _unpack(folder, scene)
    words = ["refine", str(scene), "-o", f"{refined}/", "--html", str(page), *_REFINE]
    for flag in ("quiet", "verbose"):
        words += [f"--{flag}"] if getattr(arguments, flag) else []
    words += ["--json", arguments.json] if arguments.json else []
    from bundle.cli.main import main  # late: it imports the table of the commands

    code = main(words)
    if code == EXIT_DONE and arguments.json != "-":
        print_out(f"\nThe scene, the result and the page are in {shown(folder)}; open\n")
        print_out(f"  {page.absolute().as_uri()}\n")
    return code


def _unpack(folder: Path, scene: Path) -> None:
    """Write the scene, unless an earlier demo has done so."""
    with zipfile.ZipFile(_SCENE) as packed:
        files = {scene / name: packed.read(name) for name in packed.namelist()}
        if all(path.is_file() and path.read_bytes() == text for path, text in files.items()):
            return
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise InputError(f"{shown(folder)}: expected a new or empty folder, found other files")
        packed.extractall(scene)
