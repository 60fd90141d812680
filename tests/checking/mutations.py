"""Wrong Jacobians: each a mistake that somebody has made, in any camera model."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

import bundle
from bundle.model.cameras import param_kinds
from tests.checking.reprojection import Blocks, Parts, jacobians, parts, skew

ROTATION, TRANSLATION, PARAMS, POINT = range(4)


class At(NamedTuple):
    """Where Jacobians are spoilt, and what they are made of."""

    model: str
    blocks: Blocks
    parts: Parts


class Mutation(NamedTuple):
    """A change that spoils the Jacobians, and the kind that the report should name."""

    spoil: Callable
    kinds: set[str]
    words: str


def distortion(model) -> list[int]:
    return [j for j, kind in enumerate(param_kinds(model)) if kind == "extra"]


def sign(_, j):
    j[TRANSLATION][:, 1] *= -1


def factor_two(_, j):
    j[PARAMS][:, 0] *= 2


def dropped_chain_rule_term(at, j):
    """The division by depth is differentiated as if depth were constant."""
    a = at.parts.d_camera_point.copy()
    a[:, 2] = 0
    j[POINT][:] = a @ at.parts.rotation


def swapped_columns(_, j):
    j[TRANSLATION][:] = j[TRANSLATION][:, [0, 2, 1]]


def transposed_block(_, j):
    j[POINT][:] = j[POINT].T.reshape(j[POINT].shape)


def wrong_frame(at, j):
    """By the point in the camera, not in the world."""
    j[POINT][:] = at.parts.d_camera_point


def degrees(_, j):
    j[ROTATION] *= 180 / np.pi


def right_perturbation(at, j):
    """By d of Exp(w) Exp(d) X."""
    j[ROTATION][:] = -at.parts.d_camera_point @ at.parts.rotation @ skew(at.blocks.point)


def missing_left_jacobian(at, j):
    """By d of Exp(d) Exp(w) X."""
    j[ROTATION][:] = -at.parts.d_camera_point @ skew(at.parts.rotated)


def missing_distortion_term(at, j):
    """One coefficient is forgotten in the derivative by the camera point."""
    params = at.blocks.params.copy()
    params[distortion(at.model)[0]] = 0
    a = parts(at.model, at.blocks._replace(params=params)).d_camera_point
    j[TRANSLATION][:] = a
    j[POINT][:] = a @ at.parts.rotation


def off_by_one(_, j):
    j[PARAMS][:, :-1] = j[PARAMS][:, 1:].copy()
    j[PARAMS][:, -1] = 0


def float_precision(_, j):
    for b, block in enumerate(j):
        j[b] = block.astype(np.float32).astype(np.float64)


def focal_left_out(at, j):
    j[PARAMS][:, -1] /= at.blocks.params[0]


MUTATIONS = {
    "sign": Mutation(sign, {"sign"}, "sign is flipped"),
    "factor 2": Mutation(factor_two, {"factor"}, "2.000 times too large"),
    "dropped chain-rule term": Mutation(
        dropped_chain_rule_term, {"missing_term"}, "term of the chain rule"
    ),
    "swapped columns": Mutation(swapped_columns, {"swapped"}, "swapped"),
    "transposed block": Mutation(transposed_block, {"transposed"}, "transposed"),
    "wrong frame": Mutation(wrong_frame, {"frame"}, "wrong frame"),
    "degrees": Mutation(degrees, {"degrees"}, "degrees for radians"),
    "left for right perturbation": Mutation(right_perturbation, {"perturbation"}, "perturb"),
    "missing left Jacobian": Mutation(missing_left_jacobian, {"perturbation"}, "J_l is missing"),
    "missing distortion term": Mutation(missing_distortion_term, {"missing_term"}, "as if"),
    "off by one parameter": Mutation(off_by_one, {"shifted"}, "shifted by one parameter"),
    "float precision": Mutation(float_precision, {"float_precision"}, "float precision"),
    "focal length left out": Mutation(focal_left_out, {"scaled_by_parameter"}, "divided by"),
    "stale cache": Mutation(sign, {"stale"}, "stale cache"),
    "cache never renewed": Mutation(sign, {"stale"}, "first point"),
}


def applies(name, model) -> bool:
    return name != "missing distortion term" or bool(distortion(model))


def wrong(name, model):
    """The residual with Jacobians that have the mistake of this name."""
    if name == "stale cache":
        return lagging(model)
    if name == "cache never renewed":
        return frozen(model)

    def function(blocks):
        blocks = Blocks(*blocks)
        p = parts(model, blocks)
        j = [block.copy() for block in jacobians(p)]
        MUTATIONS[name].spoil(At(model, blocks, p), j)
        return p.residual, j

    return function


def lagging(model):
    """The Jacobians are those of the call before."""
    cache = []

    def function(blocks):
        p = parts(model, blocks)
        cache.append(jacobians(p))
        return p.residual, cache[max(len(cache) - 2, 0)]

    return function


def frozen(model):
    """The Jacobians are those of the first call."""
    cache = []

    def function(blocks):
        p = parts(model, blocks)
        cache.append(jacobians(p))
        return p.residual, cache[0]

    return function


MODELS = sorted(bundle.camera_models())
