"""INPUT of `bundle refine`: reading, edits, priors; refinement on disk or in slices."""

from __future__ import annotations

import dataclasses
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import bundle._core as _core
from bundle.base.words import format_size
from bundle.cli.georeferencing import check_georeference, georeference_at, priors_of
from bundle.cli.option_flags import with_named_images
from bundle.cli.output import check_replaced, same_images
from bundle.cli.problem_edits import cameras_edited, with_rigs, with_shutters
from bundle.cli.refinement import Refinement
from bundle.errors import InputError, shown
from bundle.georeference.measurements import kinds_given
from bundle.interface.round_options import CheckpointOptions
from bundle.io.atomic.replaced_paths import ROLLING_SHUTTER, is_text_model, missing_model_files
from bundle.io.open import check_target, output_format, recover
from bundle.io.recognition import imported_format
from bundle.model.unobserved import require_observations, require_tracks
from bundle.reports.sections import Report, Section
from bundle.solving.ranks.launch import current
from bundle.solving.slices.scratch_size import RESIDENT_BYTES

if TYPE_CHECKING:
    from bundle.solving.slices.sliced_refinement import OutOfCoreRefinement, SlicedRefinement


def open_input(run: Refinement) -> None:
    """Read INPUT, change its cameras and rigs, and check that OUTPUT can be written."""
    source, arguments = run.source, run.arguments
    with run.timing("load"):
        run.sliced = None
        if run.disk.out_of_core is not None:
            run.sliced = input_on_disk(run)
        elif not run.flags_beyond(*CheckpointOptions.names()):
            run.sliced = sliced_input(run)
        if run.sliced is None:
            run.load(rigs=False)
        else:
            run.input = run.sliced.cameras
    require_observations(run.input, shown(source))
    run.edits = cameras_edited(run.lenses, run.input, keep_scale=_may_move_images(run))
    edited = run.input if run.edits is None else run.edits.problem
    problem = with_rigs(edited, arguments.rig_config)
    run.problem, run.options = with_shutters(problem, run.shutters, run.options)
    run.options = with_named_images(run.options, arguments.fixed_image_ids, run.problem)
    run.output = _checked_output(run)
    kinds = kinds_given(run.georeference)
    run.place = georeference_at(source)
    kept = "because INPUT has a georeference.json" if run.place is not None else ""
    kept = kept if run.local.only_images is None else "with --only-images"
    if any(row.places for row in kinds):
        kept = ""
        check_georeference(**run.output)
    for row in kinds:
        run.progress.stage(f"reading {row.noun}: {shown(getattr(run.georeference, row.source))}")
    run.known = priors_of(run.georeference, run.problem, kept=kept)
    run.align = True if not kept and any(row.moves for row in kinds) else None
    if run.sliced is None and not kinds and not run.rules.changed():
        require_tracks(run.problem, shown(source), run.options)
    if run.place is not None:
        check_georeference(**run.output)


def _may_move_images(run: Refinement) -> bool:
    """Return True if no image is constant in the solve."""
    named = run.arguments.fixed_image_ids
    is_held = run.options.fixed_image_ids or named or run.local.only_images
    rules = any(rule.target.kind == "image" for rule in run.constraints)
    return "poses" in run.options.refine and not is_held and not rules


def _checked_output(run: Refinement) -> dict[str, str]:
    """Return path and format of OUTPUT after checking that it can be written and replaced."""
    problem, target, given = run.problem, run.target, run.arguments.format
    output = {"path": target, "format": output_format(problem.format, target, given, run.source)}
    if output["format"] == "bal" != problem.format and given is None:
        raise InputError(
            f"{shown(target)}: BAL has no names; give --format bal, or a folder (COLMAP)"
        )
    fixed = run.options.fixed_camera_ids
    check_target(problem, **output, refined=run.options.refine, fixed_camera_ids=fixed)
    check_replaced(target, [run.source], run.arguments.overwrite, same_images(problem))
    return output


# `bundle refine` on disk or in slices: what they support, and the decision between them.


_FLAG = "--out-of-core"


