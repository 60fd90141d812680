"""Alarm of a solve whose elimination order costs much more than another one.

Three signs, each with the innocent explanation that it must exclude:

- flops in the order used, relative to those of the best order that a cheap look finds. The look
  orders the same matrix: neither its size nor its density explains the ratio. In chains and ladders
  a factorisation takes less time than the linearisation, and a ratio of 2 to 3 costs nothing.
- nnz(L) / nnz(Lambda). It is 1 to 3 in healthy graphs; 40 is often the ordering. Some matrices fill
  in under every order, so that the ratio is evidence only.
- growth since an earlier solve of the same matrix (``recall``). The size is the same, or
  the matrix is another one. Equal orders of equal matrices have equal factors: a record of the same
  order with other flops is of another matrix.

Other orders are compared if the user chose the order, or if the factorisations take seconds. Orders
that a solve chooses by itself are the best of several, or AMD, which is rarely far from the best.
The alarm counts flops, not seconds, and is therefore the same on every machine.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle._core import __version__
from bundle.base.paths import cache_folder, write_cached
from bundle.base.records import dataclass
from bundle.base.words import amount, number

LEAST_FLOPS = 1e7
"""Flops of all factorisations of a solve that another order must save: some milliseconds."""
LEAST_FLOPS_OF_ENTRY = 20.0
"""Flops per nonzero of Lambda that another order must save in a factorisation: to linearise the
measurements and to sum them takes about as long."""
LEAST_FLOPS_TO_RECORD = 2e8
TIMES_THE_BEST, TIMES_THE_BEST_OF_OWN = 2.0, 3.0
"""Ratio of flops that raises the alarm, for orders of the user and for those of a solve."""
ORDERING = "ordering"  # kind of the warning


@dataclass(frozen=True, kw_only=True)
class BestOrder:
    """Cost of the factor in the best order that was tried."""

    ordering: str  # name of the order
    flops: float  # flops of a factorisation
    nonzeros: float  # nnz(L)
    used_flops: float = 0.0  # lower bound in the order used, if the solver counts none


def with_ordering_alarm(
    summary: Mapping[str, Any],
    structure: Callable[[], Iterable[NDArray[Any]]],
    look: Callable[[], BestOrder] | None,
    advice: str = "",
    least_flops: float = LEAST_FLOPS,
) -> dict[str, Any]:
    """Return the fields of a summary with the best order that was tried, and a warning.

    Args:
        structure: function that returns the arrays on which the structure of the matrix depends.
        look: function that orders the matrix; None if the solve chose the best of several orders.
        advice: option that selects the better order; "" if the solve chose the order.
        least_flops: flops of all factorisations from which other orders are compared.
    """
    fields = dict(summary)
    solves = max(int(fields["num_linear_solves"]), 0)
    flops = fields["factor_flops"] or 0.0
    said = ""
    far = TIMES_THE_BEST if advice else TIMES_THE_BEST_OF_OWN
    is_unknown = fields["factor_flops"] is None and bool(advice)
    if look is not None and (is_unknown or flops * solves > least_flops):
        best = look()
        flops = max(flops, best.used_flops)
        fields |= {"least_factor_flops": best.flops, "least_flops_ordering": best.ordering}
        if _is_far(fields, flops, best.flops, far):
            said = _sentence(fields, flops, best, advice)
    if fields["factor_flops"] and flops * solves > LEAST_FLOPS_TO_RECORD:
        past = _earlier(fields, structure)
        if not said and past is not None and _is_far(fields, flops, past.flops, TIMES_THE_BEST):
            fields |= {"least_factor_flops": past.flops, "least_flops_ordering": past.ordering}
            said = _sentence(fields, flops, past, advice, "an earlier solve of this input in ")
    if said:
        fields["warnings"] = (*fields["warnings"], said)
        fields["warning_kinds"] = (*fields["warning_kinds"], ORDERING)
    return fields


def checksum(arrays: Iterable[NDArray[Any]]) -> str:
    """Return a checksum of the bytes of arrays."""
    import zlib  # long solves only

    sums = 0, 1
    for array in arrays:
        data = np.ascontiguousarray(array).data
        sums = zlib.crc32(data, sums[0]), zlib.adler32(data, sums[1])
    return "".join(f"{value:08x}" for value in sums)


def _is_far(fields: Mapping[str, Any], flops: float, best: float, times: float) -> bool:
    saved, entries = flops - best, fields["num_information_nonzeros"] or 0
    is_long = saved * fields["num_linear_solves"] > LEAST_FLOPS
    return flops > times * best and is_long and saved > LEAST_FLOPS_OF_ENTRY * entries


def _earlier(
    fields: Mapping[str, Any], structure: Callable[[], Iterable[NDArray[Any]]]
) -> BestOrder | None:

    names = ("backend_used", "linear_solver_type_used", "num_factor_columns")
    key = " ".join(
        str(part)
        for part in (
            checksum(structure()),
            *(fields[name] for name in names),
            fields["num_information_nonzeros"],
        )
    )
    now = PastFactor(
        float(fields["factor_flops"]),
        float(fields["num_factor_nonzeros"]),
        fields["factor_ordering"],
    )
    past = recall(key, now)
    if past is None or past.ordering == now.ordering:
        return None
    return BestOrder(ordering=past.ordering, flops=past.flops, nonzeros=past.nonzeros)


def _sentence(
    fields: Mapping[str, Any], flops: float, best: BestOrder, advice: str, where: str = ""
) -> str:
    information, nonzeros = fields["num_information_nonzeros"], fields["num_factor_nonzeros"]
    used = fields["factor_ordering"]
    words = f"in {used} order" if used else "in the order used"
    fill = ""
    if nonzeros and information:
        fill = (
            f", nnz(L) is {amount(nonzeros)} instead of {amount(best.nonzeros)} "
            f"(nnz(L) / nnz(Lambda) {number(nonzeros / information)})"
        )
    at_least = "" if fields["factor_flops"] else "at least "
    same = ""
    if information is not None:
        unchanged = " is unchanged" if where else " is the same in every order"
        same = f": nnz(Lambda){unchanged} ({amount(information)})"
    return (
        f"The ordering, not the size, costs the time{same}. A factorisation {words} needs "
        f"{at_least}{number(flops / best.flops)} times the flops of {where}{best.ordering} "
        f"order{fill}.{f' {advice}' if advice else ''}"
    )


# Record of the cheapest factor of each structure that this user has solved.
#
# The file ``factors-VERSION.json`` in the cache folder has one entry per structure: a checksum of
# who is coupled with whom, the size of the matrix and the solver. An entry holds flops, nnz(L) and
# the ordering, but neither paths nor measurements. The checksum and nnz(Lambda) are equal only for
# the same matrix: more flops than recorded are due to the ordering, not to the size.
#
# Only solves of some tenths of a second read and write the file. It keeps the last MOST_ENTRIES
# structures. Its first line is the checksum of the second: a file that was edited counts as empty,
# as one that cannot be read or written.

MOST_ENTRIES = 200


@dataclass(frozen=True)
class PastFactor:
    """Cost of the factor of an earlier solve."""

    flops: float
    nonzeros: float
    ordering: str


def history_path() -> Path:
    """Return the path of the record."""
    return cache_folder() / f"factors-{__version__}.json"


def recall(structure: str, now: PastFactor) -> PastFactor | None:
    """Return the cheapest earlier factor of a structure, or None; record the present one."""
    try:
        path = history_path()
        entries = _read(path)
    except (OSError, RuntimeError):  # no home folder
        return None
    past = entries.pop(structure, None)
    entries[structure] = now if past is None or now.flops < past.flops else past
    kept = list(entries.items())[-MOST_ENTRIES:]
    import json  # long solves only

    with contextlib.suppress(OSError):
        text = json.dumps({key: [one.flops, one.nonzeros, one.ordering] for key, one in kept})
        write_cached(path, f"{_checksum(text)}\n{text}\n")
    return past


def _read(path: Path) -> dict[str, PastFactor]:
    try:
        written, text = path.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):  # not two lines of ASCII
        return {}
    if written != _checksum(text):
        return {}
    import json

    return {key: PastFactor(*values) for key, values in json.loads(text).items()}


def _checksum(text: str) -> str:
    return checksum([np.frombuffer(text.encode(), np.uint8)])
