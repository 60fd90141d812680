"""Page of a reconstruction: outcome, residuals, lenses, certainty, structure, scene."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.analysis.statistics.description import describe
from bundle.analysis.uncertainty.compute_covariance import covariance as compute_covariance
from bundle.base.arguments import check_type
from bundle.base.paths import as_path
from bundle.base.words import pixels
from bundle.errors import InputError, shown
from bundle.figures.certainty import Certainty, certainty
from bundle.figures.image_residuals import worst_residuals
from bundle.figures.lens_curves import lens_curve, most_observed_cameras
from bundle.figures.placement_errors import Placement, placement
from bundle.figures.projection_uncertainty import ProjectionUncertainty, projection_uncertainty
from bundle.figures.residual_field import residual_fields
from bundle.figures.residual_histogram import residual_histogram
from bundle.figures.scene_view import scene_view
from bundle.figures.track_statistics import track_statistics
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals, residuals
from bundle.reports.page.certainty_section import certainty_section, scene_ellipsoids
from bundle.reports.page.lens_section import lens_section, parameter_table
from bundle.reports.page.overview_section import overview_section
from bundle.reports.page.page import asset, tag, write_page
from bundle.reports.page.placement_section import placement_section
from bundle.reports.page.projection_section import projection_data, projection_section
from bundle.reports.page.residual_section import (
    field_data,
    field_section,
    histogram_section,
)
from bundle.reports.page.scene_section import scene_data, scene_script, scene_section
from bundle.reports.page.structure_section import structure_section
from bundle.reports.page.worst_section import worst_section
from bundle.reports.sections import plain
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.analysis.uncertainty.covariance_result import Covariance
    from bundle.georeference.georeferenced import Georeference
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.placed_problem import Prior

__all__ = ["write_report"]


# Valid problems may hold numbers up to the largest double; infinite results get a note.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def write_report(
    result_or_problem: Result | Source,
    path: str | os.PathLike[str],
    *,
    images: str | os.PathLike[str] | None = None,
    georeference: Mapping[str, Any] | Georeference | None = None,
    covariance: Covariance | None = None,
    priors: Iterable[Prior] = (),
    constraints: Constraints | Iterable[str | Rule] = (),
    name: str = "",
) -> tuple[str, ...]:
    """Write one self-contained HTML page about a reconstruction.

    Args:
        result_or_problem: result of a solve, or a problem, its path, or a pycolmap.Reconstruction.
            Only a result has values before and after.
        path: path of the page. A failed write leaves no partial file.
        images: folder of the photographs, for the worst images; names of images are paths relative
            to it.
        georeference: fit of the model to positions and control points: the content of
            ``georeference.json``, or the output of ``bundle.georeference`` for a result.
        covariance: covariance of the same problem, from :func:`bundle.covariance`; None computes
            it.
        priors: priors of the solve, which the covariance includes.
        constraints: constraints of the solve, likewise.
        name: name of the reconstruction, for the title.

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
    page = _Page(problem, result)
    if georeference is not None:
        given = georeference if isinstance(georeference, Mapping) else georeference.asdict()
        page.place = placement(problem, given)
    page.certainty = page.certainty_of(covariance, priors, constraints)
    page.write(target, name, images)
    return tuple(page.notes)


