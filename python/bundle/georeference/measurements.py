"""Kinds of measurements beside the pixels: one row each.

A measurement passes through three steps, and the row of its kind names the code of each:

1. A reader makes priors of a problem from the options of a command (:class:`KnownPriors`).
2. A solve finds the priors of a request in its problem (:class:`FoundPriors`). They may place the
   model, move it where nothing places it, and add images or points to it; each has a factor.
3. The result has errors at the measurements (:class:`MeasurementErrors`), which the JSON report,
   the terminal and the page show.

Kinds with the same code for a step are processed together: positions and control points have one
local frame, and orientations, gravity and headings turn the world in this order. Factors are in the
order of the rows. Commands, solves and reports loop over ``ROWS``, so that a kind is added by a row
and the file of its mathematics. Rows name code by text, because most runs have no measurements.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.interface.georeference_options import SCALE_BAR_SIGMA, GeoreferenceOptions
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

if TYPE_CHECKING:
    from typing import TypeAlias

    from bundle.base.display import Display
    from bundle.georeference.alignment_result import ControlPointError
    from bundle.georeference.attitude_priors import AttitudePrior
    from bundle.georeference.control_point import GroundControlPoint, ScaleBar
    from bundle.georeference.point_check import PositionOffset, SurveyChecks
    from bundle.georeference.similarity import Similarity
    from bundle.georeference.vector_priors import VectorPrior
    from bundle.graphs.factors.factors import Factor
    from bundle.model.problem import Problem

    Prior: TypeAlias = VectorPrior | GroundControlPoint | AttitudePrior | ScaleBar


class Solved(Protocol):
    """Protocol of a result of :func:`bundle.solve`."""

    @property
    def problem(self) -> Problem:
        """Refined problem."""

    @property
    def similarity(self) -> Similarity | None:
        """Similarity from the input to the start of the solve."""

    @property
    def control_points(self) -> tuple[ControlPointError, ...]:
        """Residuals of control and check points relative to the survey."""

    @property
    def without_attitudes(self) -> Problem | None:
        """Model that a solve without measured attitudes determines."""

    @property
    def survey_checks(self) -> SurveyChecks | None:
        """Tests of control points and of an offset of the positions."""


class MeasurementErrors:
    """Errors of a result at the measurements of a reader, for all reports."""

    is_place = False
    """True if the errors also locate the model on the earth; pages have figures of such errors."""

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of the JSON report."""
        raise NotImplementedError

    @property
    def sentences(self) -> Sequence[str]:
        """Sentences of the headline."""
        return ()

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences about measurements that are probably wrong, and about ignored data."""
        return ()

    @property
    def displays(self) -> Sequence[Display]:
        """Facts and tables; the title is for pages."""
        return ()


class KnownPriors:
    """Priors that a reader made; a base class."""

    priors: tuple[Any, ...]

    def check_kept(self, problem: Problem, reason: str) -> None:
        """Refuse a model that contradicts the priors; ``reason`` says why it must not move."""

    def errors_of(self, result: Solved) -> MeasurementErrors | None:
        """Return the errors of a result at these priors; None if they are undetermined."""
        raise NotImplementedError


class FoundPriors:
    """Priors of a solve, found in its problem; a base class."""

    moves = False
    """True if the priors move a model that has no positions; see :meth:`placement`."""
    has_vertical = False
    """True if they determine the vertical of the world on their own."""
    adds_points = False
    """True if they add points, and :meth:`point_errors` has their errors."""
    offset: PositionOffset | None = None

    @staticmethod
    def make(problem: Problem, priors: Sequence[Any]) -> FoundPriors:
        """Find the priors in a problem."""
        raise NotImplementedError

    def placement(self, problem: Problem) -> Similarity | None:
        """Return the motion of the model that the priors require; None if it has no effect."""
        raise NotImplementedError

    def beside(self, problem: Problem, groups: Sequence[FoundPriors]) -> FoundPriors:  # noqa: ARG002
        """Return the priors, completed by what they need from the other priors of the solve."""
        return self

    def check(self, problem: Problem, groups: Sequence[FoundPriors]) -> None:
        """Refuse priors that are invalid at the start or together with the solve's other priors."""

    def added_to(self, problem: Problem, moved: Similarity | None) -> Problem:  # noqa: ARG002
        """Return the moved problem with the images or points of the priors as its last ones."""
        return problem

    def taken_from(self, problem: Problem) -> Problem:
        """Remove the additions from a problem after a solve or filter."""
        return problem

    def factors(self, problem: Problem) -> Sequence[Factor]:
        """Return a factor for each prior that counts, in order, for the start of the solve."""
        raise NotImplementedError

    def last_factors(self) -> Sequence[Factor]:
        """Return factors that follow those of all priors."""
        return ()

    def point_errors(self, problem: Problem) -> tuple[ControlPointError, ...]:
        """Return the residuals of added points in a solved problem."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Kind of a measurement.

    Attributes:
        noun: name in sentences.
        source: option that gives the measurements; kinds may share it.
        from_photographs: value of that option that reads the photographs; "" without one.
        fields: options of the kind, in the group of flags with this title and meaning.
        shared: options that other kinds have, too, and that the reader takes.
        read: reader, a function of problem and, by name, changed options.
        prior: class of the priors.
        found: class of priors that are found in a problem.
        entry: key of the errors in the JSON report.
        places: True if the measurements place a model: they have coordinates.
        moves: True if a command moves the model to them.
        needs_axes: True if they refer to the axes of the world, which they do not determine.
        options: class of its options, if they are not in GeoreferenceOptions.
    """

    noun: str
    source: str
    from_photographs: str = ""
    fields: tuple[str, ...]
    title: str
    meaning: str = ""
    shared: tuple[str, ...] = ()
    read: str | Callable[..., KnownPriors]
    prior: str | type
    found: str | type[FoundPriors]
    entry: str
    places: bool = False
    moves: bool = True
    needs_axes: bool = False
    options: type[Options] | None = None


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class ScaleBarOptions(Options):
    """Known lengths between control points or images."""

    scale_bars: str | None = option(
        None,
        "--scale-bars",
        "known lengths: lines of A B metres [sigma] [check], where A and B are control points of "
        "--gcp or images",
        metavar="FILE",
        value="path",
    )
    scale_bar_sigma: float = option(
        SCALE_BAR_SIGMA,
        "--scale-bar-sigma",
        "standard deviation of lengths without their own, in metres",
        metavar="METRES",
        above=0,
        needs=("scale_bars",),
    )


