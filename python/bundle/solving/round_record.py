"""Records of a round of adjusting and filtering, and of the part that was refined."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PartRecord", "RestRecord", "Round"]


@dataclass(frozen=True, kw_only=True)
class Round:
    """One round: an adjustment, then a filter. Costs of different rounds cannot be compared.

    Attributes:
        round: from 1.
        initial_cost: at the start of the adjustment, 1/2 sum rho(||r||^2).
        cost: after the adjustment, before the filter.
        termination_type: of the adjustment, by Ceres' name.
        num_iterations: steps of the adjustment, the rejected ones included.
        num_points: adjusted.
        num_observations: adjusted.
        num_observations_removed: by the filter after it, those of removed points included.
        num_points_removed: by the filter after it.
    """

    round: int
    initial_cost: float
    cost: float
    termination_type: str
    num_iterations: int
    num_points: int
    num_observations: int
    num_observations_removed: int
    num_points_removed: int


@dataclass(frozen=True, kw_only=True)
class RestRecord:
    """The marginalised rest of a local adjustment, and the prior that it left.

    Attributes:
        num_images: eliminated, neighbours of the part not included.
        num_points: eliminated.
        num_points_without_parallax: of these, left out along their unobserved direction.
        prior_size: unknowns of the prior, poses of neighbours and parameters of cameras; 0: no
            prior, since the rest has no information on the part.
        prior_rank: of its information matrix, the held gauge included.
        prior_bytes: of that matrix.
        gauge_degrees: gauge freedom; along it the neighbours stay where they are on average.
        cost_before: of the prior, above its minimum, at the start.
        cost_after: the same at the end.
    """

    num_images: int
    num_points: int
    num_points_without_parallax: int
    prior_size: int
    prior_rank: int
    prior_bytes: int
    gauge_degrees: int
    cost_before: float = 0.0
    cost_after: float = 0.0


@dataclass(frozen=True, kw_only=True)
class PartRecord:
    """The part of a problem in a local adjustment.

    Attributes:
        num_images: refined.
        num_images_held: others that see a point of these; constant, or under the prior of the rest.
        num_points: seen by a refined image; refined.
        num_observations: of these points.
        shared_camera_ids: cameras of refined images that also took others: if their intrinsics are
            refined, projections into constant images change.
        rest: the marginalised rest; None if it was held.
    """

    num_images: int
    num_images_held: int
    num_points: int
    num_observations: int
    shared_camera_ids: tuple[int, ...]
    rest: RestRecord | None = None
