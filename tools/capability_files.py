"""List the files that name a capability, with their lines: the table in CONTRIBUTING.

    python tools/capability_files.py

The script follows the imports of a file, those inside functions and those by name
("room.module:function") too, from the file that declares the capability. Of the files that it
reaches it lists those whose code has a name of the capability.
"""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "bundle"

CAPABILITIES = {
    "`--rounds`": ("cli/refine.py", r"(num_)?rounds|Rounds?|RoundOptions|solve_rounds"),
    "`--gps`": ("georeference/measurements.py", r"(?i)\w*gps(?!_rms)\w*"),
    "`--velocities`": ("georeference/measurements.py", r"(?i)(?!angular)\w*velocit\w*"),
    "`bundle covariance`": (
        "cli/commands.py",
        r"\w*Covariance|CovarianceOptions|compute_covariance",
    ),
    "the finding `duplicate_points`": ("judging/findings/find.py", r"duplicate_points|Duplicates?"),
}
"""The file that declares a capability, and its names."""


@functools.cache
def _read(path: Path) -> tuple[list[Path], set[str]]:
    """Return the files that a file imports, and the names in its code."""
    room = path.relative_to(PACKAGE).parts[0]
    modules: list[str] = []
    names = set[str]()
    for node in ast.walk(ast.parse(path.read_text())):
        names |= {
            v for f in ("id", "attr", "name", "arg") if isinstance(v := getattr(node, f, 0), str)
        }
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("bundle."):
            modules += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found = re.fullmatch(r"([a-z_][\w.]*?)[:.]\w+", node.value)
            modules += [f"bundle.{found[1]}", f"bundle.{room}.{found[1]}"] if found else []
    files = [PACKAGE.joinpath(*name.split(".")[1:]).with_suffix(".py") for name in modules]
    return [file for file in files if file.is_file()], names


def files_of(start: str, names: str) -> list[Path]:
    """Return the files that name a capability."""
    reached, open_files = set[Path](), [PACKAGE / start]
    while open_files:
        path = open_files.pop()
        if path not in reached:
            reached.add(path)
            open_files += _read(path)[0]
    pattern = re.compile(names)
    return sorted(path for path in reached if any(map(pattern.fullmatch, _read(path)[1])))


def table() -> str:
    """Return the table as Markdown."""
    rows = ["| capability | files | lines | which |", "|---|---|---|---|"]
    for capability, (start, names) in CAPABILITIES.items():
        files = files_of(start, names)
        lines = sum(path.read_text().count("\n") for path in files)
        listed = ", ".join(str(path.relative_to(PACKAGE)) for path in files)
        rows.append(f"| {capability} | {len(files)} | {lines:,} | {listed} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(table())
