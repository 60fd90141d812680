"""Priors of what is measured at an image: of any kind, of a vector, of its position."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import Array as Declared
from bundle.base.arrays import FrozenArrays, as_array, as_declared, check_type, check_values, freeze
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.graphs.factors.factors import PositionFactor
from bundle.interface.georeference_options import OFFSET_AXES, ROBUST_SCALES
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES

Array = NDArray[np.float64]

UNKNOWN = 1e100  # standard deviation whose inverse square is negligible in every sum of this module


@dataclass(frozen=True, eq=False, repr=False)
class ImagePrior(FrozenArrays, Displayed):
    """Quantity measured at an image, with a robust loss; a base class."""

    image: int | str
    loss: str = field(default="trivial", kw_only=True)
    loss_scale: float | None = field(default=None, kw_only=True)

    noun = ""
    num_residuals = 3  # determines the default of loss_scale

    def __post_init__(self) -> None:
        place, image = f"{type(self).__name__}: image", self.image
        kind: Any = str if isinstance(image, bool) else int | str | np.integer
        check_type(place, image, kind, "an id or a name")
        scale = ROBUST_SCALES[self.num_residuals] if self.loss_scale is None else self.loss_scale
        self._set(
            loss=choice(f"{self.name}: loss", self.loss, LOSSES),
            loss_scale=number(f"{self.name}: loss_scale", scale, above=0),
        )

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"{type(self).__name__}({brief(self.image)})"

    @property
    def _robust(self) -> dict[str, Any]:
        return {"loss": self.loss, "loss_scale": self.loss_scale}

    def _set(self, **values: Any) -> None:
        for attribute, value in values.items():
            frozen = freeze(value.copy()) if isinstance(value, np.ndarray) else value
            object.__setattr__(self, attribute, frozen)

    def _shown(self, *facts: tuple[str, str]) -> Display:
        rows = [("image", brief(self.image)), *facts]
        if self.loss != "trivial":
            rows.append(("loss", f"{self.loss}, scale {self.loss_scale:g} sigmas"))
        return Display(title=type(self).__name__, facts=tuple(rows))


@dataclass(frozen=True, eq=False, repr=False)
class VectorPrior(ImagePrior):
    """Measured vector at an image, with its uncertainty and a lever arm.

    Subclasses add the vector, whose name is ``noun``, and ``sigma``.
    """

    covariance: ArrayLike | None = field(default=None, kw_only=True)
    lever_arm: ArrayLike = field(default=(0.0, 0.0, 0.0), kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        given: Any = self
        name = self.name
        vector = three_numbers(f"{name}: {self.noun}", getattr(self, self.noun))
        if not np.isfinite(vector[:2]).all() or np.isinf(vector[2]):
            raise InputError(
                f"{name}: {self.noun}: expected finite numbers (the third may be nan), "
                f"found {brief(vector.tolist())}"
            )
        lever_arm = three_numbers(f"{name}: lever_arm", self.lever_arm)
        check_values(f"{name}: lever_arm", lever_arm, Declared((3,), "finite"))
        self._set(**{self.noun: vector}, lever_arm=lever_arm)
        if (given.sigma is None) == (self.covariance is None):
            raise InputError(f"{name}: expected either sigma or covariance")
        if given.sigma is not None:
            self._set(sigma=_sigmas(f"{name}: sigma", given.sigma))
        else:
            self._set(covariance=_covariance(f"{name}: covariance", self.covariance))

    @property
    def full_covariance(self) -> Array:
        """Covariance (3, 3); axes that are ignored have a variance of 1e200."""
        given: Any = self
        if self.covariance is not None:
            full: Array = np.array(self.covariance, dtype=np.float64)
        else:
            sigmas = np.asarray(given.sigma, dtype=np.float64)
            full = np.eye(3) * np.clip(sigmas, 1 / UNKNOWN, UNKNOWN) ** 2
        if np.isnan(getattr(self, self.noun)[2]):
            full[2, 2] = UNKNOWN**2
        return full

    @property
    def information(self) -> Array:
        """Inverse (3, 3) of the covariance."""
        return _inverse(self.full_covariance)

    @property
    def known(self) -> Array:
        """The vector (3,), with zero for an unknown third coordinate."""
        return np.nan_to_num(np.asarray(getattr(self, self.noun), dtype=np.float64))

    def whiten(self, residual: Array) -> Array:
        """Return L^-1 times a (3,) residual; axes that are ignored are zero."""
        root = np.linalg.cholesky(self.information)
        return np.asarray(root.T @ np.nan_to_num(residual), dtype=np.float64)

    def _display(self) -> Display:
        given: Any = self
        facts = [(self.noun, ", ".join(f"{x:.10g}" for x in np.asarray(getattr(self, self.noun))))]
        if given.sigma is not None:
            facts.append(("sigma", ", ".join(f"{sigma:g}" for sigma in np.asarray(given.sigma))))
        return self._shown(*facts)


def three_numbers(name: str, value: Any) -> Array:
    """Return an array (3,)."""
    vector = as_array(name, value)
    if vector.shape != (3,):
        raise InputError(f"{name}: expected 3 numbers, found shape {vector.shape}")
    return vector


def _sigmas(name: str, value: Any) -> Array:
    """Return one standard deviation per axis."""
    given = np.atleast_1d(as_array(name, value))
    if given.shape not in ((1,), (2,), (3,)):
        raise InputError(
            f"{name}: expected one number, (horizontal, vertical) or one per axis, "
            f"found shape {given.shape}"
        )
    check_values(name, given, Declared((3,), "above 0"))
    first, last = given[0], given[-1]
    return given.copy() if len(given) == 3 else np.array([first, first, last])


def _covariance(name: str, value: Any) -> Array:
    matrix: Array = as_declared(name, value, Declared((3, 3)))
    diagonal = np.diag(matrix)
    if np.isfinite(matrix).all() and (diagonal > 0).all():
        scale = np.sqrt(np.outer(diagonal, diagonal))
        symmetric = bool((np.abs(matrix - matrix.T) <= 1e-12 * scale).all())
        # Correlations do not depend on the units of the axes.
        if symmetric and np.linalg.eigvalsh((matrix / scale + (matrix / scale).T) / 2)[0] > 1e-14:
            return (matrix + matrix.T) / 2
    raise InputError(
        f"{name}: expected a symmetric positive definite matrix, found {brief(matrix.tolist())}"
    )


def _inverse(covariance: Array) -> Array:
    """Return the inverse of a covariance whose axes may have very different units."""
    sigmas = np.sqrt(np.diag(covariance))
    scale = np.outer(sigmas, sigmas)
    inverse = np.linalg.inv(covariance / scale)
    information: Array = (inverse + inverse.T) / 2 / scale
    return information


# Prior on the position of an image.
#
# With c(pose) = -R^T t the projection centre, a the antenna in the camera frame and p the measured
# position, the prior costs
#
#     1/2 rho(r^T r),  r = L^-1 (c + R^T a - p),  Sigma = L L^T
#
# in addition to the cost of reprojection errors, whose sigma is one pixel. The cost of a solve is
# 1/2 sum (e / 1 px)^2 + 1/2 sum rho(r^T r). An axis without a measurement has a very large sigma:
# its contribution to cost, gradient and Hessian is zero in double precision.


@dataclass(frozen=True, eq=False, repr=False)
class PositionPrior(VectorPrior):
    """Measured position of an image, for example from GPS.

    Attributes:
        image: id or name of the image.
        position: (3,) position of the projection centre, or of the antenna, in the length unit of
            ``sigma``. If the third coordinate is nan, only the horizontal position counts.
        sigma: standard deviation: one number, (horizontal, vertical), or one per axis. An axis with
            an infinite sigma is ignored. Give either ``sigma`` or ``covariance``.
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
        self._set(offset=choice(f"{self.name}: offset", self.offset, tuple(OFFSET_AXES)))

    def factor(self, image_id: int) -> PositionFactor:
        """Return the factor of a solve for the image with this id."""
        return PositionFactor(
            ("image", image_id),
            self.known,
            self.information,
            lever_arm=self.lever_arm,
            **self._robust,
        )
