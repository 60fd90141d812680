"""Values of options that are lists: names of parameters, ids, pairs of ids, pairs of sigmas."""

from __future__ import annotations

import operator
from typing import Any

from bundle.errors import InputError, brief
from bundle.interface.option_fields import choice

SENSORS = "sensor_from_rig"
"""Additional name in ``refine``, for ``refine_sensor_from_rig``."""
REFINABLE = ("poses", "points", "focal", "principal_point", "extra")


def refined_names(value: Any) -> tuple[str, ...]:
    """Return names of parameters in the order of the list; text has commas between them."""
    try:
        given = value.split(",") if isinstance(value, str) else list(value)
    except TypeError:
        raise InputError(
            f"refine: expected names out of {', '.join((*REFINABLE, SENSORS))}, "
            f"found {brief(value)}"
        ) from None
    words = (name.strip() if isinstance(name, str) else name for name in given)
    named = (word for word in words if not isinstance(word, str) or word)
    every = (*REFINABLE, SENSORS)
    chosen = {choice("refine", word, every) for word in named}
    return tuple(name for name in every if name in chosen)


def two_sigmas(value: Any) -> tuple[float, ...]:
    """Return the sigmas of the angular and the other part of a twist; () without any."""
    if isinstance(value, tuple | list) and not value:
        return ()
    expected = f"twist_sigma: expected two numbers above 0, found {brief(value)}"
    try:
        parts = value.split(",") if isinstance(value, str) else list(value)
        w, v = (float(part) for part in parts)
    except (TypeError, ValueError):
        raise InputError(expected) from None
    if not (0 < w < float("inf") and 0 < v < float("inf")):
        raise InputError(expected)
    return w, v


def sensor_pairs(value: Any) -> tuple[tuple[int, int], ...]:
    """Return pairs (rig id, camera id)."""
    expected = "fixed_sensors: expected pairs (rig id, camera id), found "
    try:
        if isinstance(value, str | bytes | dict):
            raise TypeError
        given = [tuple(entry) for entry in value]
        if any(len(pair) != 2 or any(isinstance(x, bool) for x in pair) for pair in given):
            raise TypeError
        pairs = {(operator.index(rig), operator.index(camera)) for rig, camera in given}
    except TypeError:
        raise InputError(expected + brief(value)) from None
    for found in (entry for pair in pairs for entry in pair if not -(2**63) <= entry < 2**63):
        raise InputError(f"fixed_sensors: expected ids below 2^63, found {brief(found)}")
    return tuple(sorted(pairs))


def whole_ids(name: str, value: Any) -> tuple[int, ...]:
    """Return different ids, ascending."""
    try:
        if isinstance(value, str | bytes):
            raise TypeError  # the characters of a string are not ids
        given = list(value)
        if any(isinstance(entry, bool) for entry in given):
            raise TypeError
        ids = {operator.index(entry) for entry in given}
    except TypeError:
        raise InputError(f"{name}: expected whole numbers, found {brief(value)}") from None
    for found in (entry for entry in ids if not -(2**63) <= entry < 2**63):
        raise InputError(f"{name}: expected ids below 2^63, found {brief(found)}")
    return tuple(sorted(ids))
