"""What one round of adjusting and filtering did, and to which part of a problem."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PartRecord", "Round"]


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
class PartRecord:
    """What took part in an adjustment of some images only.

    Attributes:
        num_images: refined.
        num_images_held: others that see a point of these, held.
        num_points: seen by a refined image; refined.
        num_observations: of these points.
        shared_camera_ids: cameras of refined images that also took others: if their intrinsics are
            refined, projections into images that are held change.
    """

    num_images: int
    num_images_held: int
    num_points: int
    num_observations: int
    shared_camera_ids: tuple[int, ...]
