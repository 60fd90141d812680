"""Commands start quickly because they import what they need and no more."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import bundle
from tests.scenes import make_problem

HEAVY = {
    *{"pycolmap", "matplotlib", "scipy", "pyproj", "PIL"},
    *{"bundle.reports.page", "bundle.figures.matplotlib", "bundle.georeference.survey_priors"},
    *{"bundle.synthetic", "bundle.planning.comparison", "bundle.checking"},
}
COMMANDS = {f"bundle.cli.{name}" for name in ("models", "costs", "scenes", "sequences")}
NOT_FOR_HELP = HEAVY | COMMANDS | {"rich", "bundle.planning.inspection"}
NOT_FOR_REFINE = (
    HEAVY
    | COMMANDS
    | {
        *{"bundle.editing", "bundle.planning", "bundle.inertial"},
        *{"bundle.graphs", "bundle.solving.constraints", "bundle.solving.ranks.mpi_crew"},
        *{"bundle.solving.rounds.checkpoint", "bundle.solving.hold_out", "bundle.io.g2o_files"},
        *{"rich", "numpy.ma", "hashlib", "zipfile", "gzip", "subprocess", "shutil"},
    }
)
RUN = """
import sys
from bundle.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
sys.stderr.write(" ".join(sys.modules))
"""


def imported(*words: str) -> set[str]:
    """Return the modules in memory after a command, in a terminal of unknown width."""
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    return set(done.stderr.split())


@pytest.mark.parametrize("name", sorted(NOT_FOR_HELP | NOT_FOR_REFINE))
def test_modules_that_must_not_be_imported_exist(name: str) -> None:
    spec = find_spec(name)
    assert spec is not None
    assert spec.origin is not None, "a former name, which is never in sys.modules"


@pytest.mark.parametrize("word", ["--help", "--version"])
def test_help_of_all_commands_needs_no_arrays(word: str) -> None:
    assert not imported(word) & (NOT_FOR_HELP | {"bundle.interface", "bundle.base.arrays"})


def test_help_of_a_command_imports_no_other_command() -> None:
    found = imported("refine", "--help")
    assert "bundle.cli.declarations" in found
    assert not found & (NOT_FOR_HELP | {"bundle.cli.refine", "bundle.cli.run"})


@pytest.mark.parametrize("format", ["colmap", "colmap-text"])
def test_refining_a_model_needs_no_pycolmap(
    tmp_path: Path, format: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # a path that is longer than a line is broken by rich
    bundle.save(make_problem(), tmp_path / "in", format)
    found = imported("refine", "in", "-o", "out", "--quiet", "--json", "report.json")
    assert "bundle.reports.terminal.refine" in found
    assert not found & NOT_FOR_REFINE
    assert (tmp_path / "out").is_dir()


DROP_IN = """
import sys
import pycolmap
model = pycolmap.Reconstruction(sys.argv[1])
before = set(sys.modules)
import bundle
bundle.bundle_adjustment(model, pycolmap.BundleAdjustmentOptions(print_summary=False))
print(*sorted(set(sys.modules) - before))
"""


def test_a_first_adjustment_in_pycolmaps_place_imports_no_readers(tmp_path: Path) -> None:
    bundle.save(make_problem(), tmp_path / "in", "colmap")
    done = subprocess.run(
        [sys.executable, "-c", DROP_IN, tmp_path / "in"], capture_output=True, text=True, check=True
    )
    found = set(done.stdout.split())
    assert "bundle.solving.executors" in found
    assert not found & {"numpy.ma", "tempfile", "bundle.solving.constraints.rules"}
    assert not [name for name in found if name.startswith(("bundle.io.", "bundle.graphs."))]
