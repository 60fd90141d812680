"""Prior on the velocity of an image with a rolling shutter.

While an image is read, its twist (w, v) moves the camera. With the readout rho as a share of a
frame, f frames per second, and a the antenna in the camera frame, the antenna's velocity is

    V = -f R^T (v + w x a) / rho,

and the prior costs 1/2 rho(r^T r), r = L^-1 (V - measured), Sigma = L L^T, as for positions.
``cpp/core/factors/velocity_factor.h`` has the derivation.
"""

from __future__ import annotations

from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.georeference.vector_prior import VectorPrior
from bundle.graphs.factors.twist_factors import VelocityFactor


@dataclass(frozen=True, eq=False, repr=False)
class VelocityPrior(VectorPrior):
    """Measured velocity of an image with a rolling shutter, for example from GPS (Doppler).

    Attributes:
        image: id or name of the image.
        velocity: (3,) velocity of the projection centre, or of the antenna, along the axes of the
            world: east, north, up for priors of :func:`bundle.georeference.gps_priors`. In length
            units per second (:attr:`bundle.RollingShutter.frame_rate` has the frames per second).
            If the third coordinate is nan, only the horizontal velocity counts.
        sigma: standard deviation: one number, (horizontal, vertical), or one per axis. An axis with
            an infinite sigma does not count. Give either ``sigma`` or ``covariance``.
        covariance: (3, 3) symmetric positive definite, in squared units of the velocity.
        lever_arm: (3,) position of the antenna in the camera frame (x right, y down, z forward), in
            the length unit.
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: length of the residual in sigmas beyond which the loss is robust; by default
            2.795, which 5 % of good velocities exceed.

    Raises:
        InputError: a value has a wrong type, shape or range; the message names the image.
    """

    velocity: ArrayLike
    sigma: ArrayLike | None = None

    noun = "velocity"

    def factor(self, image_id: int, camera_id: int, frame_rate: float) -> VelocityFactor:
        """Return the factor of a solve for the image and camera with these ids."""
        return VelocityFactor(
            ("image", image_id),
            ("twist", image_id),
            ("readout", camera_id),
            self.known / frame_rate,
            self.information * frame_rate**2,
            lever_arm=self.lever_arm,
            loss=self.loss,
            loss_scale=self.loss_scale,
        )
