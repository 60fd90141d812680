"""Keys of a problem's variables: ``("image", id)``, ``("camera", id)`` and the like.

A sensor of a rig has two ids, ``("sensor", (rig_id, camera_id))``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from bundle.errors import InputError, brief
from bundle.model.cameras import camera_models
from bundle.model.estimates import kinds, variable_of
from bundle.model.problem import Problem


class ProblemKeys:
    """Table from keys to variables of a problem.

    Args:
        problem: problem with the variables.
        kinds: allowed first elements of a key.
        what: role of a key for the caller, in messages.
    """

    def __init__(self, problem: Problem, kinds: tuple[str, ...], what: str) -> None:
        self._problem = problem
        self._kinds = kinds
        self._what = what
        self._indices: dict[str, dict[Any, int]] = {}

    def find(self, argument: str, key: Any) -> tuple[str, int]:
        """Return the kind of a key and its index in the problem's arrays."""
        if (
            not isinstance(key, tuple)
            or len(key) != 2
            or key[0] not in self._kinds
            or not _is_id(key[0], key[1])
        ):
            *others, last = (f"({kind!r}, {_ID.get(kind, 'id')})" for kind in self._kinds)
            expected = f"{', '.join(others)} or {last}" if others else last
            raise InputError(
                f"{argument}: expected {expected} for a {self._what}, found {brief(key)}"
            )
        kind, number = key
        if kind not in self._indices:
            self._indices[kind] = {known: index for index, known in enumerate(self._ids(kind))}
        index = self._indices[kind].get(number)
        if index is None:
            raise InputError(f"{argument}: there is no {kind} {number} in the problem")
        return kind, index

    def _ids(self, kind: str) -> list[Any]:
        problem = self._problem
        if kind != "sensor":
            ids: list[Any] = getattr(
                problem, f"{variable_of(kind).rows.removesuffix('s')}_ids"
            ).tolist()
            return ids
        rigs, cameras = problem.sensor_rig_ids.tolist(), problem.sensor_camera_ids.tolist()
        return list(zip(rigs, cameras, strict=True))


_ID = {"sensor": "(rig id, camera id)"}


def _is_id(kind: str, found: Any) -> bool:
    if kind in _ID:
        return isinstance(found, tuple) and len(found) == 2 and all(map(_is_whole, found))
    return _is_whole(found)


def _is_whole(found: Any) -> bool:
    return isinstance(found, int | np.integer) and not isinstance(found, bool)


def parameter_names(argument: str, problem: Problem, camera: int) -> tuple[str, ...]:
    """Return the names of a camera's parameters, by its index."""
    model = problem.camera_models[camera]
    names = camera_models().get(model)
    if names is None:
        raise InputError(
            f"{argument}: camera {problem.camera_ids[camera]}: model {model} is not supported"
        )
    return names


def touched_ids(factors: Iterable[Any]) -> dict[str, list[Any]]:
    """Return the ids of the variables of factors by kind; keys of unknown kind are left out."""
    touched: dict[str, list[Any]] = {kind: [] for kind in kinds()}
    keys: list[Any] = [key for factor in factors for key in factor.keys]
    for key in keys:
        if isinstance(key, tuple) and len(key) == 2 and key[0] in touched:  # others: error later
            touched[key[0]].append(key[1])
    return touched