class _Page:
    """Sections of a page with their numbers, and notes on missing parts."""

    def __init__(self, problem: Problem, result: Result | None) -> None:
        self.problem = problem
        self.result = result
        self.notes: list[str] = []
        self.sections: list[str] = []
        self.data: dict[str, Any] = {}
        self.place: Placement | None = None
        self.certainty: Certainty | None = None
        self.no_certainty = ""

    def write(self, path: Path, name: str, images: str | os.PathLike[str] | None) -> None:
        """Make every section and write the page."""
        problem, result = self.problem, self.result
        description = describe(problem)
        found = self._residuals()
        self.sections += overview_section(problem, result, description, found)
        if found is not None:
            self._residual_sections(found)
            self._worst(found, images)
        self._lenses()
        self._certainty(found)
        self.sections += structure_section(problem, description, track_statistics(problem))
        if self.place is not None:
            self.sections.append(tag("h2", "Control points and positions", id="placement"))
            self.sections.append(placement_section(self.place))
            self.data["placement"] = plain(self.place)
        self._scene(found)
        self.sections.insert(0, self._contents())
        title = f"Report on {name}" if name else "Report on a reconstruction"
        write_page(
            path,
            title,
            self.sections,
            self.data,
            headline=self._headline(name, description.reprojection_error),
            script=scene_script(),
            style=asset("report.css"),
        )

    def _contents(self) -> str:
        """Return links to the sections."""
        found = re.findall(r'<h2 id="(\w+)">([^<]+)</h2>', "".join(self.sections))
        items = [tag("li", tag("a", title, href=f"#{name}")) for name, title in found]
        return tag("nav", tag("ul", *items), aria_label="sections")

    def _headline(self, name: str, error: Any) -> str:
        of = name or "The reconstruction"
        if self.result is not None:
            before = self.result.reprojection_error_before.rmse
            after = self.result.reprojection_error_after.rmse
            return f"{of}: RMSE {pixels(before)} px before, {pixels(after)} px after"
        if error is None or not np.isfinite(error.rmse):
            return f"{of}: no reprojection error"
        return f"{of}: RMSE {pixels(error.rmse)} px"

    def _residuals(self) -> Residuals | None:
        """Return the residuals; None, with a note, if the problem has none."""
        cheirality = "auto" if self.result is None else self.result.options.cheirality
        found = residuals(self.problem, cheirality)
        if not found.counted.any():
            self._note("No residuals: no observation counts.")
            return None
        return found

    def _residual_sections(self, found: Residuals) -> None:
        sets = {"now": found}
        if self.result is not None:
            before = residuals(self.result.initial_problem, self.result.options.cheirality)
            sets = {"before": before, "after": found} if before.counted.any() else {"after": found}
        histogram = residual_histogram(sets)
        self.sections.append(tag("h2", "Residuals", id="residuals"))
        if histogram is not None:
            self.sections.append(histogram_section(histogram))
            self.data["histogram"] = plain(histogram)
        fields = residual_fields(self.problem, found)
        observed = np.unique(self.problem.image_camera[self.problem.observation_image])
        self.sections.append(tag("h2", "Residuals over the image plane", id="fields"))
        self.sections.append(field_section(fields, len(observed)))
        self.data["fields"] = field_data(fields)

    def _worst(self, found: Residuals, images: str | os.PathLike[str] | None) -> None:
        section, notes = worst_section(worst_residuals(self.problem, found), images)
        self.sections += [tag("h2", "Worst images", id="worst"), section]
        self.notes += notes

    def _lenses(self) -> None:
        cameras = most_observed_cameras(self.problem)
        if not cameras:
            return
        initial = None if self.result is None else self.result.initial_problem
        known = self.certainty.cameras if self.certainty is not None else {}
        made = (lens_curve(self.problem, index, known.get(index)) for index in cameras)
        curves = [curve for curve in made if curve is not None]
        before = {}
        if initial is not None and initial.num_cameras == self.problem.num_cameras:
            earlier = (lens_curve(initial, index) for index in cameras)
            before = {curve.camera_id: curve for curve in earlier if curve is not None}
        observed = np.unique(self.problem.image_camera[self.problem.observation_image])
        self.sections.append(tag("h2", "Lenses", id="lenses"))
        if curves:
            self.sections.append(lens_section(curves, before, len(observed)))
            self.data["lenses"] = plain(curves)
        sigmas = None
        if self.certainty is not None:
            sigmas = {index: self.certainty.sigmas(index) for index in known}
        self.sections.append(parameter_table(self.problem, initial, cameras, sigmas))

    def _scene(self, found: Residuals | None) -> None:
        view = scene_view(self.problem, found, z_is_up=self.place is not None)
        data, words = scene_data(view), ""
        if self.certainty is not None:
            ellipsoids, words = scene_ellipsoids(view, self.certainty)
            data |= ellipsoids
        self.data["scene"] = data
        self.sections.append(tag("h2", "3-D view", id="scene"))
        self.sections.append(scene_section(view, self.problem.num_points, words))

    def certainty_of(
        self,
        given: Covariance | None,
        priors: Iterable[Prior],
        constraints: Constraints | Iterable[str | Rule],
    ) -> Certainty | None:
        """Return the certainty; None, with a note, if it cannot be computed."""
        if given is None:
            source = self.problem if self.result is None else self.result
            try:
                given = compute_covariance(
                    source, priors=priors, constraints=constraints, scale="sigma0"
                )
            except InputError as error:
                self.no_certainty = f"No covariance: {str(error).rstrip('.')}."
        return None if given is None else certainty(self.problem, given)

    def _certainty(self, found: Residuals | None) -> None:
        if self.certainty is None and not self.no_certainty:
            return
        self.sections.append(tag("h2", "Certainty", id="certainty"))
        if self.certainty is None:
            self._note(self.no_certainty)
            return
        cameras = most_observed_cameras(self.problem)
        self.sections.append(certainty_section(self.problem, self.certainty, cameras))
        made = (self._projection(index, self.certainty, found) for index in cameras)
        known = [one for one in made if one is not None]
        if known:
            observed = np.unique(self.problem.image_camera[self.problem.observation_image])
            self.sections.append(projection_section(known, len(observed)))
            self.data["projection"] = projection_data(known)

    def _projection(
        self, camera: int, known: Certainty, found: Residuals | None
    ) -> ProjectionUncertainty | None:
        if camera not in known.cameras:
            return None
        options = SolveOptions() if self.result is None else self.result.options
        return projection_uncertainty(
            self.problem, camera, known.cameras[camera], found=found,
            sigma=known.sigma0 if known.scale == "sigma0" else 1.0,
            loss=options.loss, loss_scale=options.loss_scale,
        )  # fmt: skip

    def _note(self, words: str) -> None:
        self.notes.append(words)
        self.sections.append(tag("p", escape(words), class_="warn"))
