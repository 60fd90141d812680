"""Factors of a graph: what is known of its variables, each a residual and a loss.

Every factor costs 1/2 rho(r^T r) with its whitened residual r = L^T e, where e is its error and
L L^T = Omega the Cholesky factorisation of its information matrix, so that r^T r = e^T Omega e.
The core computes residuals and Jacobians; ``cpp/core/factors`` has the derivations.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.arguments import as_array, as_flag
from bundle.base.arrays import freeze, refrozen
from bundle.base.display import Display, Displayed
from bundle.errors import InputError, brief
from bundle.graphs.factors.variables import Array, Key, as_row, check_key
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES
from bundle.model.cameras import camera_models

__all__ = [
    "BetweenFactor",
    "Factor",
    "PositionFactor",
    "PriorFactor",
    "RelativePoseFactor",
    "ReprojectionFactor",
    "ScalarPriorFactor",
]


@dataclass(frozen=True, eq=False, repr=False)
class Factor(Displayed):
    """What all factors have.

    Attributes:
        loss: a robust loss out of :class:`bundle.SolveOptions`.
        loss_scale: the norm of the whitened residual, in sigmas, at which the loss bends.
    """

    loss: str = field(default="trivial", kw_only=True)
    loss_scale: float = field(default=1.0, kw_only=True)

    kind = ""

    if TYPE_CHECKING:  # a property here would be the default of a field of that name

        @property
        def keys(self) -> tuple[Key, ...]:
            """The variables, in the order of the Jacobians."""

    def __post_init__(self) -> None:
        for key in self.keys:
            check_key(type(self).__name__, key)
        self._set("loss", choice(f"{self.name}: loss", self.loss, LOSSES))
        self._set("loss_scale", number(f"{self.name}: loss_scale", self.loss_scale, above=0))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(refrozen(state))

    @cached_property
    def name(self) -> str:
        """The kind and the variables, in messages."""
        return f"{type(self).__name__}({', '.join(brief(key) for key in self.keys)})"

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """Return what ``_core`` takes beside name, variables and loss.

        Args:
            name: of the factor within its graph.
            sizes: of the variables' tangent spaces.
        """
        raise NotImplementedError

    def _set(self, attribute: str, value: Any) -> None:
        object.__setattr__(self, attribute, value)

    def _freeze_row(self, *attributes: str) -> None:
        for attribute in attributes:
            row = as_row(f"{self.name}: {attribute}", getattr(self, attribute))
            self._set(attribute, freeze(row.copy()))

    def _freeze_matrix(self, attribute: str) -> None:
        array = as_array(f"{self.name}: {attribute}", getattr(self, attribute))
        self._set(attribute, freeze(array.copy()))

    def _display(self) -> Display:
        facts = [("variables", ", ".join(brief(key) for key in self.keys))]
        if self.loss != "trivial":
            facts.append(("loss", f"{self.loss}, scale {self.loss_scale:g}"))
        return Display(title=type(self).__name__, facts=tuple(facts))


def as_information(name: str, information: Array, size: int) -> Array:
    """Return an information matrix; a number stands for that times the identity.

    Raises:
        InputError: it has another shape.
    """
    if information.ndim == 0 or information.shape == (1,):
        return float(information.reshape(())) * np.eye(size)
    if information.shape != (size, size):
        raise InputError(
            f"{name}: information: expected shape ({size}, {size}) or one number, "
            f"found {information.shape}"
        )
    return information


@dataclass(frozen=True, eq=False, repr=False)
class PriorFactor(Factor):
    """What is known of one variable X: e = Log(value^-1 X).

    On a Euclidean variable e = X - value: a prior on a point, or on the parameters of a camera.

    Attributes:
        key: the variable.
        value: as the variable's manifold stores it.
        information: symmetric positive definite, by the tangent coordinates of the variable
            (:class:`bundle.FactorGraph` lists them), or a number: times the identity.

    Raises:
        InputError: these are no numbers; what does not fit the variable is refused by
            :meth:`bundle.FactorGraph.add_factor`.
    """

    key: Key
    value: ArrayLike
    information: ArrayLike

    kind = "prior"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_row("value")
        self._freeze_matrix("information")

    @property
    def keys(self) -> tuple[Key, ...]:
        """The variables, in the order of the Jacobians."""
        return (self.key,)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """See :meth:`Factor.core_arguments`."""
        return self.value, as_information(name, np.asarray(self.information), sizes[0])


@dataclass(frozen=True, eq=False, repr=False)
class ScalarPriorFactor(Factor):
    """What is known of one number x of a Euclidean variable, such as a camera's parameter.

    The residual is (x - value) / sigma, or (log x - log value) / sigma where relative.

    Attributes:
        key: the variable.
        index: of the number in the variable.
        value: that was measured.
        sigma: its standard deviation; where relative a share of the value: 0.02 is two percent.
        relative: whether it is the logarithm that is known, as of a focal length: half and twice
            the value are as far from it. The number then stays on its side of zero.

    Raises:
        InputError: these are no numbers, sigma is not above 0, or a relative value is 0; an index
            that the variable does not have is refused by :meth:`bundle.FactorGraph.add_factor`.
    """

    key: Key
    index: int
    value: float
    sigma: float
    relative: bool = field(default=False, kw_only=True)

    kind = "scalar_prior"

    def __post_init__(self) -> None:
        super().__post_init__()
        index = number(f"{self.name}: index", self.index, whole=True, minimum=0)
        self._set("index", index)
        self._set("value", number(f"{self.name}: value", self.value))
        self._set("sigma", number(f"{self.name}: sigma", self.sigma, above=0))
        self._set("relative", as_flag(f"{self.name}: relative", self.relative))
        if self.relative and self.value == 0:
            raise InputError(f"{self.name}: value: expected another number than 0 where relative")

    @property
    def keys(self) -> tuple[Key, ...]:
        """The variables, in the order of the Jacobians."""
        return (self.key,)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return self.index, self.value, self.sigma, self.relative


@dataclass(frozen=True, eq=False, repr=False)
class _RelativeFactor(Factor):
    """A measurement between two variables."""

    a: Key
    b: Key
    measurement: ArrayLike
    information: ArrayLike

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.a == self.b:
            raise InputError(f"{self.name}: expected two different variables, found one twice")
        self._freeze_row("measurement")
        self._freeze_matrix("information")

    @property
    def keys(self) -> tuple[Key, ...]:
        """The variables, in the order of the Jacobians."""
        return self.a, self.b


@dataclass(frozen=True, eq=False, repr=False)
class BetweenFactor(_RelativeFactor):
    """A relative measurement of two variables on one manifold: e = Log(Z^-1 A^-1 B).

    The error of a pose graph's edge, with the full logarithm of SE(2) or SE(3). On Euclidean
    variables e = b - a - z; differences of angles are taken within a half turn.

    Attributes:
        a: key of the variable A, in whose frame B was measured.
        b: key of the variable B.
        measurement: Z = A^-1 B as measured, as the manifold stores it.
        information: symmetric positive definite, by the tangent coordinates of the manifold
            (:class:`bundle.FactorGraph` lists them: se3 has the rotation first), or a number.

    Raises:
        InputError: these are no numbers, or both keys are the same.
    """

    kind = "between"

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """See :meth:`Factor.core_arguments`."""
        return self.measurement, as_information(name, np.asarray(self.information), sizes[0])


@dataclass(frozen=True, eq=False, repr=False)
class RelativePoseFactor(_RelativeFactor):
    """A measured relative pose of two images A and B: e = Log(Z^-1 B A^-1).

    The variables are cam_from_world, so that B A^-1 is cam_b_from_cam_a, which no motion of the
    world changes. (:class:`BetweenFactor` of the same variables would compare A^-1 B, which means
    something where variables are world_from_camera.)

    Attributes:
        a: key of the pose A, on se3.
        b: key of the pose B, on se3.
        measurement: Z, cam_b_from_cam_a as measured: qx qy qz qw tx ty tz.
        information: (6, 6) symmetric positive definite, rotation first, or a number.

    Raises:
        InputError: these are no numbers, or both keys are the same.
    """

    kind = "relative_pose"

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return self.measurement, as_information(name, np.asarray(self.information), 6)


@dataclass(frozen=True, eq=False, repr=False)
class PositionFactor(Factor):
    """A measured position of an antenna on a camera: e = R^T (lever_arm - t) - position.

    Attributes:
        key: a pose cam_from_world (R, t) on se3.
        position: (3,) of the antenna in the world.
        information: (3, 3) symmetric positive definite, by the axes of the world, or a number.
        lever_arm: (3,) place of the antenna in the frame of the camera; zeros: the camera's centre.

    Raises:
        InputError: these are no numbers.
    """

    key: Key
    position: ArrayLike
    information: ArrayLike
    lever_arm: ArrayLike = field(default=(0.0, 0.0, 0.0), kw_only=True)

    kind = "position"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_row("position", "lever_arm")
        self._freeze_matrix("information")

    @property
    def keys(self) -> tuple[Key, ...]:
        """The variables, in the order of the Jacobians."""
        return (self.key,)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        information = as_information(name, np.asarray(self.information), 3)
        return self.position, self.lever_arm, information


@dataclass(frozen=True, eq=False, repr=False)
class ReprojectionFactor(Factor):
    """A point seen in an image: e = projection(R X + t) - observation, in pixels.

    A point behind its camera keeps the error that the formula gives.

    Attributes:
        pose: key of the pose cam_from_world (R, t), on se3.
        camera: key of the camera's parameters in COLMAP's order, Euclidean.
        point: key of the point X, Euclidean (3,).
        observation: (2,) pixels.
        model: COLMAP's name of the camera model.
        information: (2, 2) symmetric positive definite, or a number; 1 is a sigma of one pixel.

    Raises:
        InputError: these are no numbers.
    """

    pose: Key
    camera: Key
    point: Key
    observation: ArrayLike
    model: str
    information: ArrayLike = 1.0

    kind = "reprojection"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set("model", choice(f"{self.name}: model", self.model, camera_models()))
        self._freeze_row("observation")
        self._freeze_matrix("information")

    @property
    def keys(self) -> tuple[Key, ...]:
        """The variables, in the order of the Jacobians."""
        return self.pose, self.camera, self.point

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        information = as_information(name, np.asarray(self.information), 2)
        return self.model, self.observation, information
