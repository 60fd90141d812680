"""INPUT of `bundle refine`: reading, edits, priors; refinement on disk or in slices."""

from __future__ import annotations

import dataclasses
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import format_size
from bundle.cli.georeferencing import check_georeference, georeference_at, priors_of
from bundle.cli.option_flags import flags_of, with_named_images
from bundle.cli.output import Progress, check_replaced, same_images
from bundle.cli.problem_edits import cameras_edited, with_rigs, with_shutters
from bundle.cli.refinement import OF_PLAIN, Refinement
from bundle.errors import InputError, shown
from bundle.georeference.measurements import Measurements, kinds_given
from bundle.interface.option_class import OPTION_CLASSES, option_class
from bundle.interface.options import SolveOptions
from bundle.io.atomic.replaced_paths import ROLLING_SHUTTER, is_text_model, missing_model_files
from bundle.io.open import check_target, load, output_format, recover
from bundle.io.recognition import imported_format
from bundle.model.unobserved import require_observations, require_tracks
from bundle.reports.sections import Report, Section
from bundle.solving.ranks.launch import current
from bundle.solving.slices.scratch_size import RESIDENT_BYTES

if TYPE_CHECKING:
    from bundle.editing.camera_sharing import CameraEdits
    from bundle.model.problem import Problem
    from bundle.solving.slices.sliced_refinement import OutOfCoreRefinement, SlicedRefinement


@dataclass(frozen=True, kw_only=True)
class Opened:
    """INPUT as prepared for the solve, with everything that belongs to it."""

    loaded: Problem  # problem as read from INPUT
    problem: Problem  # problem with the requested cameras and rigs
    edits: CameraEdits | None  # changes of its cameras; None without any
    options: SolveOptions  # options of the solve, images by id
    output: dict[str, str]  # path and format of OUTPUT
    known: Measurements  # priors of all measurements
    align: bool | None  # True to move the problem to its priors
    place: dict[str, Any] | None  # content of the georeference.json next to INPUT, or None
    # refinement by processes that read one slice each; None: one process reads all
    sliced: SlicedRefinement | None
    load_time: float  # seconds


def open_input(asked: Refinement, progress: Progress) -> Opened:
    """Read INPUT, change its cameras and rigs, and check that OUTPUT can be written."""
    source = asked.source
    progress.stage(f"reading {shown(source)}")
    begun = perf_counter()
    sliced: SlicedRefinement | None = None
    if asked.disk.out_of_core is not None:
        sliced = input_on_disk(asked)
    elif asked.is_plain:
        sliced = sliced_input(source, asked.target, asked.arguments.format, asked.options)
    loaded = load(source, progress.text, asked.reading) if sliced is None else sliced.cameras
    load_time = perf_counter() - begun
    require_observations(loaded, shown(source))
    edits = cameras_edited(asked.lenses, loaded, keep_scale=_may_move_images(asked))
    problem = with_rigs(loaded if edits is None else edits.problem, asked.rig_config)
    problem, options = with_shutters(problem, asked.shutters, asked.options)
    options = with_named_images(options, asked.arguments.fixed_image_ids, problem)
    output = _checked_output(asked, problem, options)
    given = asked.georeference
    kinds = kinds_given(given)
    place = georeference_at(source)
    kept = "because INPUT has a georeference.json" if place is not None else ""
    kept = kept if asked.local.only_images is None else "with --only-images"
    if any(row.places for row in kinds):
        kept = ""
        check_georeference(**output)
    for row in kinds:
        progress.stage(f"reading {row.noun}: {shown(getattr(given, row.source))}")
    known = priors_of(given, problem, kept=kept)
    if sliced is None and not kinds and not asked.rules.changed():
        require_tracks(problem, shown(source), options)
    if place is not None:
        check_georeference(**output)
    return Opened(
        loaded=loaded,
        problem=problem,
        edits=edits,
        options=options,
        output=output,
        known=known,
        align=True if not kept and any(row.moves for row in kinds) else None,
        place=place,
        sliced=sliced,
        load_time=load_time,
    )


def _may_move_images(asked: Refinement) -> bool:
    """Return True if no image is constant in the solve."""
    named = asked.arguments.fixed_image_ids
    is_held = asked.options.fixed_image_ids or named or asked.local.only_images
    rules = any(rule.target.kind == "image" for rule in asked.constraints)
    return "poses" in asked.options.refine and not is_held and not rules


