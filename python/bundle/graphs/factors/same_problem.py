"""Conversion of factor graphs that represent a pose graph or a bundle adjustment problem.

A graph of poses on se2 (or on se3) with a :class:`bundle.BetweenFactor` per edge has the residuals
of a :class:`bundle.PoseGraph` with the error "log". A graph of
:class:`bundle.ReprojectionFactor` has those of a :class:`bundle.Problem` with the cheirality
"algebraic". Both conversions keep every residual, so that solvers and analyses of the other inputs
apply to these graphs. A graph with any other factor, with bounds, or with coordinates that the
other input cannot hold constant, has no such form.

Ids of the other input: a key that is a whole number is its own id; ("image", 7) and the like of
``model/problem_keys.py`` has the id 7. If a graph has other keys, its variables are numbered in
their order, and names are the keys as text.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief
from bundle.graphs.factors.contents import GraphContents
from bundle.graphs.factors.factors import BetweenFactor, ReprojectionFactor, as_information
from bundle.graphs.factors.variables import Key, Variable
from bundle.interface.options import SolveOptions
from bundle.model.cameras import param_kinds
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem

OF_GRAPH = (
    *("refine", "fixed_image_ids", "fixed_point_ids", "fixed_camera_ids"),
    *("loss", "loss_scale", "gauge", "cheirality"),
)
"""Options of a problem that a factor graph decides."""


class AsPoseGraph(NamedTuple):
    """Pose graph with the poses and edges of a factor graph, in their order there."""

    graph: PoseGraph
    keys: tuple[Key, ...]


class AsProblem(NamedTuple):
    """Bundle adjustment problem of a factor graph."""

    problem: Problem  # poses, cameras and points in the order of their variables
    options: SolveOptions  # constant parameters, the loss and the cheirality of the graph
    images: tuple[Key, ...]  # keys of the poses
    cameras: tuple[Key, ...]  # keys of the cameras
    points: tuple[Key, ...]  # keys of the points


def pose_graph_of(graph: GraphContents) -> AsPoseGraph | None:
    """Return the pose graph that a factor graph represents; None if it is another problem."""
    factors, variables = graph.factors, list(graph.variables.values())
    manifolds = {variable.manifold for variable in variables}
    if manifolds not in ({"se2"}, {"se3"}) or not factors:
        return None
    if not all(isinstance(f, BetweenFactor) and f.loss == "trivial" for f in factors):
        return None
    if not all(_is_whole(variable) for variable in variables):
        return None
    place = {key: k for k, key in enumerate(graph.keys)}
    d = len(variables[0].coordinates)
    edges: Any = factors
    return AsPoseGraph(
        PoseGraph(
            poses=np.stack([variable.value for variable in variables]),
            edges=np.array([[place[f.a], place[f.b]] for f in edges], np.int32),
            measurements=np.stack([np.asarray(f.measurement) for f in edges]),
            information=np.stack(
                [as_information(f.name, np.asarray(f.information), d) for f in edges]
            ),
            ids=_ids(graph.keys, "pose"),
            fixed=np.array([_is_fixed(variable) for variable in variables]),
            names=tuple(brief(key) for key in graph.keys),
        ),
        graph.keys,
    )


def problem_of(graph: GraphContents) -> AsProblem | None:
    """Return the bundle adjustment problem of a factor graph; None if it is another problem."""
    if not graph.factors or not all(isinstance(f, ReprojectionFactor) for f in graph.factors):
        return None
    factors: Any = graph.factors
    variables = graph.variables
    roles = {
        part: {getattr(factor, part) for factor in factors} for part in ("pose", "camera", "point")
    }
    images, cameras, points = (
        tuple(key for key in graph.keys if key in roles[part])
        for part in ("pose", "camera", "point")
    )
    if len({*images, *cameras, *points}) < len(variables) or _are_shared(images, cameras, points):
        return None
    loss = {(factor.loss, factor.loss_scale) for factor in factors}
    model = {factor.camera: factor.model for factor in factors}
    camera_of = {factor.pose: factor.camera for factor in factors}
    sigma = _sigmas(factors)
    refined = _refined([variables[key] for key in cameras], [model[key] for key in cameras])
    if (
        len(loss) > 1
        or sigma is None
        or refined is None
        or any(model[factor.camera] != factor.model for factor in factors)
        or any(camera_of[factor.pose] != factor.camera for factor in factors)
        or any(len(variables[key].lower) for key in cameras)
        or not all(_is_whole(variables[key]) for key in (*images, *points))
    ):
        return None
    parts, fixed_cameras = refined
    camera_ids, image_ids, point_ids = (
        _ids(keys, kind)
        for keys, kind in ((cameras, "camera"), (images, "image"), (points, "point"))
    )

    def fixed(keys: Sequence[Key], ids: NDArray[np.int64]) -> tuple[int, ...]:
        held = [_is_fixed(variables[key]) for key in keys]
        return tuple(ids[np.array(held, bool)].tolist())

    widest = max(len(variables[key].value) for key in cameras)
    row = {keys: {key: k for k, key in enumerate(keys)} for keys in (images, cameras, points)}
    problem = Problem(
        cam_from_world=np.stack([variables[key].value for key in images]),
        image_ids=image_ids,
        image_names=tuple(str(key) for key in images),
        image_camera=np.array([row[cameras][camera_of[key]] for key in images], np.int32),
        camera_ids=camera_ids,
        camera_models=tuple(model[key] for key in cameras),
        camera_params=np.stack(
            [np.pad(v := variables[key].value, (0, widest - len(v))) for key in cameras]
        ),
        points=np.stack([variables[key].value for key in points]),
        point_ids=point_ids,
        observation_image=np.array([row[images][f.pose] for f in factors], np.int32),
        observation_point=np.array([row[points][f.point] for f in factors], np.int32),
        observation_xy=np.stack([np.asarray(f.observation) for f in factors]),
        observation_sigma=None if (sigma == 1).all() else sigma,
    )
    (name, scale) = loss.pop()
    options = SolveOptions(
        refine=("poses", "points", *parts),
        fixed_image_ids=fixed(images, image_ids),
        fixed_point_ids=fixed(points, point_ids),
        fixed_camera_ids=tuple(camera_ids[fixed_cameras].tolist()),
        loss=name,
        **({} if name == "trivial" else {"loss_scale": scale}),
        gauge="none",
        cheirality="algebraic",
    )
    return AsProblem(problem, options, images, cameras, points)


def options_of_graph(same: AsProblem, given: SolveOptions) -> SolveOptions:
    """Return given options with those that the graph decides: constants, loss, gauge."""
    defaults = SolveOptions()
    for name in OF_GRAPH:
        if getattr(given, name) != getattr(defaults, name):
            raise InputError(
                f"{name}: expected the default, because the factor graph decides it, found "
                f"{brief(getattr(given, name))}"
            )
    return given.replace(**{name: getattr(same.options, name) for name in OF_GRAPH})


def _is_fixed(variable: Variable) -> bool:
    return bool(variable.held) and all(variable.held)


def _is_whole(variable: Variable) -> bool:
    return not len(variable.lower) and (_is_fixed(variable) or not any(variable.held))


def _ids(keys: Sequence[Key], kind: str) -> NDArray[np.int64]:
    """Return an id per key; positions unless every key contains its id."""
    ids = [
        key[1] if isinstance(key, tuple) and len(key) == 2 and key[0] == kind else key
        for key in keys
    ]
    if all(_is_id(found) for found in ids) and len(set(ids)) == len(ids):
        return np.array(ids, np.int64)
    return np.arange(len(keys), dtype=np.int64)


def _is_id(found: Any) -> bool:
    is_number = isinstance(found, int | np.integer) and not isinstance(found, bool)
    return is_number and 0 <= found < 2**62


def _are_shared(*groups: Iterable[Key]) -> bool:
    return len(set().union(*groups)) < sum(map(len, map(tuple, groups)))


def _sigmas(factors: Sequence[ReprojectionFactor]) -> NDArray[np.float64] | None:
    """Return the sigma of each observation; None if its x and y have different ones."""
    information = np.stack([as_information(f.name, np.asarray(f.information), 2) for f in factors])
    weight = information[:, 0, 0]
    if (information != weight[:, None, None] * np.eye(2)).any():
        return None
    sigmas: NDArray[np.float64] = 1 / np.sqrt(weight)
    return sigmas


def _refined(
    cameras: Sequence[Variable], models: Sequence[str]
) -> tuple[tuple[str, ...], NDArray[np.bool_]] | None:
    """Return ``refine`` of all cameras and the mask of constant ones; None if no names fit."""
    free: dict[str, bool] = {}
    constant = np.zeros(len(cameras), bool)
    for k, (camera, model) in enumerate(zip(cameras, models, strict=True)):
        constant[k] = _is_fixed(camera)
        if constant[k]:
            continue
        held = camera.held or (False,) * len(camera.coordinates)
        for kind, flag in zip(param_kinds(model), held, strict=True):
            if free.setdefault(kind, not flag) == flag:
                return None
    names = ("focal", "principal_point", "extra")
    if set(free) - set(names):
        return None
    return tuple(name for name in names if free.get(name)), constant
