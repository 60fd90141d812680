"""Who may know whom: core C++ <- bindings <- library <- command line, and the order inside each.

Each table names all that a unit may use, itself aside. A new folder or module needs a row here.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from bundle.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]
CPP = ROOT / "cpp"
PACKAGE = ROOT / "python" / "bundle"

# Folders of cpp/core; the files directly in it (errors, threads) are open to all.
CORE_MAY_INCLUDE = {
    "geometry": set(),
    "parallel": set(),
    "dense": set(),
    "symbolic": set(),
    "cameras": {"geometry"},
    "inertial": {"geometry"},
    "factors": {"cameras", "geometry", "dense", "inertial"},
    "graph": {"factors", "geometry", "dense"},
    "problem": {"factors", "cameras", "geometry", "parallel"},
    "io": {"cameras"},
    "synthetic": {"cameras", "geometry", "parallel"},
    "interface": {"problem", "factors"},
    "model": {
        *{"interface", "problem", "factors", "cameras", "geometry", "symbolic", "parallel"},
        "dense",
    },
    "linear": {"interface", "minimize", "symbolic", "parallel", "cameras"},
    "window": {
        *{"linear", "minimize", "interface", "factors", "inertial", "geometry", "dense"},
    },
    "minimize": {"interface", "parallel", "dense"},
    "checking": {"model", "interface", "problem", "factors", "cameras", "parallel"},
    "prepare": {
        *{"checking", "linear", "model", "interface", "problem", "factors"},
        *{"symbolic", "parallel"},
    },
    "pose_graph": {
        *{"linear", "minimize", "interface", "factors", "geometry", "parallel", "dense"},
    },
    "schur": {
        *{"linear", "minimize", "model", "interface", "problem", "factors", "cameras"},
        *{"parallel", "dense"},
    },
    "covariance": {
        *{"prepare", "schur", "linear", "model", "interface", "problem", "factors"},
        *{"cameras", "geometry", "parallel", "dense"},
    },
    "diagnosis": {"covariance", "pose_graph", "model", "linear", "interface", "problem", "dense"},
    "ceres": {
        *{"prepare", "checking", "graph", "model", "interface", "problem", "factors"},
        *{"cameras", "symbolic", "parallel"},
    },
    "solver": {
        *{"ceres", "schur", "pose_graph", "prepare", "checking", "minimize", "linear", "model"},
        *{"interface", "problem", "parallel", "graph", "dense"},
    },
}

# Modules and packages directly in python/bundle.
PYTHON_MAY_IMPORT = {
    "address_space": set(),
    "errors": {"_core"},
    "headers": set(),
    "arguments": {"errors"},
    "option_fields": {"errors"},
    "options": {"errors", "option_fields"},
    "losses": {"_core", "arguments", "errors", "option_fields", "options"},
    "cameras": {"_core", "arguments", "errors", "option_fields"},
    "arrays": {"_core", "arguments", "errors"},
    "deferred_source": {"_core"},
    "problem": {
        "_core",
        "arrays",
        "cameras",
        "deferred_source",
        "display",
        "errors",
        "option_fields",
        "rig_arrays",
        "words",
    },
    "rig_arrays": {"arrays", "errors", "problem", "rigid_motions", "rotations"},
    "rigid_motions": {"rotations"},
    "warning_kinds": set(),
    "words": set(),
    "rotations": set(),
    "text_lines": {"errors"},
    "components": set(),
    "display": set(),
    "tables": {"words"},
    "process_record": set(),
    "ranks": {"_core", "arrays", "errors", "problem", "process_record", "restrictions"},
    "summary": {"display", "process_record", "tables", "words"},
    "termination": {"summary", "words"},
    "memory_sizes": {"errors"},
    "reprojection": {
        "_core",
        "cameras",
        "errors",
        "io",
        "option_fields",
        "options",
        "problem",
    },
    "worst_images": {"problem", "reprojection"},
    "solve_record": {"display", "options", "summary", "termination"},
    "problem_keys": {"cameras", "errors", "problem"},
    "camera_bounds": {"arguments", "arrays", "cameras", "errors", "problem", "problem_keys"},
    "constraint_record": set(),
    "constraints": {
        "cameras",
        "constraint_record",
        "display",
        "errors",
        "graph",
        "image_selection",
        "options",
        "problem",
        "problem_keys",
        "rotations",
        "text_lines",
    },
    "restrictions": {
        "arrays",
        "camera_bounds",
        "constraint_record",
        "constraints",
        "errors",
        "problem",
        "problem_keys",
    },
    "result": {
        "camera_bounds",
        "constraint_record",
        "display",
        "free_degrees",
        "georeference",
        "problem",
        "reprojection",
        "round_record",
        "solve_record",
        "summary",
        "words",
        "worst_images",
    },
    "pose_graph_options": {"option_fields", "options"},
    "pose_graph": {
        "pose_graph_options",
        "_core",
        "arguments",
        "arrays",
        "display",
        "errors",
        "io",
        "option_fields",
        "options",
        "rigid_motions",
        "rotations",
        "solve_record",
        "summary",
        "words",
    },
    "files": {"errors", "io", "pose_graph", "problem"},
    "image_selection": {"errors", "problem"},
    "round_record": set(),
    "camera_changes": {"cameras", "result"},
    "sensor_changes": {"cameras", "result", "rotations"},
    "free_degrees": {
        "components",
        "display",
        "georeference",
        "graph",
        "io",
        "options",
        "problem",
        "rotations",
        "words",
    },
    "rig_config": {
        "arguments",
        "cameras",
        "errors",
        "problem",
        "rig_arrays",
        "rigid_motions",
        "rotations",
    },
    "camera_edits": {
        "arguments",
        "cameras",
        "display",
        "errors",
        "io",
        "option_fields",
        "problem",
        "reprojection",
        "words",
    },
    "io": {
        "_core",
        "address_space",
        "arguments",
        "cameras",
        "deferred_source",
        "errors",
        "option_fields",
        "problem",
        "rig_arrays",
    },
    "statistics": {
        "components",
        "cameras",
        "display",
        "errors",
        "io",
        "problem",
        "rig_arrays",
        "reprojection",
        "words",
        "worst_images",
    },
    "synthetic": {
        "_core",
        "cameras",
        "components",
        "display",
        "errors",
        "inertial",
        "io",
        "option_fields",
        "problem",
        "reprojection",
        "rigid_motions",
        "rotations",
        "vio",
        "words",
    },
    "placement": {"arguments", "errors", "georeference", "graph", "problem"},
    "slices": {
        *{"_core", "arrays", "components", "errors", "free_degrees", "io", "option_fields"},
        *{"options", "problem", "process_record", "ranks", "rounds"},
        *{"reprojection", "result", "solve_record", "solver", "worst_images"},
    },
    "solver": {
        "_core",
        "arguments",
        "constraints",
        "display",
        "errors",
        "graph",
        "io",
        "options",
        "placement",
        "pose_graph",
        "pose_graph_options",
        "problem",
        "ranks",
        "reprojection",
        "restrictions",
        "result",
        "sensor_changes",
        "solve_record",
        "words",
    },
    "rounds": {
        "_core",
        "arguments",
        "arrays",
        "constraint_record",
        "constraints",
        "display",
        "errors",
        "graph",
        "image_selection",
        "io",
        "memory_sizes",
        "option_fields",
        "options",
        "placement",
        "problem",
        "problem_keys",
        "process_record",
        "reprojection",
        "result",
        "rig_arrays",
        "round_record",
        "solve_record",
        "solver",
        "summary",
        "words",
    },
    "loop_losses": set(),
    "loops": {
        "_core",
        "arguments",
        "arrays",
        "cameras",
        "components",
        "display",
        "errors",
        "graph",
        "io",
        "loop_losses",
        "losses",
        "option_fields",
        "pose_graph",
        "problem",
        "reprojection",
        "rig_arrays",
        "rigid_motions",
        "rotations",
        "words",
    },
    "vio": {
        "_core",
        "inertial",
        "option_fields",
        "arguments",
        "arrays",
        "cameras",
        "display",
        "errors",
        "io",
        "rigid_motions",
        "rotations",
        "text_lines",
        "words",
    },
    "merging": {
        "cameras",
        "display",
        "errors",
        "georeference",
        "io",
        "option_fields",
        "problem",
        "rotations",
        "words",
    },
    "diagnosis": {
        "_core",
        "arrays",
        "cameras",
        "components",
        "constraints",
        "display",
        "free_degrees",
        "graph",
        "io",
        "options",
        "placement",
        "pose_graph",
        "pose_graph_options",
        "problem",
        "result",
        "rotations",
        "solver",
        "statistics",
        "words",
    },
    "check_defaults": set(),
    "checking": {
        "_core",
        "arguments",
        "cameras",
        "check_defaults",
        "display",
        "errors",
        "io",
        "option_fields",
        "problem",
        "reprojection",
        "tables",
        "words",
    },
    "graph": {
        "_core",
        "arguments",
        "arrays",
        "cameras",
        "check_defaults",
        "checking",
        "display",
        "errors",
        "memory_sizes",
        "option_fields",
        "options",
        "problem",
        "problem_keys",
        "rotations",
        "solve_record",
        "words",
    },
    "inertial": {
        "_core",
        "arguments",
        "arrays",
        "display",
        "errors",
        "graph",
        "option_fields",
    },
    "filters": {"arguments", "display", "errors", "option_fields", "rotations"},
    "two_loops": {
        "_core",
        "arguments",
        "display",
        "errors",
        "inertial",
        "io",
        "option_fields",
        "pose_graph",
        "rigid_motions",
        "rotations",
        "solver",
        "text_lines",
        "vio",
    },
    "georeference": {
        "arguments",
        "arrays",
        "cameras",
        "display",
        "errors",
        "graph",
        "io",
        "losses",
        "option_fields",
        "options",
        "problem",
        "rig_arrays",
        "rotations",
        "text_lines",
        "words",
    },
    "compare_defaults": {"memory_sizes"},
    "comparison": {
        "_core",
        "arrays",
        "arguments",
        "compare_defaults",
        "errors",
        "inspection",
        "io",
        "memory_sizes",
        "options",
        "pose_graph",
        "pose_graph_options",
        "problem",
        "result",
        "solver",
        "summary",
        "display",
        "option_fields",
        "words",
    },
    "uncertainty": {
        "_core",
        "arrays",
        "constraints",
        "display",
        "errors",
        "graph",
        "io",
        "options",
        "placement",
        "pose_graph",
        "pose_graph_options",
        "problem",
        "result",
        "solver",
        "words",
    },
    "inspection": {
        "arguments",
        "display",
        "words",
        "_core",
        "errors",
        "io",
        "memory_sizes",
        "option_fields",
        "options",
        "pose_graph",
        "problem",
        "solver",
        "ranks",
    },
    "pictures": {
        "_core",
        "arguments",
        "cameras",
        "comparison",
        "errors",
        "figures",
        "option_fields",
        "options",
        "problem",
        "solver",
        "statistics",
    },
    "figures": {
        "_core",
        "camera_edits",
        "cameras",
        "errors",
        "inertial",
        "losses",
        "problem",
        "reprojection",
        "rotations",
        "rounds",
        "uncertainty",
        "worst_images",
        "vio",
    },
    "html": {
        "arguments",
        "cameras",
        "errors",
        "figures",
        "georeference",
        "comparison",
        "constraints",
        "inspection",
        "io",
        "memory_sizes",
        "options",
        "pictures",
        "placement",
        "problem",
        "reprojection",
        "result",
        "statistics",
        "uncertainty",
        "vio",
        "words",
    },
    "reports": {
        "_core",
        "camera_changes",
        "camera_edits",
        "cameras",
        "constraint_record",
        "display",
        "checking",
        "comparison",
        "diagnosis",
        "errors",
        "free_degrees",
        "georeference",
        "inspection",
        "loops",
        "memory_sizes",
        "merging",
        "options",
        "pose_graph",
        "pose_graph_options",
        "problem",
        "process_record",
        "result",
        "round_record",
        "sensor_changes",
        "statistics",
        "summary",
        "tables",
        "two_loops",
        "uncertainty",
        "vio",
        "words",
        "worst_images",
    },
}
# The names that users see.
PYTHON_MAY_IMPORT[""] = set(PYTHON_MAY_IMPORT) - {"reports"} | {"_core"}
# The command line stands above everything, and nothing imports it but __main__.
PYTHON_MAY_IMPORT["cli"] = set(PYTHON_MAY_IMPORT)
PYTHON_MAY_IMPORT["__main__"] = {"address_space", "cli", "ranks"}

# Imports inside a function or for type checkers that point upwards on purpose: methods that are a
# convenience for what stands above them.
DEFERRED_IMPORTS = {"problem": {"io"}, "synthetic": {"io"}}

# Other people's packages that only some of ours may know.
OUTSIDERS = {
    "argparse": {"cli"},
    "rich": {"checking", "cli", "reports", "summary", "tables"},
    "pycolmap": {"deferred_source", "io", "loops", "merging", "problem", "vio"},
    "matplotlib": {"pictures"},
    "pyproj": {"georeference"},
    "yaml": {"vio"},
    "evo": {"vio"},
    "mpi4py": {"cli", "ranks"},
    "PIL": {"georeference", "html"},
}

CPP_FILES = sorted(path for path in CPP.rglob("*") if path.suffix in {".h", ".cpp"})
PYTHON_FILES = sorted(PACKAGE.rglob("*.py"))


def names(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def includes(path: Path) -> list[str]:
    """Return what a C++ file includes, as written, with its brackets or quotes."""
    return re.findall(r'^\s*#\s*include\s*([<"][^>"]+[>"])', path.read_text(), re.MULTILINE)


def unit_of(path: Path) -> str:
    """Return a Python file's row: the module or package directly in bundle, "" for __init__."""
    first = path.relative_to(PACKAGE).parts[0]
    return "" if first == "__init__.py" else first.removesuffix(".py")


