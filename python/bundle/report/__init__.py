"""What commands print and write as JSON.

The package has the name of :func:`bundle.report`, which importing one of its modules would hide: so
the package can be called as well, and does what the function does.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _CallablePackage(ModuleType):
    def __call__(self, *arguments: Any, **settings: Any) -> tuple[str, ...]:
        """Write a report page: see :func:`bundle.html.write_report`."""
        from bundle.html import write_report

        return write_report(*arguments, **settings)


sys.modules[__name__].__class__ = _CallablePackage
