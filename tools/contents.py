"""List what each file contains: its first sentence, and the sections inside.

    python tools/contents.py                        # all folders of code
    python tools/contents.py cpp/core/io | grep -i truncat

A header and its source are one place, which the header describes; of a source without either it
lists the functions that it binds. A section begins with a comment in the first column, after two
empty lines.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("python/bundle", "cpp", "benchmarks", "tests/campaigns", "tools")
EMBEDDED = "three"  # folder of a library of other people in the report page
HEADS = {
    ".h": r"^/// (.+(?:\n/// .+)*)",
    ".cpp": r"\A/// (.+(?:\n/// .+)*)",
    ".css": r"\A/\* (.+?) \*/",
    ".js": r"^// (.+(?:\n// .+)*)",
    ".sh": r"^# (?!usage)(.+(?:\n# .+)*)",
}
"""The comment that describes a file, by its suffix."""
SECTION = re.compile(r"(?<=\n\n\n)# (.+(?:\n# .+)*)")
BOUND = re.compile(r'\bdef(?:_submodule)?\(\s*"(\w+)"')


def first_sentence(text: str) -> str:
    """Return the first sentence of a comment; a period after an initial does not end it."""
    words = " ".join(re.sub(r"^(///?|#) ", "", line) for line in text.splitlines())
    return re.split(r"(?<=[\w)`\"'][\w)`\"'][.?!]) (?=[A-Z`])", words)[0]


def described(path: Path) -> str:
    """Return what a file contains; "" if it does not say so."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return first_sentence((ast.get_docstring(ast.parse(text)) or "").partition("\n\n")[0])
    found = re.search(HEADS[path.suffix], text, re.MULTILINE)
    return first_sentence(found[1]) if found else ", ".join(BOUND.findall(text))


def sections(path: Path) -> list[str]:
    """Return the first sentences of the sections of a Python file."""
    text = path.read_text(encoding="utf-8")
    return [first_sentence(one) for one in SECTION.findall(text)] if path.suffix == ".py" else []


def files_of(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that describe a place."""
    for path in sorted(folder.rglob("*")):
        is_source = path.suffix == ".cpp" and path.with_suffix(".h").exists()
        is_described = path.suffix in {".py", *HEADS} and path.name != "__init__.py"
        if is_described and not is_source and EMBEDDED not in path.parts:
            yield path


def main() -> None:
    """Print the contents of the folders that are named, or of all."""
    for folder in sys.argv[1:] or FOLDERS:
        for path in files_of(ROOT / folder):
            place = path.relative_to(ROOT)
            print(f"{place}: {described(path)}")
            for section in sections(path):
                print(f"{place}: - {section}")


if __name__ == "__main__":
    main()