@pytest.mark.parametrize("path", CPP_FILES, ids=names)
def test_cpp_includes_follow_the_layers(path: Path) -> None:
    layer, *folders = path.relative_to(CPP).parts[:-1]
    for include in includes(path):
        header = include[1:-1]
        if include.startswith('"'):
            assert (CPP / header).is_file(), f"{include}: write our headers' paths from cpp/ on"
        if layer != "core":
            continue
        assert not re.match(r"(pybind11|bindings)/|Python\.h", header), f"{include} in the core"
        assert not header.startswith("ceres/") or folders == ["ceres"], f"{include} outside ceres/"
        if header.startswith("glog/"):
            assert path.name == "ceres_version.h", f"{include}: other versions log elsewhere"
        target = Path(header).parts[1:-1] if header.startswith("core/") else ()
        if target and folders and target[0] != folders[0]:
            assert target[0] in CORE_MAY_INCLUDE[folders[0]], f"{folders[0]} may not use {include}"


def test_every_cpp_file_is_compiled() -> None:
    listed = set(re.findall(r"\b(?:core|bindings)/\S+\.cpp", (CPP / "CMakeLists.txt").read_text()))
    assert listed == {p.relative_to(CPP).as_posix() for p in CPP_FILES if p.suffix == ".cpp"}


