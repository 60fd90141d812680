"""Refinement as a function of torch, whose backward pass is one adjoint solve.

PyTorch is the extra ``torch``, imported by the first call.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

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
    """Refine a problem, as a function of its pixels, weights and constant camera parameters.

    The derivatives are exact (:func:`bundle.adjoint`), of first order, and on the CPU in float64.
    The values are in the gauge of the problem's start, so that only functions that do not depend
    on it have a derivative; for others, the part along free motions of the world is removed.

    Args:
        pixels: (num_observations, 2) measured pixels; None: those of the problem.
        weights: (num_observations,) 1 / sigma^2 [1/px^2], above 0; None: those of the problem.
        cameras: (num_cameras, k) camera parameters: start of the refined ones, and values of the
            others, by which there are derivatives; None: those of the problem.
        problem: start of the refinement.
        **settings: options by name, ``factors``, ``priors``, ``bounds`` and ``constraints``, as in
            :func:`bundle.solve`.

    Returns:
        Tensors ``points`` (num_points, 3), ``poses`` (num_images, 7), the cam_from_world, and
        ``cameras`` (num_cameras, k).

    Raises:
        InputError: PyTorch is not installed, a tensor has another type or shape, or as
            :func:`bundle.solve`.

    Warns:
        NotConvergedWarning: in the backward pass: there is no minimum, and derivatives are NaN.
        GaugeWarning: in the backward pass: the function depends on the gauge.

    Example:
        >>> sigmas = torch.ones(problem.num_images, dtype=torch.float64, requires_grad=True)
        >>> weights = sigmas[torch.as_tensor(problem.observation_image)] ** -2
        >>> refined = bundle.torch.refine(weights=weights, problem=problem)
        >>> loss(refined.points).backward()
    """
    torch, function = _torch()
    layer = Layer(problem, settings)
    tensors = []
    for name, value, default in zip(DATA, (pixels, weights, cameras), layer.data, strict=True):
        tensors.append(torch.as_tensor(default.copy()) if value is None else value)
        if not isinstance(tensors[-1], torch.Tensor) or tensors[-1].dtype != torch.float64:
            found = getattr(value, "dtype", type(value).__name__)
            raise InputError(f"{name}: expected a tensor of torch.float64, found {found}")
    return Refined(*function.apply(layer, *tensors))


@cache
def _torch() -> tuple[Any, Any]:
    """Return the module and the function of autograd."""
    require_package("torch", "bundle-adjust[torch]", "bundle.torch")
    import torch
    from torch.autograd.function import once_differentiable

    class Refine(torch.autograd.Function):  # type: ignore[misc]
        @staticmethod
        def forward(ctx: Any, layer: Layer, *tensors: Any) -> tuple[Any, ...]:
            ctx.minimum = layer.minimum(*(one.detach().cpu().numpy() for one in tensors))
            device = tensors[0].device
            return tuple(torch.from_numpy(one).to(device) for one in values_of(ctx.minimum))

        @staticmethod
        @once_differentiable  # type: ignore[untyped-decorator]
        def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
            found = pulled_back(ctx.minimum, *(one.detach().cpu().numpy() for one in grads))
            return (None, *(torch.from_numpy(one.copy()).to(grads[0].device) for one in found))

    return torch, Refine
