"""Report of `bundle inspect --shape`: textbook flops of one step, term by term."""

from __future__ import annotations

from collections.abc import Mapping

from bundle.base.words import format_size, number, plural
from bundle.planning.inspection.problem_needs import ProblemNeeds, SchurCounts
from bundle.reports.sections import Report, Section, Table, fields


def inspected(
    shape: Mapping[str, int], counts: SchurCounts, needs: ProblemNeeds, wall_time: float
) -> Report:
    """Return the report.

    Args:
        shape: num_cameras, num_points and track_length.
        counts: flops of a step.
        needs: memory and disk of a solve.
        wall_time: seconds.
    """
    cameras, points, track = shape.values()
    terms = [
        ("invert V_p", "27 per point", counts.points),
        ("W V^-1 W^T", f"162 for each of {counts.num_block_products} products", counts.products),
        ("factorise S", f"n^3 / 3, n = 6 x {cameras} = {counts.num_reduced_unknowns}",
         counts.reduced),
        ("together", "points eliminated first", counts.schur),
        ("all at once", f"n^3 / 3, n = {counts.num_unknowns}", counts.dense),
    ]  # fmt: skip
    rows = [(name, formula, number(flops)) for name, formula, flops in terms]
    ratio = counts.dense / counts.schur
    return Report(
        command="inspect",
        headline=[
            f"{plural(cameras, 'camera')} and {plural(points, 'point')}, each seen by {track}: "
            f"{number(counts.schur)} flops per step with the points eliminated first, "
            f"{number(counts.dense)} without ({number(ratio)} times as many)."
        ],
        sections=[
            Section(
                tables=[Table.of(("term", "formula", "flops"), rows, left=2)],
                notes=[
                    "A textbook estimate, with a dense S. `bundle inspect INPUT` counts the "
                    "work of a solver on your problem."
                ],
            ),
            _needs(needs),
        ],
        data={
            "shape": dict(shape),
            **fields(counts),
            "schur": counts.schur,
            "needs": needs,
            "wall_time": {"total": wall_time},
        },
    )


def _needs(needs: ProblemNeeds) -> Section:
    submaps = plural(needs.num_submaps, "submap")
    system = format_size(needs.system_in_bytes)
    facts = [
        ("observations", f"{needs.num_observations:,}"),
        ("in memory", f"{format_size(needs.memory_in_bytes)} and S with its factor, {system} or "
                      "more"),
        ("out of core", f"{submaps} of {format_size(needs.disk_in_bytes)} of disk and "
                        f"{format_size(needs.resident_in_bytes)} of memory or more"),
        ("processor", f"{number(needs.processor_seconds_per_step)} s per step, as measured with "
                      "500 million observations"),
    ]  # fmt: skip
    notes = ["`bundle refine INPUT -o OUTPUT --out-of-core DIR` keeps observations and points on "
             "a disk."]  # fmt: skip
    if needs.num_submaps > 1:
        notes.append(
            "One solve has at most 1,073,741,823 observations, so submaps share images, their "
            "separators. `refine --only-images --rest marginal` eliminates all else exactly. The "
            f"dense system of {needs.most_separator_images:,} images fits into the free memory."
        )
    return Section(facts=facts, notes=notes)
