"""`bundle` and `python -m bundle`: everything that takes time is imported under a guard."""

import sys

from bundle.cli import startup


def run() -> int:
    """Run the command that the process was started with; return its exit code."""
    startup.begin()
    from bundle.cli.main import main

    return main()


if __name__ == "__main__":
    sys.exit(run())