def imported(tree: ast.AST, package: str) -> Iterator[str]:
    """Yield the dotted names that the import statements under a node ask for."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*package.split(".")[: 1 - node.level or None], base]).rstrip(".")
            yield from (f"{base}.{alias.name}" for alias in node.names)


def at_import_time(source: str) -> ast.Module:
    """Return a module without what does not run on import: functions, blocks for type checkers."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if typing_only or isinstance(node, ast.FunctionDef):
            node.body = [ast.Pass()]
    return tree


def own_units(imports: Iterator[str]) -> set[str]:
    """Return the rows of bundle among dotted names; names bound in bundle/__init__ are row ""."""
    units = set()
    for name in imports:
        first, _, rest = name.partition(".")
        if first == "bundle":
            unit = rest.partition(".")[0]
            known = (
                unit == "_core" or (PACKAGE / unit).is_dir() or (PACKAGE / f"{unit}.py").exists()
            )
            units.add(unit if known else "")
    return units


@pytest.mark.parametrize("path", PYTHON_FILES, ids=names)
def test_python_imports_follow_the_layers(path: Path) -> None:
    unit = unit_of(path)
    package = ".".join(path.relative_to(PACKAGE.parent).parent.parts)
    source = path.read_text()
    allowed = PYTHON_MAY_IMPORT[unit] | {unit}
    immediate = own_units(imported(at_import_time(source), package))
    assert immediate <= allowed, f"{unit} may not import {immediate - allowed}"
    every = list(imported(ast.parse(source), package))
    deferred = own_units(iter(every)) - allowed
    assert deferred <= DEFERRED_IMPORTS.get(unit, set()), f"{unit} may not import {deferred}"
    for outsider, users in OUTSIDERS.items():
        used = any(name.partition(".")[0] == outsider for name in every)
        assert not used or unit in users, f"{outsider} is for {users} alone"


def test_modules_have_names_of_their_own() -> None:
    """A command has its name in cli/ and, for what it prints, in reports/; no other repeats."""
    homes: dict[str, list[str]] = {}
    for path in PYTHON_FILES:
        if path.name != "__init__.py":
            homes.setdefault(path.stem, []).append(names(path.parent))
    twins = {name: found for name, found in homes.items() if len(found) > 1}
    pair = ["python/bundle/cli", "python/bundle/reports"]
    assert {name for name, found in twins.items() if found == pair} <= set(COMMANDS)
    assert {name: found for name, found in twins.items() if found != pair} == {}
    packages = {path.parent.name for path in PYTHON_FILES if path.name == "__init__.py"}
    # The contract has the command, its report and what they run called alike.
    assert packages & set(homes) == {"vio"}, "a module named as a package"


def test_tables_name_nothing_that_is_gone() -> None:
    folders = {path.name for path in (CPP / "core").iterdir() if path.is_dir()}
    assert set(CORE_MAY_INCLUDE) == folders
    assert set(PYTHON_MAY_IMPORT) == {unit_of(path) for path in PYTHON_FILES}
