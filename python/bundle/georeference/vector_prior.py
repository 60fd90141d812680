"""Base class of priors of a measured vector at an image: its position, its velocity."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arguments import as_array
from bundle.base.arrays import FrozenArrays, freeze
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.interface.georeference_options import ROBUST_SCALE
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES

Array = NDArray[np.float64]

UNKNOWN = 1e100
"""Standard deviation whose inverse square is negligible in every sum of this module."""


@dataclass(frozen=True, eq=False, repr=False)
class VectorPrior(FrozenArrays, Displayed):
    """Measured vector at an image, with its uncertainty, a lever arm and a loss.

    Subclasses add the vector, whose name is ``noun``, and ``sigma``.
    """

    image: int | str
    covariance: ArrayLike | None = field(default=None, kw_only=True)
    lever_arm: ArrayLike = field(default=(0.0, 0.0, 0.0), kw_only=True)
    loss: str = field(default="trivial", kw_only=True)
    loss_scale: float = field(default=ROBUST_SCALE, kw_only=True)

    noun = ""

    def __post_init__(self) -> None:
        if isinstance(self.image, bool) or not isinstance(self.image, int | str | np.integer):
            raise InputError(
                f"{type(self).__name__}: image: expected an id or a name, found {brief(self.image)}"
            )
        given: Any = self
        name = self.name
        vector = _vector(f"{name}: {self.noun}", getattr(self, self.noun))
        if not np.isfinite(vector[:2]).all() or np.isinf(vector[2]):
            raise InputError(
                f"{name}: {self.noun}: expected finite numbers (the third may be nan), "
                f"found {brief(vector.tolist())}"
            )
        lever_arm = _vector(f"{name}: lever_arm", self.lever_arm)
        if not np.isfinite(lever_arm).all():
            raise InputError(
                f"{name}: lever_arm: expected finite numbers, found {brief(lever_arm.tolist())}"
            )
        self._set(**{self.noun: vector}, lever_arm=lever_arm)
        if (given.sigma is None) == (self.covariance is None):
            raise InputError(f"{name}: expected either sigma or covariance")
        if given.sigma is not None:
            self._set(sigma=_sigmas(f"{name}: sigma", given.sigma))
        else:
            self._set(covariance=_covariance(f"{name}: covariance", self.covariance))
        self._set(
            loss=choice(f"{name}: loss", self.loss, LOSSES),
            loss_scale=number(f"{name}: loss_scale", self.loss_scale, above=0),
        )

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"{type(self).__name__}({brief(self.image)})"

    @property
    def full_covariance(self) -> Array:
        """Covariance (3, 3); axes that do not count have a variance of 1e200."""
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
        """Return L^-1 times a (3,) residual; axes that do not count are zero."""
        root = np.linalg.cholesky(self.information)
        return np.asarray(root.T @ np.nan_to_num(residual), dtype=np.float64)

    def _set(self, **values: Any) -> None:
        for attribute, value in values.items():
            frozen = freeze(value.copy()) if isinstance(value, np.ndarray) else value
            object.__setattr__(self, attribute, frozen)

    def _display(self) -> Display:
        given: Any = self
        vector = ", ".join(f"{value:.10g}" for value in np.asarray(getattr(self, self.noun)))
        facts = [("image", brief(self.image)), (self.noun, vector)]
        if given.sigma is not None:
            sigmas = ", ".join(f"{value:g}" for value in np.asarray(given.sigma))
            facts.append(("sigma", sigmas))
        if self.loss != "trivial":
            facts.append(("loss", f"{self.loss}, scale {self.loss_scale:g} sigmas"))
        return Display(title=type(self).__name__, facts=tuple(facts))


def _vector(name: str, value: Any) -> Array:
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
    if not (given > 0).all():
        raise InputError(f"{name}: expected numbers above 0, found {brief(given.tolist())}")
    first, last = given[0], given[-1]
    return given.copy() if len(given) == 3 else np.array([first, first, last])


def _covariance(name: str, value: Any) -> Array:
    matrix = as_array(name, value)
    if matrix.shape != (3, 3):
        raise InputError(f"{name}: expected shape (3, 3), found {matrix.shape}")
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
