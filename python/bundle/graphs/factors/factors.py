"""Factors of a graph: measurements of its variables, each a residual and a loss.

A factor costs 1/2 rho(r^T r) with the whitened residual r = L^T e, where e is its error and L L^T =
Omega the Cholesky factorisation of its information matrix, so that r^T r = e^T Omega e. The core
computes residuals and Jacobians; ``cpp/core/factors`` has the derivations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from functools import cached_property
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.arrays import FrozenArrays, as_array, as_flag, check_distinct, freeze
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.checking.function import UserFunction
from bundle.errors import InputError, brief, check_keywords
from bundle.graphs.factors.variables import Array, Key, as_keys, as_row, check_key, variable_name
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES
from bundle.model.cameras import camera_models


@dataclass(frozen=True, eq=False, repr=False)
class Factor(FrozenArrays, Displayed):
    """Base class of all factors.

    Attributes:
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: norm of the whitened residual, in sigmas, beyond which the loss is robust.
    """

    loss: str = field(default="trivial", kw_only=True)
    loss_scale: float = field(default=1.0, kw_only=True)

    kind = ""
    dependent_residuals = 0
    """Number of residuals that the others determine; degrees of freedom do not count these."""

    if TYPE_CHECKING:  # at run time a property would become the default of a dataclass field

        @property
        def keys(self) -> tuple[Key, ...]:
            """Variables in the order of the Jacobians."""

    def __post_init__(self) -> None:
        for key in self.keys:
            check_key(type(self).__name__, key)
        self._set("loss", choice(f"{self.name}: loss", self.loss, LOSSES))
        self._set("loss_scale", number(f"{self.name}: loss_scale", self.loss_scale, above=0))

    @cached_property
    def name(self) -> str:
        """Kind and variables, for messages."""
        return f"{type(self).__name__}({', '.join(brief(key) for key in self.keys)})"

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """Return the arguments of ``_core`` in addition to name, variables and loss."""
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


class MeasuredFactor(Factor):
    """Base class of factors whose variables, arrays and arguments of ``_core`` are declared.

    ``_keys``: fields with keys. ``_rows``: fields with arrays of numbers. ``_given``: arguments.
    ``_size``: rows of the information; 0: as many as the first variable has tangent coordinates.
    """

    _keys: ClassVar[tuple[str, ...]] = ("key",)
    _rows: ClassVar[tuple[str, ...]] = ()
    _given: ClassVar[tuple[str, ...]] = ()
    _size: ClassVar[int] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_row(*self._rows)

    @cached_property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        return tuple(getattr(self, name) for name in self._keys)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """See :meth:`Factor.core_arguments`."""
        given = {one: getattr(self, one) for one in self._given}
        if "information" in given:
            matrix = np.asarray(given["information"])
            given["information"] = as_information(name, matrix, self._size or sizes[0])
        return tuple(given.values())


def as_information(name: str, information: Array, size: int) -> Array:
    """Return an information matrix; a number is multiplied by the identity."""
    if information.ndim == 0 or information.shape == (1,):
        return float(information.reshape(())) * np.eye(size)
    if information.shape != (size, size):
        raise InputError(
            f"{name}: information: expected shape ({size}, {size}), {size} numbers of its diagonal "
            f"or one number, found shape {information.shape}"
        )
    return information


@dataclass(frozen=True, eq=False, repr=False)
class WeightedFactor(MeasuredFactor):
    """Base class of factors with an information matrix, which is given in one of three ways."""

    # in place of the information, of all coordinates of the error or of each; None once it is known
    sigma: float | None = field(default=None, kw_only=True)
    sigmas: ArrayLike | None = field(default=None, kw_only=True)

    if TYPE_CHECKING:

        @property
        def information(self) -> ArrayLike | None:
            """Number, or matrix."""

    def __new__(cls, *_: Any, **given: Any) -> Self:
        """Refuse unknown keywords, among them words of other tools for the noise."""
        words = dict.fromkeys(("covariance", "noise", "noise_model"), "information or sigmas")
        check_keywords(cls.__name__, given, {one: one for one in cls.__dataclass_fields__} | words)
        return super().__new__(cls)

    def __post_init__(self) -> None:
        super().__post_init__()
        ways = {name: getattr(self, name) for name in ("information", "sigma", "sigmas")}
        given = [name for name, value in ways.items() if value is not None]
        if len(given) != 1:
            raise InputError(
                f"{self.name}: expected one of information, sigma and sigmas, "
                f"found {' and '.join(given) or 'none'}"
            )
        way, array = given[0], as_array(f"{self.name}: {given[0]}", ways[given[0]])
        if way != "information":
            if array.ndim != (way == "sigmas") or not (array > 0).all():
                kind, found = "a number" if way == "sigma" else "numbers", brief(array.tolist())
                raise InputError(f"{self.name}: {way}: expected {kind} above 0, found {found}")
            array = np.asarray(1 / array**2)
        if way == "sigmas" or (array.ndim == 1 and len(array) > 1):
            array = np.diag(array)
        for name in ways:
            self._set(name, freeze(np.array(array)) if name == "information" else None)


@dataclass(frozen=True, eq=False, repr=False)
class PriorFactor(WeightedFactor):
    """Prior on one variable X: e = Log(value^-1 X).

    On a Euclidean variable e = X - value: a prior on a point or on the parameters of a camera.

    Attributes:
        key: the variable.
        value: prior value, in the manifold's representation.
        information: symmetric positive definite, in the tangent coordinates of the variable (listed
            by :class:`bundle.FactorGraph`), or its diagonal, or a number that multiplies the
            identity. All factors with an information take ``sigma`` (a number) or ``sigmas`` (one
            per coordinate) in its place.

    Raises:
        InputError: an argument is not numeric. :meth:`bundle.FactorGraph.add_factor` refuses values
            that do not fit the variable.
    """

    key: Key
    value: ArrayLike
    information: ArrayLike | None = None

    kind = "prior"
    _rows, _given = ("value",), ("value", "information")


@dataclass(frozen=True, eq=False, repr=False)
class ScalarPriorFactor(MeasuredFactor):
    """Prior on one number x of a Euclidean variable, such as a camera parameter.

    The residual is (x - value) / sigma, or (log x - log value) / sigma if ``relative``.

    Attributes:
        key: the variable.
        index: index of the number in the variable.
        value: measured value.
        sigma: standard deviation; if ``relative``, a fraction of the value: 0.02 is two percent.
        relative: True if the logarithm is measured, as for a focal length. Half and twice the value
            then have the same residual, and the number keeps its sign.

    Raises:
        InputError: an argument is not numeric, sigma is not above 0, or a relative value is 0.
            :meth:`bundle.FactorGraph.add_factor` refuses an index that the variable does not have.
    """

    key: Key
    index: int
    value: float
    sigma: float
    relative: bool = field(default=False, kw_only=True)

    kind = "scalar_prior"
    _given = ("index", "value", "sigma", "relative")

    def __post_init__(self) -> None:
        super().__post_init__()
        index = number(f"{self.name}: index", self.index, whole=True, minimum=0)
        self._set("index", index)
        self._set("value", number(f"{self.name}: value", self.value))
        self._set("sigma", number(f"{self.name}: sigma", self.sigma, above=0))
        self._set("relative", as_flag(f"{self.name}: relative", self.relative))
        if self.relative and self.value == 0:
            raise InputError(f"{self.name}: value: expected a nonzero number if relative, found 0")


@dataclass(frozen=True, eq=False, repr=False)
class _RelativeFactor(WeightedFactor):
    """Base class of measurements between two variables."""

    a: Key
    b: Key
    measurement: ArrayLike
    information: ArrayLike | None = None

    _keys, _rows, _given = ("a", "b"), ("measurement",), ("measurement", "information")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct(f"{self.name}: expected two different variables", (self.a, self.b))


@dataclass(frozen=True, eq=False, repr=False)
class BetweenFactor(_RelativeFactor):
    """Relative measurement of two variables on one manifold: e = Log(Z^-1 A^-1 B).

    This is the error of a pose graph's edge, with the full logarithm of SE(2) or SE(3). On
    Euclidean variables e = b - a - z; differences of angles are wrapped to a half turn.

    Attributes:
        a: key of the variable A, in whose frame B was measured.
        b: key of the variable B.
        measurement: measured Z = A^-1 B, in the manifold's representation.
        information: symmetric positive definite, in the tangent coordinates of the manifold (listed
            by :class:`bundle.FactorGraph`; se3 has the rotation first), or its diagonal, or a
            number.

    Raises:
        InputError: an argument is not numeric, or both keys are the same.
    """

    kind = "between"


@dataclass(frozen=True, eq=False, repr=False)
class RelativePoseFactor(_RelativeFactor):
    """Measured relative pose of two images A and B: e = Log(Z^-1 B A^-1).

    The variables are cam_from_world. B A^-1 is therefore cam_b_from_cam_a, which is invariant under
    motions of the world. (:class:`BetweenFactor` would compare A^-1 B, which is meaningful for
    world_from_camera.)

    Attributes:
        a: key of the pose A, on se3.
        b: key of the pose B, on se3.
        measurement: measured Z, cam_b_from_cam_a: qx qy qz qw tx ty tz.
        information: (6, 6) symmetric positive definite, rotation first, or its diagonal (6,), or a
            number.

    Raises:
        InputError: an argument is not numeric, or both keys are the same.
    """

    kind = "relative_pose"
    _size = 6


@dataclass(frozen=True, eq=False, repr=False)
class PositionFactor(WeightedFactor):
    """Measured position of an antenna on a camera: e = R^T (lever_arm - t) - position.

    Attributes:
        key: pose cam_from_world (R, t), on se3.
        position: (3,) position of the antenna in the world frame.
        information: (3, 3) symmetric positive definite, along the world axes, or its diagonal (3,),
            or a number.
        lever_arm: (3,) position of the antenna in the camera frame; zeros: the projection centre.
        offset: another pose, whose translation times `axes` is added to e: an unknown offset that
            positions have in common; None: they have none.
        axes: (3,) 1 for each coordinate with an offset, else 0.

    Raises:
        InputError: an argument is not numeric.
    """

    key: Key
    position: ArrayLike
    information: ArrayLike | None = None
    lever_arm: ArrayLike = field(default=(0.0, 0.0, 0.0), kw_only=True)
    offset: Key | None = field(default=None, kw_only=True)
    axes: ArrayLike = field(default=(1.0, 1.0, 1.0), kw_only=True)

    kind = "position"
    _rows = ("position", "lever_arm", "axes")
    _given = ("position", "lever_arm", "information", "axes")
    _size = 3

    @cached_property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        return (self.key,) if self.offset is None else (self.key, self.offset)


@dataclass(frozen=True, eq=False, repr=False)
class ReprojectionFactor(WeightedFactor):
    """Observation of a point in an image: e = projection(R X + t) - observation, in pixels.

    A point behind its camera keeps the error of this formula.

    Attributes:
        pose: key of the pose cam_from_world (R, t), on se3.
        camera: key of the camera's parameters in COLMAP's order, Euclidean.
        point: key of the point X, Euclidean (3,).
        observation: (2,) pixels.
        model: COLMAP's name of the camera model.
        information: (2, 2) symmetric positive definite, or its diagonal (2,), or a number; by
            default 1, a sigma of one pixel.

    Raises:
        InputError: an argument is not numeric.
    """

    pose: Key
    camera: Key
    point: Key
    observation: ArrayLike
    model: str
    information: ArrayLike | None = None

    kind = "reprojection"
    _keys, _rows = ("pose", "camera", "point"), ("observation",)
    _given, _size = ("model", "observation", "information"), 2

    def __post_init__(self) -> None:
        if self.information is None and self.sigma is None and self.sigmas is None:
            self._set("information", 1.0)
        super().__post_init__()
        self._set("model", choice(f"{self.name}: model", self.model, camera_models()))


FactorFunction = Callable[[list[Array]], tuple[Any, Sequence[Any]]]


@dataclass(frozen=True, eq=False, repr=False)
class FunctionFactor(Factor):
    """User-defined residual: ``function(values) -> (residual, jacobians)``.

    ``values`` is a list of arrays, one per key, in the manifold's representation: (n,) for
    "euclidean", (angle,) for "so2", (qx, qy, qz, qw) for "so3", (x, y, angle) for "se2", (qx, qy,
    qz, qw, tx, ty, tz) for "se3"; quaternions have norm 1. The function returns the whitened
    residual (m,) and a list of Jacobians, one per key. Jacobian k has shape (m, d) with d the
    tangent size of variable k. It is the derivative of the residual with respect to delta at delta
    = 0, where X moves to X Exp(delta):

    - "euclidean": delta (n) is added; this is the usual Jacobian;
    - "so2": delta (1) is added to the angle;
    - "so3": delta (3) is a rotation vector in the frame of X: R becomes R Exp(delta);
    - "se2": delta = (x, y, angle) in the frame of X: the translation t becomes t + R (x, y) to
      first order, and the angle grows by that of delta;
    - "se3": delta = (rotation (3), translation (3)) in the frame of X: R becomes R Exp(rotation),
      t becomes t + R translation to first order.

    Check Jacobians with :meth:`bundle.FactorGraph.check_gradients`. The function is called from the
    solving thread with the GIL held; a graph with such a factor is evaluated on one thread. An
    exception of the function ends the solve and is passed on.

    Attributes:
        keys: the variables.
        function: function of their values, as above. m must not change between calls. A residual
            that is not finite rejects the step.
        num_dependent: how many of the m numbers follow from the others, as three of the distances
            of points from their best plane do; degrees of freedom do not count them.

    Raises:
        InputError: keys is not a list, or the function is not callable. A solve raises it if the
            function returns other shapes; the message names factor and variable.
    """

    keys: tuple[Key, ...]
    function: FactorFunction
    num_dependent: int = 0

    kind = "function"

    seconds_a_call = np.inf
    """Duration of the fastest call within solves."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "keys", as_keys("FunctionFactor: keys", self.keys))
        super().__post_init__()
        if not self.keys:
            raise InputError("FunctionFactor: keys: expected at least one variable, found 0")
        if not callable(self.function):
            raise InputError(f"{self.name}: expected a function, found {brief(self.function)}")
        given = number(f"{self.name}: num_dependent", self.num_dependent, minimum=0, whole=True)
        self._set("num_dependent", given)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """See :meth:`Factor.core_arguments`."""
        labels = [f"{variable_name(key)}: Jacobian" for key in self.keys]
        return UserFunction(self._timed, sizes, name, labels, is_vector=True), self.num_dependent

    def _timed(self, values: list[Array]) -> Any:
        began = perf_counter()
        answer = self.function(values)
        self._set("seconds_a_call", min(self.seconds_a_call, perf_counter() - began))
        return answer
