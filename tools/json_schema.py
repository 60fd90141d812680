"""Write docs/reference/report.schema.json, the schema of every report; run by `make quotes`.

usage: python tools/json_schema.py [--check]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from bundle.reports.json_schema import report_schema

TARGET = Path(__file__).parents[1] / "docs" / "reference" / "report.schema.json"


def text() -> str:
    """Return the schema as text."""
    return json.dumps(report_schema(), indent=1) + "\n"


def main() -> int:
    """Write the file, or compare it with the code."""
    if "--check" in sys.argv[1:]:
        is_current = TARGET.read_text() == text()
        if not is_current:
            print(f"{TARGET}: expected the schema of the code; run python tools/json_schema.py")
        return 0 if is_current else 1
    TARGET.write_text(text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
