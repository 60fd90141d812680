"""The page names every kind that a finding may have."""

import ast
from collections.abc import Iterator
from pathlib import Path

import bundle

ROOT = Path(__file__).parents[3]
PACKAGE = Path(bundle.__file__).parent / "analysis"
FILES = [*(PACKAGE / "diagnosis").glob("*.py"), PACKAGE / "factor_equations.py"]
MAKERS = {"fault", "note"}


def kinds(path: Path) -> Iterator[str]:
    """Yield what a source gives as the kind of a finding or a mode."""
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        given = [keyword.value for keyword in node.keywords if keyword.arg == "kind"]
        if isinstance(node.func, ast.Name) and node.func.id in MAKERS:
            given += node.args[:1]
        elif getattr(node.func, "attr", "") in ("argsort", "sort", "unique"):
            continue
        for value in given:
            for part in ast.walk(value):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.value


def test_the_page_names_every_kind() -> None:
    page = (ROOT / "docs" / "diagnose.md").read_text()
    found = {kind for path in FILES for kind in kinds(path)}
    assert len(found) > 25
    assert [kind for kind in sorted(found) if f"`{kind}`" not in page] == []
