"""Refinement as a function of jax, whose backward pass is one adjoint solve.

JAX is the extra ``jax``, imported by the first call. Both passes are pure callbacks, functions of
the data: the backward pass takes the minimum of the forward pass if that was the last one, and
else solves again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.analysis.uncertainty.refine_layer import DATA, Layer, Refined, pulled_back, values_of
from bundle.base.optional_packages import require_package
from bundle.errors import InputError

if TYPE_CHECKING:
    from bundle.model.problem import Problem

__all__ = ["refine"]


def refine(
    pixels: Any = None,
    weights: Any = None,
    cameras: Any = None,
    *,
    problem: Problem,
    **settings: Any,
) -> Refined:
    """Refine a problem as ``bundle.torch.refine`` does, as a function of jax arrays.

    It works under ``jax.jit`` and ``jax.grad``, and needs ``jax_enable_x64``.

    Args:
        pixels: (num_observations, 2) measured pixels; None: those of the problem.
        weights: (num_observations,) 1 / sigma^2 [1/px^2], above 0; None: those of the problem.
        cameras: (num_cameras, k) camera parameters; None: those of the problem.
        problem: start of the refinement.
        **settings: options by name, ``factors``, ``priors``, ``bounds`` and ``constraints``, as in
            :func:`bundle.solve`.

    Raises:
        InputError: JAX is not installed or runs without 64-bit floats, or an array has another
            shape. An error of :func:`bundle.solve` is wrapped in an error of jax.

    Example:
        >>> jax.grad(lambda w: loss(bundle.jax.refine(weights=w, problem=problem).points))(weights)
    """
    require_package("jax", "bundle-adjust[jax]", "bundle.jax")
    import jax

    if not jax.config.jax_enable_x64:
        raise InputError("bundle.jax: expected jax_enable_x64, found doubles off")
    layer = Layer(problem, settings)
    data = []
    for name, value, default in zip(DATA, (pixels, weights, cameras), layer.data, strict=True):
        data.append(jax.numpy.asarray(default if value is None else value, dtype=float))
        if data[-1].shape != default.shape:
            raise InputError(f"{name}: expected shape {default.shape}, found {data[-1].shape}")

    def types(arrays: Any) -> tuple[Any, ...]:
        return tuple(jax.ShapeDtypeStruct(array.shape, np.float64) for array in arrays)

    def forward(*given: Any) -> tuple[Any, ...]:
        return tuple(values_of(layer.minimum(*map(np.asarray, given))))

    def backward(given: Any, grads: Any) -> tuple[Any, ...]:
        return pulled_back(layer.minimum(*map(np.asarray, given)), *map(np.asarray, grads))

    values = types((problem.points, problem.cam_from_world, problem.camera_params))

    @jax.custom_vjp  # type: ignore[untyped-decorator]
    def solved(*given: Any) -> Any:
        return jax.pure_callback(forward, values, *given)

    def back(given: Any, grads: Any) -> Any:
        return jax.pure_callback(backward, types(layer.data), given, grads)

    solved.defvjp(lambda *given: (solved(*given), given), back)
    return Refined(*solved(*data))
