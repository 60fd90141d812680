"""The README's sample of output: the headline that `make demo` prints.

python tools/demo_output.py            prints it
python tools/demo_output.py --update   writes it into README.md
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
BEGIN, END = "<!-- demo:begin -->\n", "<!-- demo:end -->"


def sample() -> str:
    """Run the demo's command and return its headline in a fence of Markdown."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "bundle", "refine", "data/street_colmap", "--quiet"]
        command += ["-o", str(Path(folder) / "demo"), "--loss", "cauchy"]
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=os.environ | {"COLUMNS": "80"},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    headline = done.stdout.split("\n\n")[0]
    return f"```\n{headline}\n```\n"


def main() -> None:
    """Print the sample, or write it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--update", action="store_true", help="write it into README.md")
    if not parser.parse_args().update:
        print(sample(), end="")
        return
    before, rest = README.read_text().split(BEGIN, 1)
    README.write_text(before + BEGIN + sample() + END + rest.split(END, 1)[1])


if __name__ == "__main__":
    main()
