"""Write the stubs of packages of public names, for type checkers and editors.

Their ``__init__.py`` have one table of names and import each on first use.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import bundle
import bundle.georeference

TARGETS = {
    Path(str(one.__file__)).with_suffix(".pyi"): one
    for one in (bundle, bundle.georeference, bundle.constraints)
}


def stub(package: ModuleType) -> str:
    """Return the text of the stub of a package."""
    tables, root = vars(package), package.__name__
    places = {name: f"{root}.{place}" for name, place in tables.get("_MODULES", {}).items()}
    homes = {name: place.rpartition(".")[::2] for name, place in places.items()}
    homes |= {
        name: (f"{root}.{home}", name)
        for home, names in tables["_DEFERRED"].items()
        for name in names.split()
    }
    lines = sorted(f"from {home} import {own} as {name}" for name, (home, own) in homes.items())
    names = "".join(f'    "{name}",\n' for name in sorted(homes))
    doc = (package.__doc__ or "").rstrip()
    head = f'"""{doc}\n\nWritten by tools/public_stub.py; do not edit.\n"""\n\n'
    return head + "\n".join(lines) + f"\n\n__all__ = [\n{names}]\n"


if __name__ == "__main__":
    for target, package in TARGETS.items():
        target.write_text(stub(package), encoding="utf-8")
