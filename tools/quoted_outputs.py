"""Outputs of commands that documents quote: lines under a prompt, between two marks.

    <!-- output: NAME -->
    ```
    $ bundle refine data/street_colmap -o out/demo
    (the headline)
    ```
    <!-- end -->

The commands of a block run one after the other in a folder with data/ and out/. Of each output,
the headline is quoted: the lines before the first empty line, and findings that it announces.
`tests/test_codebase.py` holds the quotes against new outputs.

python tools/quoted_outputs.py            prints the quotes
python tools/quoted_outputs.py --update   writes them into the documents
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
QUOTE = re.compile(r"<!-- output: .*? -->\n```\n(.*?)```\n<!-- end -->", re.DOTALL)


def documents() -> list[Path]:
    """Return the documents that quote outputs."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in pages if QUOTE.search(page.read_text(encoding="utf-8"))]


def quoted(block: str) -> str:
    """Run the commands of a block; return them with their headlines."""
    commands = re.findall(r"^\$ (bundle (?:.*\\\n)*.*)$", block, re.MULTILINE)
    parts = []
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "data").symlink_to(ROOT / "data")
        (Path(folder) / "out").mkdir()
        for command in commands:
            words = shlex.split(command.replace("\\\n", " "))
            done = subprocess.run(
                [sys.executable, "-m", *words, "--quiet"],
                cwd=folder,
                env=os.environ | {"COLUMNS": "80"},
                stdout=subprocess.PIPE,
                text=True,
                check=True,
            )
            headline, *others = done.stdout.strip().split("\n\n")
            if headline.endswith(":"):  # a number of findings, which follow
                headline = "\n".join([headline, *others[:1]])
            parts.append(f"$ {command}\n{headline}\n")
    return "".join(parts)


def updated(text: str) -> str:
    """Return a document with new outputs."""

    def write(found: re.Match[str]) -> str:
        return found[0].replace(found[1], quoted(found[1]))

    return QUOTE.sub(write, text)


def main() -> None:
    """Print the quotes, or write them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--update", action="store_true", help="write them into the documents")
    update = parser.parse_args().update
    for page in documents():
        text = updated(page.read_text(encoding="utf-8"))
        if update:
            page.write_text(text, encoding="utf-8")
        else:
            print("\n".join(found[1] for found in QUOTE.finditer(text)))


if __name__ == "__main__":
    main()
