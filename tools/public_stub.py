"""Write bundle/__init__.pyi: the public names for type checkers and editors.

``bundle/__init__.py`` has one table of its names and imports each on first use.
"""

from __future__ import annotations

from pathlib import Path

import bundle

TARGET = Path(bundle.__file__).with_suffix(".pyi")


def stub() -> str:
    """Return the text of the stub."""
    tables = vars(bundle)
    places = {name: f"bundle.{place}" for name, place in tables["_MODULES"].items()}
    homes = {name: place.rpartition(".")[::2] for name, place in places.items()}
    homes |= {name: (f"bundle.{home}", name) for name, home in tables["_MODULE_OF"].items()}
    lines = sorted(f"from {home} import {own} as {name}" for name, (home, own) in homes.items())
    names = "".join(f'    "{name}",\n' for name in sorted(homes))
    head = f'"""{bundle.__doc__}\n\nWritten by tools/public_stub.py; do not edit.\n"""\n\n'
    return head + "\n".join(lines) + f"\n\n__all__ = [\n{names}]\n"


if __name__ == "__main__":
    TARGET.write_text(stub(), encoding="utf-8")
