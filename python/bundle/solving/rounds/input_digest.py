"""Fingerprints of runs: options, and digests of the problem, factors, bounds and rules.

The digest of a problem covers its arrays and names, not its source. Points and observations are
rows: each row is hashed, and the hashes are added modulo 2^64. Processes with slices can therefore
add their sums, and their checkpoint equals the checkpoint of the entire problem. The row of a point
includes its index, because a checkpoint stores coordinates by index. The order of observations does
not change a solve. Rounds store masks of observations and therefore also use ``digest_of_order``.

The digest of an object covers the name of its class and its fields. It does not cover the module of
the class, which may be moved. Functions and objects of other packages are hashed by their pickles.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import pickle
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, first_line
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.solving.prepare import Prepared
    from bundle.solving.rounds.plan import RunPlan

NOT_DECISIVE = ("num_threads", "check_solution")

_ROWS = ("points", "point_ids", "observation_sigma")
_BLOCK = 1 << 18  # number of rows that are hashed at a time

_Sums = NDArray[np.uint64]


def fingerprint_of_options(options: SolveOptions) -> dict[str, Any]:
    """Return the options that affect the result, as JSON values."""
    kept = {name: value for name, value in options.asdict().items() if name not in NOT_DECISIVE}
    plain: dict[str, Any] = json.loads(json.dumps(kept))
    return plain


def plain_fingerprint(input_digest: str, options: SolveOptions, plan: RunPlan) -> dict[str, Any]:
    """Return the fingerprint of a run without parts, factors, bounds and rules."""
    return {
        "input": input_digest,
        **fingerprint_of_options(options),
        **plan.decisive(),
        "only_images": None,
        "factors and bounds": digest_of_fields(((), None)),
    }


def fingerprint_of_run(prepared: Prepared, plan: RunPlan) -> dict[str, Any]:
    """Return the fingerprint that a resumed run must have.

    The places of the rules, such as lines of a file, are not part of it.
    """
    request, placed, part, rules = (
        *(prepared.request, prepared.placed, prepared.part, prepared.applied),
    )
    rules = None if rules is None else dataclasses.replace(rules, rules=())
    more = [known for known in (placed.targets, rules) if known is not None]
    given = request.problem
    return plain_fingerprint(digest(given), request.options, plan) | {
        "only_images": None if part is None else part.named_ids,
        **({} if part is None or not part.is_marginal else {"rest": "marginal"}),
        **({"order": digest_of_order(given)} if plan.filters else {}),
        "factors and bounds": digest_of_fields((placed.factors, request.bounds, *more)),
    }


def digest(problem: Problem) -> str:
    """Return the digest of a problem."""
    return digest_of_parts(problem, sums_of_rows(problem, np.arange(problem.num_points)))


def digest_of_order(problem: Problem) -> str:
    """Return the digest of the order of the observations."""
    digest = hashlib.sha256()
    for name in ("observation_image", "observation_point", "observation_xy"):
        digest.update(np.ascontiguousarray(getattr(problem, name)).data)
    return digest.hexdigest()


def digest_of_parts(cameras: Problem, sums: _Sums) -> str:
    """Return the digest of a problem from its images and cameras, and the sums of all parts."""
    digest = hashlib.sha256(sums.tobytes())
    for field in dataclasses.fields(cameras):
        name = field.name
        if name == "source" or name in _ROWS or name.startswith("observation_"):
            continue
        value = getattr(cameras, name)
        if dataclasses.is_dataclass(value):
            digest.update(f"{name} {digest_of_fields(value)}".encode())
        elif isinstance(value, np.ndarray):
            digest.update(f"{name} {value.dtype} {value.shape}".encode())
            digest.update(np.ascontiguousarray(value).data)
        else:
            digest.update(f"{name} {value!r}".encode())
    return digest.hexdigest()


def digest_of_fields(value: Any) -> str:
    """Return the digest of an object by its fields."""
    try:
        return _hash(value).hexdigest()
    except Exception as error:  # objects of users may raise anything
        raise InputError(
            "checkpoint: expected factors that can be pickled, so that a resumed run can compare "
            f"them, found a factor that cannot ({first_line(error)})"
        ) from None


def _hash(value: Any) -> hashlib._Hash:
    """Hash the class of a value and the digests of its parts, which have a fixed length."""
    kind = type(value)
    is_own = kind.__module__.startswith("bundle.")
    if is_own and dataclasses.is_dataclass(value):
        fields = ((field.name, getattr(value, field.name)) for field in dataclasses.fields(value))
        return _joined(kind.__name__, map(_hash, fields))
    if isinstance(value, tuple | list):
        return _joined("list" if isinstance(value, list) else "tuple", map(_hash, value))
    if isinstance(value, Mapping):
        return _joined("mapping", _sorted(value.items()))
    if isinstance(value, set | frozenset):
        return _joined("set", _sorted(value))
    if is_own:
        return _joined(kind.__name__, map(_hash, value.__reduce_ex__(5)[1:]))
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        return hashlib.sha256(f"{value.dtype.str} {value.shape} ".encode() + value.tobytes())
    if value is None or kind in (bool, int, float, str, bytes):
        return hashlib.sha256(f"{kind.__name__} {value!r}".encode())
    return hashlib.sha256(b"pickle " + pickle.dumps(value, protocol=5))


def _sorted(values: Iterable[Any]) -> list[hashlib._Hash]:
    return sorted(map(_hash, values), key=lambda one: one.digest())


def _joined(name: str, parts: Iterable[hashlib._Hash]) -> hashlib._Hash:
    return hashlib.sha256(f"{name} of ".encode() + b"".join(part.digest() for part in parts))


def sums_of_rows(part: Any, places: NDArray[np.int64]) -> _Sums:
    """Return sums over points, then over observations: count, hashes, and hashes mixed again.

    ``part``: a problem, or a part of a problem (``ranks.partition.ProblemPart``). ``places``:
    (num_points,) index in the problem of each point of the part.
    """
    ids, point = part.point_ids, part.observation_point
    sigma = () if part.observation_sigma is None else (part.observation_sigma,)
    xy, xyz = part.observation_xy, part.points
    points = _sums(len(ids), lambda rows: [places[rows], ids[rows], *xyz[rows].T])
    seen = _sums(
        len(point),
        lambda rows: [
            part.observation_image[rows],
            ids[point[rows]],
            part.observation_keypoint[rows],
            *xy[rows].T,
            *(values[rows] for values in sigma),
        ],
    )
    return np.stack([points, seen])


def _sums(count: int, columns: Any) -> _Sums:
    total = np.array([count, 0, 0], np.uint64)
    for first in range(0, count, _BLOCK):
        rows = slice(first, min(first + _BLOCK, count))
        hashes = np.zeros(rows.stop - first, np.uint64)
        for column in columns(rows):
            is_real = column.dtype == np.float64
            bits = np.ascontiguousarray(column).view(np.uint64) if is_real else column
            hashes = _mixed(hashes ^ bits.astype(np.uint64))
        total += np.array([0, hashes.sum(), _mixed(hashes).sum()], np.uint64)
    return total


def _mixed(words: _Sums) -> _Sums:
    """Mix words so that every bit depends on all input bits (the finalizer of SplitMix64)."""
    words = words + np.uint64(0x9E3779B97F4A7C15)
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))