def _checked_output(asked: Refinement, problem: Problem, options: SolveOptions) -> dict[str, str]:
    """Return path and format of OUTPUT after checking that it can be written and replaced."""
    source, target, given = asked.source, asked.target, asked.arguments
    output = {"path": target, "format": output_format(problem.format, target, given.format, source)}
    if output["format"] == "bal" != problem.format and given.format is None:
        raise InputError(
            f"{shown(target)}: BAL has no names; give --format bal, or a folder (COLMAP)"
        )
    fixed = options.fixed_camera_ids
    check_target(problem, **output, refined=options.refine, fixed_camera_ids=fixed)
    check_replaced(target, [source], given.overwrite, same_images(problem))
    return output


# `bundle refine` on disk or in slices: what they support, and the decision between them.


_FLAG = "--out-of-core"
_SERVED = OF_PLAIN - {"checkpoints"}
_FLAGS = {"page": "--html"}
"""Flags that differ from the names of their fields, for fields outside option classes."""


def on_disk(asked: Refinement) -> AbstractContextManager[None]:
    """Return a context in which large arrays are files in the user's folder, if given."""
    folder = asked.disk.out_of_core
    if folder is None:
        return nullcontext()
    if current() is not None:
        raise InputError(f"{_FLAG}: expected one process, found several")
    beyond = asked.steps_beyond(_SERVED)
    if beyond:
        raise InputError(f"{_FLAG}: not valid with {_flag(beyond[0])}, which needs all of INPUT")
    backend = asked.options.backend
    if backend == "ceres":
        raise InputError(f"{_FLAG}: expected the fused backend, found --backend ceres")
    if asked.options.twists != "free":
        raise InputError(
            f"{_FLAG}: expected --twists free, found {asked.options.twists}, whose ties need all "
            "of INPUT"
        )
    from bundle.solving.slices.sliced_refinement import scratch_folder  # few runs need it

    return scratch_folder(folder)


def input_on_disk(asked: Refinement) -> OutOfCoreRefinement:
    """Read INPUT into the open folder."""
    path = Path(asked.source)
    recover(path)
    source_format = sliceable_format(path)
    if source_format is None:
        raise InputError(
            f"{_FLAG}: expected a BAL file or a binary COLMAP model, found {shown(path)}; "
            "`bundle convert` writes one"
        )
    if not has_copied_format(asked.target, asked.arguments.format, asked.source, source_format):
        raise InputError(
            f"{_FLAG}: expected OUTPUT in the format of INPUT, which is copied from file to file, "
            f"found {shown(asked.target)}"
        )
    from bundle.solving.slices.sliced_refinement import OutOfCoreRefinement

    return OutOfCoreRefinement(path, str(asked.disk.out_of_core))


def with_disk_use(report: Report, asked: Refinement) -> Report:
    """Return the report with the bytes on disk; unchanged if all was in memory."""
    folder = asked.disk.out_of_core
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


def _flag(name: str) -> str:
    """Return the flag of an option, or of a field without an option class."""
    flags = flags_of(*map(option_class, OPTION_CLASSES))
    return flags.get(name) or _FLAGS.get(name) or "--" + name.replace("_", "-")


COMPRESSED = (".gz", ".bz2")


def sliced_input(
    source: str, target: str, format: str | None, options: SolveOptions
) -> SlicedRefinement | None:
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
    if reason_in_options(options.asdict()):
        return None
    path = Path(source)
    recover(path)
    if (path / ROLLING_SHUTTER).is_file():  # slices know only global shutters
        return None
    source_format = sliceable_format(path)
    if source_format is None:
        return None
    if not has_copied_format(target, format, source, source_format):
        return None
    from bundle.solving.slices.sliced_refinement import SlicedRefinement

    return SlicedRefinement(crew, path)


def has_copied_format(target: str, format: str | None, source: str, source_format: str) -> bool:
    """Return True if OUTPUT can be copied from INPUT file by file: same format, not compressed."""
    target_format = output_format(source_format, target, format, source)
    is_compressed = target_format == "bal" and Path(target).suffix.lower() in COMPRESSED
    return target_format == source_format and not is_compressed


def sliceable_format(source: Path) -> str | None:
    """Return "bal" or "colmap" for inputs that can be read in slices, otherwise None."""
    if source.is_file():
        return "bal" if imported_format(source) is None else None
    is_binary = source.is_dir() and not missing_model_files(source) and not is_text_model(source)
    return "colmap" if is_binary else None
