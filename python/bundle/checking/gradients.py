"""Check of the Jacobians of a user-defined residual."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.arguments import as_array, as_flag
from bundle.checking.function import ResidualFunction, UserFunction
from bundle.checking.gradient_report import GradientReport
from bundle.checking.jacobian_deviation import Array
from bundle.checking.manifolds import ManifoldLike
from bundle.checking.residual_blocks import Layout, Name, sample
from bundle.checking.sample_check import check_samples
from bundle.checking.sample_points import SamplePoint
from bundle.errors import InputError, brief
from bundle.interface.check_options import TOLERANCE
from bundle.interface.option_fields import number


def check_function_at(
    function: ResidualFunction,
    blocks: Sequence[ArrayLike],
    manifolds: Sequence[ManifoldLike] | None = None,
    *,
    names: Sequence[Name] | None = None,
    num_samples: int = 10,
    radius: float = 0.1,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    ambient: bool = True,
    details: bool = False,
) -> GradientReport:
    """Check the Jacobians of a function; see :func:`bundle.check_gradients`."""
    if not callable(function):
        raise InputError(f"function: expected a function, found {brief(function)}")
    single = isinstance(blocks, np.ndarray) and blocks.ndim == 0
    if isinstance(blocks, str | bytes | Mapping) or not isinstance(blocks, Iterable) or single:
        raise InputError(f"blocks: expected a list of arrays, found {brief(blocks)}")
    start: list[Array] = [as_array("blocks", block).reshape(-1).copy() for block in blocks]
    if not start or not all(len(block) for block in start):
        raise InputError("blocks: expected at least one block, and no empty block")
    for b, block in enumerate(start):
        if not np.isfinite(block).all():
            raise InputError(f"blocks: expected finite numbers, found nan or infinity in block {b}")
    num_samples = number("num_samples", num_samples, minimum=1, whole=True)
    radius = number("radius", radius, minimum=0)
    ambient = as_flag("ambient", ambient)
    seed = number("seed", seed, minimum=0, maximum=math.inf, whole=True)
    tolerance = number("tolerance", tolerance, above=0)
    layout = Layout.make(start, manifolds, names)
    user = UserFunction(function, start)
    rng = np.random.default_rng(seed)
    samples = [SamplePoint(user, start)]
    for _ in range(num_samples - 1):
        around = [
            sample(manifold, block, radius, rng)
            for manifold, block in zip(layout.manifolds, start, strict=True)
        ]
        samples.append(SamplePoint(user, around))
    return check_samples(
        samples, layout, tolerance=tolerance, ambient=ambient, details=as_flag("details", details)
    )
