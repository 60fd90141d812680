"""Priors of rules as factors of a solve."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from bundle.solving.constraints.applied import KnownPrior

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor


def factor_of(prior: KnownPrior) -> Factor:
    """Return the factor whose whitened residual is the prior's pull in sigmas.

    For a rotation this residual is Log(R0^T R) / sigma. The factor is then a
    :class:`bundle.LinearPrior` on the pose, with zero information on the position.
    """
    from bundle.graphs.factors.factors import PositionFactor, PriorFactor, ScalarPriorFactor
    from bundle.graphs.factors.linear_prior import LinearPrior

    key = prior.subject
    if key[0] == "camera":
        (value,), (sigma,) = prior.value, prior.sigma
        return ScalarPriorFactor(key, prior.column, value, sigma, relative=prior.relative)
    if prior.parameter == "rotation":
        weight = 1 / math.radians(prior.sigma[0]) ** 2
        return LinearPrior(
            np.diag([weight] * 3 + [0.0] * 3),
            np.zeros(6),
            {key: prior.value},
            (key,),
            manifolds={key: "se3"},
        )
    information = np.diag(1 / np.array(prior.sigma) ** 2)
    if key[0] == "image":
        return PositionFactor(key, prior.value, information)
    return PriorFactor(key, prior.value, information)
