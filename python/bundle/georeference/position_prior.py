"""Prior on the position of an image.

With c(pose) = -R^T t the projection centre, a the antenna in the camera frame and p the measured
position, the prior costs

    1/2 rho(r^T r),  r = L^-1 (c + R^T a - p),  Sigma = L L^T

in addition to the cost of reprojection errors, whose sigma is one pixel. The cost of a solve is
1/2 sum (e / 1 px)^2 + 1/2 sum rho(r^T r). An axis without a measurement has a very large sigma: its
contribution to cost, gradient and Hessian is zero in double precision.
"""

from __future__ import annotations

from dataclasses import field

from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.georeference.vector_prior import VectorPrior
from bundle.graphs.factors.factors import PositionFactor
from bundle.interface.georeference_options import GPS_OFFSETS
from bundle.interface.option_fields import choice


@dataclass(frozen=True, eq=False, repr=False)
class PositionPrior(VectorPrior):
    """Measured position of an image, for example from GPS.

    Attributes:
        image: id or name of the image.
        position: (3,) position of the projection centre, or of the antenna, in the length unit of
            ``sigma``. If the third coordinate is nan, only the horizontal position counts.
        sigma: standard deviation: one number, (horizontal, vertical), or one per axis. An axis with
            an infinite sigma does not count. Give either ``sigma`` or ``covariance``.
        covariance: (3, 3) symmetric positive definite, in squared length units.
        lever_arm: (3,) position of the antenna in the camera frame (x right, y down, z forward), in
            the same length unit.
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: length of the residual in sigmas beyond which the loss is robust; by default
            2.795, which 5 % of good positions exceed.
        offset: "up" or "all": the position has an unknown offset, in height or along all axes,
            which is the same for all such priors of a solve; "none" (the default): it has none.

    Raises:
        InputError: a value has a wrong type, shape or range; the message names the image.
    """

    position: ArrayLike
    sigma: ArrayLike | None = None
    offset: str = field(default="none", kw_only=True)

    noun = "position"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set(offset=choice(f"{self.name}: offset", self.offset, GPS_OFFSETS))

    def factor(self, image_id: int) -> PositionFactor:
        """Return the factor of a solve for the image with this id."""
        return PositionFactor(
            ("image", image_id),
            self.known,
            self.information,
            lever_arm=self.lever_arm,
            loss=self.loss,
            loss_scale=self.loss_scale,
        )