def on_disk(run: Refinement) -> AbstractContextManager[None]:
    """Return a context in which large arrays are files in the user's folder, if given."""
    folder = run.disk.out_of_core
    if folder is None:
        return nullcontext()
    if current() is not None:
        raise InputError(f"{_FLAG}: expected one process, found several")
    for flag in run.flags_beyond():
        raise InputError(f"{_FLAG}: not valid with {flag}, which needs all of INPUT")
    if run.options.backend == "ceres":
        raise InputError(f"{_FLAG}: expected the fused backend, found --backend ceres")
    if run.options.twists != "free":
        raise InputError(
            f"{_FLAG}: expected --twists free, found {run.options.twists}, whose ties need all "
            "of INPUT"
        )
    from bundle.solving.slices.sliced_refinement import scratch_folder  # few runs need it

    return scratch_folder(folder)


def input_on_disk(run: Refinement) -> OutOfCoreRefinement:
    """Read INPUT into the open folder."""
    run.progress.stage(f"reading {shown(run.source)}")
    path = Path(run.source)
    recover(path)
    source_format = sliceable_format(path)
    if source_format is None:
        raise InputError(
            f"{_FLAG}: expected a BAL file or a binary COLMAP model, found {shown(path)}; "
            "`bundle convert` writes one"
        )
    if not has_copied_format(run, source_format):
        raise InputError(
            f"{_FLAG}: expected OUTPUT in the format of INPUT, which is copied from file to file, "
            f"found {shown(run.target)}"
        )
    from bundle.solving.slices.sliced_refinement import OutOfCoreRefinement

    return OutOfCoreRefinement(path, str(run.disk.out_of_core))


def with_disk_use(report: Report, run: Refinement) -> Report:
    """Return the report with the bytes on disk; unchanged if all was in memory."""
    folder = run.disk.out_of_core
    if folder is None:
        return report
    _, most = _core.scratch_use()
    use = {"folder": folder, "peak_bytes_on_disk": most, "resident_bytes": RESIDENT_BYTES}
    fact = ("on disk", f"at most {format_size(most)} in {shown(folder)}, removed")
    return dataclasses.replace(
        report,
        sections=[*report.sections, Section(facts=[fact])],
        data={**report.data, "out_of_core": use},
    )


COMPRESSED = (".gz", ".bz2")


def sliced_input(run: Refinement) -> SlicedRefinement | None:
    """Return the refinement of INPUT in slices; None if one process must read it all.

    One process reads everything if it is the only one, if INPUT is a COLMAP text model, or if the
    output is compressed or has another format than INPUT. It also does so for options that do not
    support a distributed solve.
    """
    crew = current()
    if crew is None:
        return None
    from bundle.solving.ranks.mpi_crew import MpiCrew  # only under mpirun
    from bundle.solving.ranks.partition import reason_in_options

    if not isinstance(crew, MpiCrew):
        return None
    if reason_in_options(run.options.asdict()):
        return None
    path = Path(run.source)
    recover(path)
    if (path / ROLLING_SHUTTER).is_file():  # slices know only global shutters
        return None
    source_format = sliceable_format(path)
    if source_format is None:
        return None
    if not has_copied_format(run, source_format):
        return None
    from bundle.solving.slices.sliced_refinement import SlicedRefinement

    run.progress.stage(f"reading {shown(run.source)}")
    return SlicedRefinement(crew, path)


def has_copied_format(run: Refinement, source_format: str) -> bool:
    """Return True if OUTPUT can be copied from INPUT file by file: same format, not compressed."""
    target_format = output_format(source_format, run.target, run.arguments.format, run.source)
    is_compressed = target_format == "bal" and Path(run.target).suffix.lower() in COMPRESSED
    return target_format == source_format and not is_compressed


def sliceable_format(source: Path) -> str | None:
    """Return "bal" or "colmap" for inputs that can be read in slices, otherwise None."""
    if source.is_file():
        return "bal" if imported_format(source) is None else None
    is_binary = source.is_dir() and not missing_model_files(source) and not is_text_model(source)
    return "colmap" if is_binary else None