ROBUST = ("prior_loss", "prior_loss_scale")  # options of the loss of all priors
_ATTITUDES: dict[str, Any] = {
    "title": "gravity, orientations and headings",
    "meaning": "A model without positions is first rotated to fit them.",
    "shared": ROBUST,
    "read": "attitudes.attitudes_given",
    "found": "problem_attitudes.ProblemAttitudes",
}
_ORIENTATIONS: dict[str, Any] = _ATTITUDES | {
    "source": "orientations",
    "from_photographs": "xmp",
    "fields": ("orientations", "orientation_sigma", "orientation_sigma_scale"),
    "shared": ("images", *ROBUST),
}

ROWS = [
    Measurement(
        noun="positions",
        source="gps",
        from_photographs="exif",
        fields=("gps", "images", "gps_sigma", "gps_sigma_scale", "gps_offset", "antenna"),
        title="positions of images",
        shared=("gravity", "orientations", *ROBUST),
        read="survey_priors.survey_given",
        prior="vector_priors.PositionPrior",
        found="prior_alignment.ProblemPriors",
        entry="georeference",
        places=True,
    ),
    Measurement(
        noun="gravity",
        source="gravity",
        fields=("gravity", "gravity_sigma", "gravity_sigma_scale"),
        prior="attitude_priors.GravityPrior",
        entry="gravity",
        **_ATTITUDES,
    ),
    Measurement(
        noun="orientations",
        prior="attitude_priors.OrientationPrior",
        entry="orientations",
        **_ORIENTATIONS,
    ),
    Measurement(
        noun="headings",
        prior="attitude_priors.HeadingPrior",
        entry="headings",
        **_ORIENTATIONS,
    ),
    Measurement(
        noun="control points",
        source="gcp",
        fields=("gcp", "gcp_sigma", "gcp_pixel_sigma", "check_points"),
        title="ground control points",
        meaning="They are adjusted with the model, but not written as its points.",
        shared=("gravity", "orientations", *ROBUST),
        read="survey_priors.survey_given",
        prior="control_point.GroundControlPoint",
        found="target_priors.TargetPriors",
        entry="georeference",
        places=True,
    ),
    Measurement(
        noun="velocities",
        source="velocities",
        from_photographs="xmp",
        fields=("velocities", "velocity_sigma"),
        title="velocities of images",
        meaning="They need rolling shutters with free or tied twists, readouts and --frame-rate.",
        shared=("images", "antenna", *ROBUST),
        read="velocities.read_velocities",
        prior="velocities.VelocityPrior",
        found="velocities.ProblemVelocities",
        entry="velocities",
        moves=False,
        needs_axes=True,
    ),
    Measurement(
        noun="scale bars",
        source="scale_bars",
        fields=("scale_bars", "scale_bar_sigma"),
        title="scale bars",
        meaning="A model without positions and control points is first scaled to them.",
        shared=("gcp", *ROBUST),
        read="scale_bars.read_scale_bars",
        prior="scale_bars.ScaleBar",
        found="scale_bars.FoundBars",
        entry="scale_bars",
        options=ScaleBarOptions,
    ),
]
"""All kinds, in the order of their factors in a solve."""


