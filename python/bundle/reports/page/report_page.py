"""Page of a reconstruction: outcome, residuals, lenses, certainty, structure, scene."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.analysis.statistics.description import Description, describe
from bundle.analysis.uncertainty.covariance_by_input import covariance as compute_covariance
from bundle.analysis.uncertainty.covariance_result import Certainty, Covariance
from bundle.base.arrays import check_type
from bundle.base.paths import as_path, is_path
from bundle.errors import InputError, shown
from bundle.figures.lens_figures import lens_curves, most_observed_cameras
from bundle.figures.placement_figures import Placement, placement
from bundle.figures.projection_uncertainty import projection_uncertainty
from bundle.figures.residual_field import residual_fields, rows_of_sets
from bundle.figures.residual_figures import residual_histogram, worst_residuals
from bundle.figures.scene_view import MOST_POINTS, scene_before, scene_view
from bundle.figures.structure_figures import covisibility_graph, track_statistics
from bundle.georeference.exif_gps import capture_times
from bundle.georeference.similarity import moved
from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
from bundle.graphs.pose_graphs.edge_weights import is_graph, refuse_for_graphs
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.finding import Finding, one_list
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.io.g2o_files import load_g2o
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals, residuals
from bundle.reports.page.graph_report import write_graph_report
from bundle.reports.page.model_sections import (
    MOST_LENSES,
    contents_of,
    lens_sections,
    placement_sections,
    residual_section,
    shutter_data,
    shutter_section,
    solve_sections,
    structure_section,
)
from bundle.reports.page.page import lead, tag, write_page
from bundle.reports.page.residual_section import (
    MOST_CLICKED,
    Photographs,
    certainty_sections,
    field_data,
    field_sections,
    image_data,
    projection_data,
    scene_ellipsoids,
    worst_section,
)
from bundle.reports.page.scene_section import (
    Shades,
    scene_data,
    scene_script,
    scene_section,
    upper_limit,
)
from bundle.reports.page.table import findings_list, rendered, rounded
from bundle.reports.page.verdicts import Judged, summarised, verdict_list, verdicts
from bundle.reports.sections import Section, displayed, fields
from bundle.solving.headline import headline
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.georeferenced import Georeference
    from bundle.georeference.measurements import MeasurementErrors, Prior
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

MOST_EDGES = 1500
LARGEST, SIZE_OF_POINT = 4.2e6, 20.0
"""Bytes for photographs on a page without points, and bytes of a point of the 3-D view."""


# Valid problems may hold numbers up to the largest double; infinite results get a note.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def write_report(
    result_or_problem: Result | Source,
    path: str | os.PathLike[str],
    *,
    options: SolveOptions | None = None,
    images: str | os.PathLike[str] | None = None,
    georeference: Mapping[str, Any] | Georeference | None = None,
    covariance: Covariance | None = None,
    priors: Iterable[Prior] = (),
    constraints: Constraints | Iterable[str | Rule] = (),
    findings: Sequence[Finding] | None = None,
    measured: Sequence[MeasurementErrors] = (),
    name: str = "",
    command: NextCommand | None = None,
) -> tuple[str, ...]:
    """Write one self-contained HTML page about a reconstruction.

    Args:
        result_or_problem: result of a solve, or a problem, its path, or a pycolmap.Reconstruction.
            Only a result has values before and after.
        path: path of the page. A failed write leaves no partial file.
        options: options of the solve, such as its loss; None: defaults, or those of a result.
        images: folder of the photographs, for the worst images and the time of capture; names of
            images are paths relative to it.
        georeference: fit of the model to positions and control points: the content of
            ``georeference.json``, or the output of ``bundle.georeference`` for a result.
        covariance: covariance of the same problem, from :func:`bundle.covariance`; None computes
            it.
        priors: priors of the solve, which the covariance includes.
        constraints: constraints of the solve, likewise.
        findings: findings about the model; None finds them.
        measured: errors of the result at measurements, whose tables the page shows.
        name: name of the reconstruction, for the title, and its path in commands.
        command: maker of the commands of verdicts; None: one of this name alone.

    Returns:
        One sentence per missing part; the page has the same sentences.

    Raises:
        InputError: the input is not a problem, ``images`` is not a folder, ``georeference`` has
            another form, or the path cannot hold a page.
        OSError: the input cannot be read, or the page cannot be written.
    """
    target = as_path(path)
    result = result_or_problem if isinstance(result_or_problem, Result) else None
    problem = result.problem if result is not None else as_problem(result_or_problem)  # type: ignore[arg-type]
    check_type("name", name, str)
    if images is not None and not Path(images).is_dir():
        raise InputError(f"{shown(str(images))}: expected a folder of images")
    page = _Page(problem, result, name)
    page.command, page.options = command or page.command, options or page.options
    if georeference is not None:
        given = georeference if isinstance(georeference, Mapping) else georeference.asdict()
        page.place = placement(problem, given)
    page.priors, page.measured = tuple(priors), measured
    page.known = page.certainty_of(covariance, constraints)
    page.write(target, images, findings)
    return tuple(page.notes)


class _Page:
    """Sections of a page with their numbers, and notes on missing parts."""

    def __init__(self, problem: Problem, result: Result | None, name: str) -> None:
        self.problem, self.result, self.name = problem, result, name
        self.options = SolveOptions() if result is None else result.options
        self.command = NextCommand(name or "INPUT")
        self.initial: Problem | None = None  # in the frame of the result
        if result is not None:
            first, motion = result.initial_problem, result.similarity
            self.initial = first if motion is None else moved(first, motion)
        self.notes: list[str] = []
        self.data: dict[str, Any] = {}
        self.place: Placement | None = None
        self.known: Certainty | None = None
        self.no_certainty = ""
        self.priors: tuple[Prior, ...] = ()
        self.measured: Sequence[MeasurementErrors] = ()

    @property
    def readout_sigmas(self) -> dict[int, float]:
        """Standard deviation of each refined readout, by camera id."""
        return {} if self.known is None else self.known.covariance.readout_sigmas

    def write(
        self, path: Path, folder: str | os.PathLike[str] | None, findings: Sequence[Finding] | None
    ) -> None:
        """Make every section and write the page."""
        problem, result, options = self.problem, self.result, self.options
        description, tracks = describe(problem), track_statistics(problem)
        found = residuals(problem, options.cheirality)
        counts = bool(found.counted.any())
        if not counts:
            self.notes.append("No residuals: no observation counts.")
        images = worst_residuals(problem, found, MOST_CLICKED) if counts else []
        planes = residual_fields(problem, found) if counts else []
        graph = covisibility_graph(problem, MOST_EDGES)
        states = 1 if result is None else 2
        room = LARGEST - SIZE_OF_POINT * states * min(problem.num_points, MOST_POINTS)
        photographs = Photographs(images, folder, room)
        self.notes += photographs.notes
        findings = report_findings(
            problem, result, description.suspicions, findings, source=self.name or "INPUT",
            options=options, known=self.known, no_covariance=self.no_certainty, priors=self.priors,
        )  # fmt: skip
        judged = verdicts(
            Judged(
                problem=problem, result=result, description=description, fields=planes,
                measured=Measured(whole=problem, command=self.command, options=options),
                images=images, certainty=self.known, no_certainty=self.no_certainty,
                place=self.place, tracks=tracks, graph=graph, findings=findings,
            )
        )  # fmt: skip
        self.data["verdicts"], self.data["findings"] = judged, findings
        shown = [one.command for one in judged]
        sets = self._sets(found)
        rows = rows_of_sets(sets)
        observed = len(np.unique(problem.image_camera[problem.observation_image]))
        self.data["rows"] = rows
        self.data |= shutter_data(problem, result, self.readout_sigmas)
        sections = [
            *([] if self.place is None else placement_sections(self.place, problem)),
            *self._residuals(sets, found, description),
            *(field_sections(planes, observed, rows) if planes else []),
            *(worst_section(images, photographs) if images else []),
            *shutter_section(problem, result, self.readout_sigmas),
            *self._lenses(),
            *self._certainty(found),
            structure_section(description, tracks, graph),
            *(
                section
                for errors in self.measured
                if not errors.is_place
                for section in displayed(errors.displays)
            ),
            *([] if result is None else solve_sections(result)),
        ]
        self.data["fields"] = field_data(planes)
        sigmas = {}
        if self.known is not None:
            ids = problem.image_ids[self.known.images].tolist()
            sigmas = dict(zip(ids, self.known.position_sigmas.tolist(), strict=True))
        self.data["images"] = image_data(images, photographs, sigmas)
        if self.place is not None:
            self.data["placement"] = self.place
        first = [
            *([] if result is None else [lead(headline(result))]),
            tag("p", escape(contents_of(problem) + _captured(problem, folder)), class_="quiet"),
            "" if counts else tag("p", escape(self.notes[-1]), class_="warn"),
            tag(
                "div",
                tag("div", verdict_list(judged), findings_list(findings, shown)),
                self._scene(found),
                class_="first",
            ),
        ]
        short = "/".join(Path(self.name).parts[-2:]) or "The reconstruction"
        write_page(
            path,
            f"Report on {self.name}" if self.name else "Report on a reconstruction",
            [*first, *rendered(sections)],
            self.data,
            headline=f"{short}: {summarised(judged, findings)}",
            script=scene_script(),
        )

    def _sets(self, found: Residuals) -> dict[str, tuple[Problem, Residuals]]:
        """Return problem and residuals by label: "now", or "before" and "after" of a solve."""
        if self.result is None:
            return {"now": (self.problem, found)}
        first = self.result.source_problem
        before = residuals(first, self.result.options.cheirality)
        earlier = {"before": (first, before)} if before.counted.any() else {}
        return earlier | {"after": (self.problem, found)}

    def _residuals(
        self,
        sets: Mapping[str, tuple[Problem, Residuals]],
        found: Residuals,
        description: Description,
    ) -> list[Section]:
        histogram = residual_histogram({name: one for name, (_, one) in sets.items()})
        if histogram is not None:
            self.data["histogram"] = histogram
        return residual_section(self.problem, self.result, description, found, histogram)

    def _lenses(self) -> list[Section]:
        cameras = most_observed_cameras(self.problem, MOST_LENSES)
        if not cameras:
            return []
        known = {} if self.known is None else self.known.cameras
        curves = lens_curves(self.problem, cameras, known)
        self.data["lenses"] = [
            {name: rounded(one) if isinstance(one, np.ndarray) else one
             for name, one in fields(curve).items()}
            for curve in curves
        ]  # fmt: skip
        before = [] if self.initial is None else lens_curves(
            self.initial, most_observed_cameras(self.initial, MOST_LENSES)
        )  # fmt: skip
        sigmas = None
        if self.known is not None:
            sigmas = {index: self.known.sigmas(index) for index in known}
        return lens_sections(self.problem, curves, self.initial, before, sigmas)

    def _scene(self, found: Residuals) -> str:
        problem = self.problem
        view = scene_view(problem, found, z_is_up=self.place is not None)
        before = None
        if self.initial is not None and self.result is not None:
            earlier = residuals(self.initial, self.result.options.cheirality)
            before = scene_before(view, problem, self.initial, earlier)
        lengths = np.bincount(problem.observation_point, minlength=problem.num_points)
        seen = lengths[view.point_indices].astype(float)
        shades = [Shades("images", seen, (max(float(seen.max(initial=3.0)), 3.0), 2.0), "")]
        data: dict[str, Any] = {}
        words = ""
        if self.known is not None:
            sigma = np.full(problem.num_points, np.nan)
            sigma[self.known.points] = self.known.point_sigmas
            sigma = sigma[view.point_indices]
            unit = "m" if self.place is not None else "length units"
            shades.append(Shades("sigma", sigma, (0.0, upper_limit(sigma)), unit))
            data, words = scene_ellipsoids(view, self.known)
        self.data["scene"] = scene_data(view, before, shades) | data
        return scene_section(view, problem.num_points, is_solved=before is not None, more=words)

    def certainty_of(
        self, given: Covariance | None, constraints: Constraints | Iterable[str | Rule]
    ) -> Certainty | None:
        """Return the covariances; None, with a note, if they cannot be computed."""
        if given is None:
            source = self.problem if self.result is None else self.result
            try:
                given = compute_covariance(
                    source, self.options, priors=self.priors, constraints=constraints,
                    scale="sigma0",
                )  # fmt: skip
            except InputError as error:
                self.no_certainty = (
                    f"No covariance: {str(error).removeprefix('problem: ').rstrip('.')}."
                )
                self.notes.append(self.no_certainty)
        return None if given is None else Certainty(self.problem, given)

    def _certainty(self, found: Residuals) -> list[Section]:
        if self.known is None:
            return []
        cameras, known = most_observed_cameras(self.problem), self.known
        options, used = self.options, known.covariance
        made = (
            projection_uncertainty(
                self.problem, index, known.cameras[index], found=found,
                sigma=used.sigma0 if used.scale == "sigma0" else 1.0,
                loss=options.loss, loss_scale=options.loss_scale,
            )
            for index in cameras
            if index in known.cameras
        )  # fmt: skip
        projections = [one for one in made if one is not None]
        if projections:
            self.data["projection"] = projection_data(projections)
        return certainty_sections(self.problem, known, cameras, projections)


def _captured(problem: Problem, folder: str | os.PathLike[str] | None) -> str:
    """Return a sentence on the time of capture, with a blank before it; "" if it is unknown."""
    times = None if folder is None else capture_times(folder, problem.image_names)
    if times is None:
        return ""
    first, last = (f"{time:%Y-%m-%d %H:%M}" for time in times)
    return f" Captured {first}." if first == last else f" Captured {first} to {last}."


def report_findings(
    problem: Problem,
    result: Result | None,
    suspicions: Iterable[Finding],
    given: Iterable[Finding] | None,
    *,
    source: str,
    options: SolveOptions,
    known: Certainty | None,
    no_covariance: str = "",
    priors: Sequence[Any] = (),
) -> tuple[Finding, ...]:
    """Return all findings, problems first; without ``given`` they are searched for."""
    singular = Finding(
        kind="no_covariance",
        sentence=no_covariance,
        command=NextCommand(source).other("diagnose"),
        is_problem="full rank" in no_covariance,
    )
    undetermined = [singular] if no_covariance else []
    warnings = () if result is None else dict.fromkeys(result.summary.warnings)
    told = [Finding(kind="warning", sentence=words) for words in warnings]
    if given is None:
        given = find(
            problem,
            source=source,
            options=options,
            lens_sigmas=None if known is None else known.covariance.lens_sigmas,
            priors=priors,
            is_minimum=result is not None and result.summary.termination_type == "CONVERGENCE",
        )
    return one_list(undetermined, told, suspicions, given)


def report(
    source: Source | Result | PoseGraph | PoseGraphResult | FactorGraph,
    path: str | os.PathLike[str] = "report.html",
    *,
    result: GraphResult | None = None,
    name: str = "",
    **of_reconstructions: Any,
) -> tuple[str, ...]:
    """Write one self-contained HTML page about a reconstruction, a pose graph or a factor graph.

    The page of a graph has chi2 by kind of edge against its expectation, the worst edges, rank and
    certainty, convergence, the cost of each elimination order, and its trajectory in two and three
    dimensions. A :class:`FactorGraph` of reprojections has the page of its problem.

    Args:
        source: problem, pose graph or factor graph; the path of a problem or of a pose graph; or
            the result of a solve. Only a result has values before and after.
        path: path of the page. A failed write leaves no partial file.
        result: result of the factor graph ``source``.
        name: name of the input, for the title.
        **of_reconstructions: further arguments of :func:`bundle.html.write_report`.

    Returns:
        One sentence per missing part; the page has the same sentences.

    Raises:
        InputError: the input or an argument is invalid, or the path cannot hold a page.
        OSError: the input cannot be read, or the page cannot be written.
    """
    check_type("name", name, str)
    if isinstance(source, FactorGraph):
        if result is not None:
            check_type("result", result, GraphResult)
        solved = source if result is None else source.with_values(result.values)
        found = solved.as_problem()
        if found is not None:
            return write_report(found[0], path, name=name, **of_reconstructions)
    elif result is not None:
        raise InputError("result: expected only with a factor graph")
    if isinstance(source, FactorGraph) or is_graph(source):
        refuse_for_graphs(**of_reconstructions)
        if is_path(source):
            source = load_g2o(as_path(source))
        write_graph_report(source, path, result=result, name=name)  # type: ignore[arg-type]
        return ()
    return write_report(source, path, name=name, **of_reconstructions)  # type: ignore[arg-type]
