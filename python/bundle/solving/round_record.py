"""Records of a round of adjusting and filtering, and of a local adjustment."""

from __future__ import annotations

from bundle.base.records import dataclass


@dataclass(frozen=True, kw_only=True)
class Round:
    """One round: an adjustment, then a filter. Costs of different rounds cannot be compared.

    Attributes:
        round: number of the round, from 1.
        initial_cost: cost at the start of the adjustment, 1/2 sum rho(||r||^2).
        cost: cost after the adjustment, before the filter.
        termination_type: Ceres' name of the adjustment's termination type.
        num_iterations: steps of the adjustment, including rejected steps.
        num_points: number of adjusted points.
        num_observations: number of adjusted observations.
        num_observations_removed: observations that the filter removed after the adjustment,
            including those of removed points.
        num_points_removed: points that the filter removed after the adjustment.
        num_observations_beyond_max_error: removed because of their own error, because they are
            behind the camera, or because they have no projection.
        num_observations_with_short_track: removed with points whose track became too short.
        num_observations_below_min_angle: removed with points of a small triangulation angle.
        max_error: largest error that the filter keeps [px].
        min_angle: smallest triangulation angle that the filter keeps [degrees].
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
    num_observations_beyond_max_error: int = 0
    num_observations_with_short_track: int = 0
    num_observations_below_min_angle: int = 0
    max_error: float = 0.0
    min_angle: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RestRecord:
    """Marginalized remainder of a problem in a local adjustment, and its prior.

    Attributes:
        num_images: number of eliminated images, without the neighbours of the part.
        num_points: number of eliminated points.
        num_points_without_parallax: number of these points that have an unobserved direction, which
            was left out.
        prior_size: number of unknowns of the prior: poses of neighbours and parameters of cameras.
            0: no prior, because the remainder has no information on the part.
        prior_rank: rank of the prior's information matrix, including the fixed gauge.
        prior_bytes: size of this matrix in bytes.
        gauge_degrees: gauge freedom, which is fixed by keeping the neighbours in place on average.
        cost_before: cost of the prior at the start, above its minimum.
        cost_after: cost of the prior at the end, above its minimum.
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
    """Part of a problem that takes part in a local adjustment.

    Attributes:
        num_images: number of refined images.
        num_images_held: number of other images that see a point of the refined images. They are
            constant, or under the marginal prior.
        num_points: number of points that a refined image sees; all are refined.
        num_observations: number of observations of these points.
        shared_camera_ids: cameras of both refined and other images. If their intrinsics are
            refined, projections into constant images change.
        num_sensors: number of sensors on rigs of which all images are refined; the solve may move
            these alone.
        rest: the marginalized remainder; None if it was constant.
    """

    num_images: int
    num_images_held: int
    num_points: int
    num_observations: int
    shared_camera_ids: tuple[int, ...]
    num_sensors: int = 0
    rest: RestRecord | None = None