def options_class() -> type[GeoreferenceOptions]:
    """Return one class with the options of all kinds of measurements."""
    return _with(tuple(dict.fromkeys(row.options for row in ROWS if row.options is not None)))


@functools.cache
def _with(more: tuple[type[Options], ...]) -> type[GeoreferenceOptions]:
    if not more:
        return GeoreferenceOptions
    bases, doc = (*more[::-1], GeoreferenceOptions), "Options of all measurements."
    made: Any = type("MeasurementOptions", bases, {"__doc__": doc})
    found: type[Any] = dataclass(frozen=True, kw_only=True, repr=False)(made)
    return found


def kinds_given(options: Any) -> tuple[Measurement, ...]:
    """Return a kind for each source that the options give, in order."""
    found: dict[str, Measurement] = {}
    for row in ROWS:
        if getattr(options, row.source, None) is not None:  # a command may lack kinds
            found.setdefault(row.source, row)
    return tuple(found.values())


def fields_of(*rows: Measurement) -> tuple[str, ...]:
    """Return the options of kinds, without those that they share with others."""
    return tuple(name for row in rows for name in row.fields)


def settings_of(options: Any, *rows: Measurement) -> dict[str, Any]:
    """Return the changed options of kinds as arguments of their readers."""
    taken = {*fields_of(*rows), *(name for row in rows for name in row.shared)}
    found: dict[str, Any] = options.arguments()
    return {name: value for name, value in found.items() if name in taken}


def readers(options: Any) -> Iterator[tuple[str, Callable[[Problem], KnownPriors]]]:
    """Yield each reader that has a source, with its first source."""
    given = kinds_given(options)
    for read in dict.fromkeys(row.read for row in ROWS):
        of_it = [row for row in ROWS if row.read == read]
        source = next((row.source for row in given if row in of_it), None)
        if source is not None:
            yield source, functools.partial(_code(read), **settings_of(options, *of_it))


@dataclass(frozen=True)
class Measurements:
    """All that was read for a problem."""

    known: tuple[KnownPriors, ...] = ()  # priors by reader

    @property
    def priors(self) -> tuple[Any, ...]:
        """All priors."""
        return tuple(prior for one in self.known for prior in one.priors)

    def errors(self, result: Solved) -> tuple[MeasurementErrors, ...]:
        """Return the errors of a result at the measurements."""
        found = (one.errors_of(result) for one in self.known)
        return tuple(errors for errors in found if errors is not None)


def place_of(measured: Sequence[MeasurementErrors]) -> Any:
    """Return the errors with the model's place on the earth; None without a georeference."""
    return next((one for one in measured if one.is_place), None)


def find_priors(problem: Problem, priors: Sequence[Any]) -> tuple[FoundPriors, ...]:
    """Return the priors of a solve in a problem, in the order of their factors."""
    groups: dict[str | type, list[Any]] = {row.found: [] for row in ROWS}
    for row, prior in zip(_kinds(priors), priors, strict=True):
        groups[row.found].append(prior)
    return tuple(_code(found).make(problem, given) for found, given in groups.items() if given)


def move_models(priors: Sequence[Any]) -> bool:
    """Return True if commands move a model to some of the priors."""
    return any(row.moves for row in _kinds(priors))


def kinds_of(priors: Sequence[Any]) -> tuple[Measurement, ...]:
    """Return the kinds of priors, without repetition."""
    return tuple(dict.fromkeys(_kinds(priors)))


def _kinds(priors: Sequence[Any]) -> Iterator[Measurement]:
    rows = [(_code(row.prior), row) for row in ROWS] if priors else []
    for place, prior in enumerate(priors):
        row = next((row for kind, row in rows if isinstance(prior, kind)), None)
        if row is None:
            raise InputError(
                "priors: expected PositionPriors, GroundControlPoints, ScaleBars and priors of "
                f"attitudes and velocities, found {brief(prior)} at [{place}]"
            )
        yield row


def _code(name: Any) -> Any:
    if not isinstance(name, str):
        return name
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(f"bundle.georeference.{module}"), attribute)
