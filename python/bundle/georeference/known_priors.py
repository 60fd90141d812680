"""All priors that a command was given: positions, control points, attitudes and velocities."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.georeference.attitude_priors import AttitudePrior
from bundle.georeference.attitudes import AttitudeErrors, Attitudes
from bundle.georeference.control_point import GroundControlPoint
from bundle.georeference.georeferenced import Georeference, Solved
from bundle.georeference.survey_priors import GcpPriors, GpsPriors
from bundle.georeference.vector_priors import PositionPrior, VelocityPrior
from bundle.georeference.velocities import Velocities, VelocityErrors


@dataclass(frozen=True)
class KnownPriors:
    """Priors of a solve by their source.

    Attributes:
        survey: priors of positions and control points, or None.
        attitudes: priors of attitudes, or None.
        velocities: priors of velocities, or None.
    """

    survey: GcpPriors | GpsPriors | None
    attitudes: Attitudes | None
    velocities: Velocities | None = None

    @property
    def priors(
        self,
    ) -> tuple[PositionPrior | GroundControlPoint | AttitudePrior | VelocityPrior, ...]:
        """All priors."""
        return (
            *(() if self.survey is None else self.survey.priors),
            *(() if self.attitudes is None else self.attitudes.priors),
            *(() if self.velocities is None else self.velocities.priors),
        )

    def georeference(self, result: Solved) -> Georeference | None:
        """Return the georeference of a result; None without positions and control points."""
        return None if self.survey is None else self.survey.georeference(result)

    def attitude_errors(self, result: Solved) -> tuple[AttitudeErrors, ...]:
        """Return the residuals of attitudes in a result, by kind."""
        return (
            ()
            if self.attitudes is None
            else self.attitudes.errors(result.problem, free=result.without_attitudes)
        )

    def velocity_errors(self, result: Solved) -> VelocityErrors | None:
        """Return the residuals of velocities in a result; None without any."""
        return None if self.velocities is None else self.velocities.errors(result.problem)
