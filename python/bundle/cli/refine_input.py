"""INPUT of `bundle refine`: reading, changes of cameras and rigs, priors, checks of OUTPUT."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, Any

from bundle.base.records import dataclass
from bundle.cli.georeferencing import check_georeference, georeference_at, priors_of
from bundle.cli.on_disk import input_on_disk, sliced_input
from bundle.cli.option_flags import with_named_images
from bundle.cli.output import Progress, check_replaced, same_images
from bundle.cli.problem_edits import cameras_edited, with_rigs, with_shutters
from bundle.cli.refinement import Refinement
from bundle.errors import shown
from bundle.georeference.measurements import Measurements, kinds_given
from bundle.interface.options import SolveOptions
from bundle.io.open import check_target, load, output_format
from bundle.model.unobserved import require_observations, require_tracks

if TYPE_CHECKING:
    from bundle.editing.edit_record import CameraEdits
    from bundle.model.problem import Problem
    from bundle.solving.slices.sliced_refinement import SlicedRefinement


@dataclass(frozen=True, kw_only=True)
class Opened:
    """INPUT as prepared for the solve, with everything that belongs to it.

    Attributes:
        loaded: problem as read from INPUT.
        problem: problem with the requested cameras and rigs.
        edits: changes of its cameras; None without any.
        options: options of the solve, images by id.
        output: path and format of OUTPUT.
        known: priors of all measurements.
        align: True to move the problem to its priors.
        place: content of the georeference.json next to INPUT, or None.
        sliced: refinement by processes that read one slice each; None: one process reads all.
        load_time: seconds.
    """

    loaded: Problem
    problem: Problem
    edits: CameraEdits | None
    options: SolveOptions
    output: dict[str, str]
    known: Measurements
    align: bool | None
    place: dict[str, Any] | None
    sliced: SlicedRefinement | None
    load_time: float


def open_input(asked: Refinement, progress: Progress) -> Opened:
    """Read INPUT, change its cameras and rigs, and check that OUTPUT can be written."""
    source = asked.source
    progress.stage(f"reading {shown(source)}")
    begun = perf_counter()
    sliced: SlicedRefinement | None = None
    if asked.disk.out_of_core is not None:
        sliced = input_on_disk(asked)
    elif asked.is_plain:
        sliced = sliced_input(source, asked.target, asked.format, asked.options)
    loaded = load(source, progress.text, asked.reading) if sliced is None else sliced.cameras
    load_time = perf_counter() - begun
    require_observations(loaded, shown(source))
    edits = cameras_edited(asked.lenses, loaded, keep_scale=_may_move_images(asked))
    problem = with_rigs(loaded if edits is None else edits.problem, asked.rig_config)
    problem, options = with_shutters(problem, asked.shutters, asked.options)
    options = with_named_images(options, asked.fixed_images, problem)
    output = _checked_output(asked, problem, options)
    given = asked.georeference
    kinds = kinds_given(given)
    place = georeference_at(source)
    kept = _kept_world(asked, place)
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
    is_held = asked.options.fixed_image_ids or asked.fixed_images or asked.local.only_images
    rules = any(rule.target.kind == "image" for rule in asked.constraints)
    return "poses" in asked.options.refine and not is_held and not rules


def _kept_world(asked: Refinement, place: dict[str, Any] | None) -> str:
    """Return the reason for which measurements must not move the model; "" if they may."""
    if asked.local.only_images is not None:
        return "with --only-images"
    return "because INPUT has a georeference.json" if place is not None else ""


def _checked_output(asked: Refinement, problem: Problem, options: SolveOptions) -> dict[str, str]:
    """Return path and format of OUTPUT after checking that it can be written and replaced."""
    source, target = asked.source, asked.target
    output = {"path": target, "format": output_format(problem.format, target, asked.format, source)}
    fixed = options.fixed_camera_ids
    check_target(problem, **output, refined=options.refine, fixed_camera_ids=fixed)
    check_replaced(target, [source], asked.overwrite, same_images(problem))
    return output
