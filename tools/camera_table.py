"""The table of camera models in docs/camera_models.md, made from the code.

    python tools/camera_table.py            prints it
    python tools/camera_table.py --update   writes it into the page

Names and parameters are what the built core says; the source is the paragraph that begins
"Source:" in the comment of the header that defines the model, less COLMAP, which all have.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import bundle
from bundle.model.cameras import param_kinds

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "camera_models.md"
HEADERS = ROOT / "cpp" / "core" / "cameras"
BEGIN, END = "<!-- cameras:begin -->\n", "<!-- cameras:end -->"


def table() -> str:
    """Return the table in Markdown; parameters that are never refined stand in brackets."""
    lines = ["| model | parameters | derived in | after |", "|---|---|---|---|"]
    for model, names in bundle.camera_models().items():
        params = ", ".join(
            f"({name})" if kind == "metadata" else name
            for name, kind in zip(names, param_kinds(model), strict=True)
        )
        header = _header_of(model)
        path = header.relative_to(ROOT).as_posix()
        lines.append(
            f"| {model} | {params} | [{header.name}](../{path}) | {_source(header, model)} |"
        )
    return "\n".join(lines) + "\n"


def updated(page: str) -> str:
    """Return the text of a page with its table replaced.

    Raises:
        ValueError: it has no markers.
    """
    if BEGIN not in page or END not in page:
        raise ValueError(f"{PAGE.name}: expected the lines {BEGIN.strip()} and {END}")
    before, rest = page.split(BEGIN, 1)
    return before + BEGIN + table() + END + rest.split(END, 1)[1]


def _header_of(model: str) -> Path:
    (header,) = (
        path for path in HEADERS.glob("*.h") if f'kName[] = "{model}";' in path.read_text()
    )
    return header


def _source(header: Path, model: str) -> str:
    before, _ = header.read_text().split(f'kName[] = "{model}";')
    comments = re.findall(r"^/// Source: (.*(?:\n/// .+)*)", before, re.MULTILINE)
    if not comments:
        raise ValueError(f"{header}: expected a line that begins with '/// Source:' above {model}")
    text: str = comments[-1]
    text = text.replace("\n/// ", " ").rstrip(".")
    return re.sub(r"^COLMAP, src/colmap/sensor/models\.h(?:[;,] (?:and |after )?)?", "", text)


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--update", action="store_true", help="write it into the page")
    if parser.parse_args().update:
        PAGE.write_text(updated(PAGE.read_text()))
    else:
        print(table(), end="")


if __name__ == "__main__":
    main()
