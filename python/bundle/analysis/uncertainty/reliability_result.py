"""Result of a reliability analysis: redundancies, errors that go unnoticed; its file and JSON."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_result import SavedBlocks
from bundle.base.display import Display
from bundle.base.records import dataclass
from bundle.base.words import number
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular

WEAK = 0.1
"""Mean redundancy of an image below which its errors are badly checked (W. Foerstner)."""
DOWNWEIGHTED = 0.1  # weight of a loss below which an observation may be an error that hides
NUM_WORST = 20  # number of observations whose effect is computed exactly
CONTROL_POINT = "control point"

_Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ImageReliability:
    """Redundancy of the observations of an image.

    Attributes:
        image_id: id of the image.
        name: its name; "" without one.
        num_observations: number of observations that count.
        redundancy: sum of the redundancies of their components.
        share: redundancy per component: 0 if nothing checks the image, at most 1.
    """

    image_id: int
    name: str
    num_observations: int
    redundancy: float
    share: float

    @property
    def words(self) -> str:
        """The image in sentences."""
        return shown(self.name) if self.name else f"image {self.image_id}"


@dataclass(frozen=True, kw_only=True)
class PriorReliability:
    """Redundancy of a prior, or of another factor, relative to all other measurements.

    Attributes:
        name: name of the factor, or of its control point.
        kind: kind of the factor, such as "position"; "control point".
        num_residuals: number of its measurements.
        redundancy: sum of their redundancies.
        least_redundancy: least redundancy along any combination of them.
        test: square of the standardised residual; chi2 distributed with ``degrees`` degrees.
        degrees: number of directions that other measurements check.
    """

    name: str
    kind: str
    num_residuals: int
    redundancy: float
    least_redundancy: float
    test: float
    degrees: int


@dataclass(frozen=True, kw_only=True)
class WeakObservation:
    """Effect of an error of the minimal detectable size, along the weakest direction.

    Attributes:
        observation: row of the observation.
        image_id: its image.
        point_id: its point.
        least_redundancy: l.
        minimal_detectable_error: the error [px].
        external_bound: bound of the movement of any function, in its sigmas.
        moved_point_id: point that moves by the most sigmas, of those in the images of the worst
            observations; None without a free point.
        moved_point_sigmas: and by how many, with the point's covariance under inner constraints.
        moved_image_id: image whose pose moves by the most sigmas; None without a free pose.
        moved_image_sigmas: and by how many, likewise.
    """

    observation: int
    image_id: int
    point_id: int
    least_redundancy: float
    minimal_detectable_error: float
    external_bound: float
    moved_point_id: int | None
    moved_point_sigmas: float
    moved_image_id: int | None
    moved_image_sigmas: float


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Reliability(SavedBlocks, Tabular):
    """Redundancies of all measurements, and errors that would go unnoticed.

    Arrays have a row per observation of the problem. Observations that do not count, without a
    projection or with a weight of 0 under the loss, have NaN. The arrays form the file of ``save``;
    the other attributes are the entry ``reliability`` of the JSON report of ``bundle diagnose``.

    Attributes:
        redundancy: (n, 2) share of an error in x and y that the observation's own residual shows.
        least_redundancy: (n,) the same along the weakest direction; 0 for every observation of a
            point with two rays.
        weakest_direction: (n, 2) this direction, a unit vector in pixels; its sign is arbitrary.
        standardized: (n, 2) residuals over their own standard deviations; NaN: not checkable.
        minimal_detectable_error: (n,) pixels: smallest error along the weakest direction that a
            test finds with the power that belongs to ``delta0``; NaN: not checkable.
        external_bound: (n,) largest movement of any function of the unknowns by such an error, in
            sigmas of the function; NaN: not checkable.
        weight: (n,) weight rho' of the loss; 1 without one.
        image_redundancy: (num_images,) sum over the observations of an image.
        point_redundancy: (num_points,) the same of a point; at most 1 with two rays.
        camera_redundancy: (num_cameras,) the same of a camera.
        sum: sum of the redundancies of observations and priors; equals ``dof``.
        dof: number of residuals, minus the number of parameters that they determine.
        num_residuals: number of residuals, including those of priors.
        sigma0: root of the weighted squares over ``dof``; NaN without degrees of freedom.
        scale: "unit": residuals have the assumed sigmas; "sigma0": multiplied by sigma0.
        delta0: shift of w that a test has to find.
        loss: loss whose weights count; all numbers are those with these weights.
        num_used: number of observations that count.
        num_zero_weight: number of observations whose weight is 0.
        num_downweighted: number of observations with a weight below 0.1, which may be errors that
            hide behind their weight.
        num_uncontrolled: number of used observations with an error that cannot be checked.
        num_two_view: number of these on points with two rays.
        num_points_at_infinity: number of points without parallax, which are left out along their
            undetermined direction.
        images: images, the least checked first.
        priors: priors and other factors, the least checked first.
        worst: the 20 observations with the largest bounds below "not checkable".
        findings: images and control points that nothing checks.
        notes: sentences with remarks.
    """

    redundancy: _Floats
    least_redundancy: _Floats
    weakest_direction: _Floats
    standardized: _Floats
    minimal_detectable_error: _Floats
    external_bound: _Floats
    weight: _Floats
    image_redundancy: _Floats
    point_redundancy: _Floats
    camera_redundancy: _Floats
    sum: float
    dof: int
    num_residuals: int
    sigma0: float
    scale: str
    delta0: float
    loss: str
    num_used: int
    num_zero_weight: int
    num_downweighted: int
    num_uncontrolled: int
    num_two_view: int
    num_points_at_infinity: int
    images: tuple[ImageReliability, ...]
    priors: tuple[PriorReliability, ...]
    worst: tuple[WeakObservation, ...]
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    def _arrays(self) -> dict[str, Any]:
        return {name: one for name, one in vars(self).items() if isinstance(one, np.ndarray)}

    @property
    def entries(self) -> dict[str, Any]:
        """Fields other than arrays, for JSON."""
        names = [field.name for field in dataclasses.fields(self)]
        values = {name: getattr(self, name) for name in names}
        return {name: one for name, one in values.items() if not isinstance(one, np.ndarray)}

    @cached_property
    def sentences(self) -> tuple[str, ...]:
        """The answer in at most four sentences."""
        share = 100 * self.sum / self.num_residuals if self.num_residuals else 0.0
        said = [
            f"Redundancy {number(self.sum)} of {self.num_residuals:,} residuals "
            f"({share:.0f} %); sigma0 {number(self.sigma0)}."
        ]
        found = self.minimal_detectable_error
        if np.isfinite(found).any():
            low, middle, high = (
                number(float(f(found))) for f in (np.nanmin, np.nanmedian, np.nanmax)
            )
            said.append(
                f"Errors below {middle} px go unnoticed (median; {low} to {high} px; delta0 "
                f"{self.delta0:g})."
            )
        if self.num_uncontrolled:
            two = f", {self.num_two_view:,} in points with two rays" if self.num_two_view else ""
            said.append(
                f"{self.num_uncontrolled:,} of {self.num_used:,} observations are not checkable"
                f"{two}."
            )
        weakest = next((one for one in self.images if one.num_observations), None)
        if weakest is not None:
            said.append(
                f"Weakest: {weakest.words} (redundancy {100 * weakest.share:.0f} % of "
                f"{2 * weakest.num_observations:,} residuals)."
            )
        return tuple(said)

    def _display(self) -> Display:
        facts = [("", sentence) for sentence in self.sentences[1:]]
        facts += [("finding", finding.sentence) for finding in self.findings]
        facts += [("note", note) for note in self.notes]
        return Display(title=f"Reliability: {self.sentences[0]}", facts=tuple(facts))
