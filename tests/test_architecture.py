"""The design: every include and import points down one of these lists, types counted."""

import ast
import re
from pathlib import Path

import pytest
from tools import capability_files

import bundle

ROOT = Path(__file__).parents[1]
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()
CPP, PACKAGE = ROOT / "cpp", ROOT / "python" / "bundle"
CORE = "geometry parallel scratch sums dense symbolic cameras inertial factors graph problem io"
CORE += (
    " synthetic interface model minimize linear window checking prepare pose_graph schur covariance"
)
LAYERS = f"{CORE} diagnosis ceres solver".split()  # of cpp/core, the lowest first
ROOMS = "base interface model io checking graphs georeference editing solving inertial synthetic"
RANKS = f"{ROOMS} planning analysis judging figures reports cli".split()  # of python/bundle
ROOT_FILES = ["__init__.py", "__init__.pyi", "__main__.py", "_core.pyi", "errors.py", "py.typed"]
OUTSIDERS = {  # other people's packages, and the rooms that may know them
    "argparse": "cli", "shtab": "cli", "rich": "base checking reports cli", "matplotlib": "figures",
    "pycolmap": "model io", "pyproj": "georeference", "yaml": "model",
    "pandas": "interface model solving analysis", "rerun": "io", "cv2": "io inertial",
    "rosbags": "io", "evo": "", "mpi4py": "solving cli", "PIL": "io georeference reports",
    "torch": "analysis", "jax": "analysis",
}  # fmt: skip


def imports(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_text())))
    plain = {name.name for node in nodes if isinstance(node, ast.Import) for name in node.names}
    froms = (node for node in nodes if isinstance(node, ast.ImportFrom))
    return plain | {f"{node.module}.{name.name}" for node in froms for name in node.names}


@pytest.mark.parametrize("room", RANKS)
def test_python_imports_point_down(room: str) -> None:
    for path, name in ((p, name) for p in (PACKAGE / room).rglob("*.py") for name in imports(p)):
        first, second = (name + ".").split(".")[:2]
        assert room in OUTSIDERS.get(first, room).split(), f"{path} may not import {first}"
        if first == "bundle" and second in RANKS:
            assert RANKS.index(second) <= RANKS.index(room), f"{path} lies below {name}"
        elif first == "bundle":  # never a face: that hides what is used, and loads the rest
            assert second in {"_core", "errors", "__version__"}, f"{path}: import {name} there"


@pytest.mark.parametrize("layer", ["core", "bindings"])
def test_cpp_includes_point_down(layer: str) -> None:
    for path in (CPP / layer).rglob("*.[hc]*"):
        folders = path.relative_to(CPP / layer).parts[:-1]
        for header in re.findall(r'^ *# *include [<"]([^>"]+)', path.read_text(), re.MULTILINE):
            what = f"{path} includes {header}"
            assert layer != "core" or not re.match(r"pybind11/|bindings/|Python\.h", header), what
            assert not header.startswith("ceres/") or layer != "core" or folders == ("ceres",), what
            if layer == "core" and header.startswith("core/") and folders and header.count("/") > 1:
                assert LAYERS.index(header.split("/")[1]) <= LAYERS.index(folders[0]), what


def test_nothing_stands_outside_the_lists() -> None:
    listed = set(re.findall(r"\b(?:core|bindings)/\S+\.cpp", (CPP / "CMakeLists.txt").read_text()))
    assert listed == {path.relative_to(CPP).as_posix() for path in CPP.rglob("*.cpp")}
    assert {path.name for path in CPP.iterdir() if path.is_dir()} == {"core", "bindings"}
    assert {path.name for path in (CPP / "core").iterdir() if path.is_dir()} == set(LAYERS)
    assert {p.name for p in PACKAGE.iterdir()} - {"__pycache__", "include"} == {*RANKS, *ROOT_FILES}
    assert not set(RANKS) & {name for name in bundle.__all__ if callable(getattr(bundle, name))}


BUDGETS = {
    room: (int(lines.replace(",", "")), int(files))
    for room, lines, files in re.findall(
        r"^\| \[(\w+)\]\(python/.*\| ([\d,]+) \| (\d+) \|$",
        CONTRIBUTING,
        re.MULTILINE,
    )
}
"""Most lines and files of each room, from the table of rooms."""


def test_every_room_has_a_budget() -> None:
    assert list(BUDGETS) == RANKS


@pytest.mark.parametrize("room", RANKS)
def test_rooms_stay_within_their_budgets(room: str) -> None:
    """A budget that is far above its room would hold nothing: lower it with the room."""
    files = [path.read_text() for path in (PACKAGE / room).rglob("*.py")]
    lines = sum(text.count("\n") for text in files)
    most_lines, most_files = BUDGETS[room]
    assert 0.95 * most_lines <= lines <= most_lines
    assert 0.9 * most_files <= len(files) <= most_files


@pytest.mark.parametrize("capability", capability_files.CAPABILITIES)
def test_a_capability_touches_no_more_files_than_its_row_says(capability: str) -> None:
    """`python tools/capability_files.py` writes the rows."""
    row = re.search(rf"^\| {re.escape(capability)} \| (\d+) \|", CONTRIBUTING, re.MULTILINE)
    assert row is not None
    files = capability_files.files_of(*capability_files.CAPABILITIES[capability])
    assert 0 < len(files) <= int(row[1])
