"""Tables of results as pandas.DataFrame.

A result has a table for each field with one record per row (a tuple of dataclasses or of named
tuples), and for ``iterations``, whose columns are arrays. pandas is imported here only, when a
table is asked for; it is an extra (``pip install bundle-adjust[tables]``).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bundle.errors import InputError
from bundle.interface.option_fields import choice

if TYPE_CHECKING:
    import pandas

_RECORDS = re.compile(r"tuple\[(?!(?:Key|Any)\b)[A-Z]\w+, \.\.\.\]")
"""Type of a field with one record per row; keys and ids are no records."""


def frame_of(columns: Mapping[str, Any]) -> pandas.DataFrame:
    """Return a pandas.DataFrame of columns."""
    try:
        import pandas  # late: an extra, and slow to import
    except ImportError:
        raise InputError(
            "to_dataframe: expected pandas, found no such package; install bundle-adjust[tables]"
        ) from None
    return pandas.DataFrame(dict(columns))


def columns_of(records: Sequence[Any]) -> dict[str, list[Any]]:
    """Return the fields of records as columns; nested records stay objects."""
    if not records:
        return {}
    first = records[0]
    if dataclasses.is_dataclass(first):
        names = [field.name for field in dataclasses.fields(first)]
    else:
        names = list(first._fields)
    return {name: [getattr(record, name) for record in records] for name in names}


def has_records(field: dataclasses.Field[Any]) -> bool:
    """Return True for a field that is a table."""
    return field.name == "iterations" or bool(_RECORDS.fullmatch(str(field.type)))


class Tabular:
    """Base of results with tables."""

    def to_dataframe(self, table: str | None = None) -> pandas.DataFrame:
        """Return a table as a pandas.DataFrame; pandas is the extra ``tables``.

        Args:
            table: name of the attribute that has the rows, such as "iterations" or "runs"; None:
                the first table of the class.

        Raises:
            InputError: the table is unknown, or pandas is not installed.
        """
        tables = self._tables()
        name = next(iter(tables)) if table is None else choice("table", table, tuple(tables))
        return frame_of(tables[name])

    def _tables(self) -> dict[str, Mapping[str, Any]]:
        found: dict[str, Mapping[str, Any]] = {}
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            if has_records(field):
                value = getattr(self, field.name)
                found[field.name] = value if isinstance(value, Mapping) else columns_of(value)
        return found
