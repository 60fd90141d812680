"""Commands start quickly because they import what they need and no more."""

import subprocess
import sys
from pathlib import Path

import pytest

import bundle
from tests.scenes import make_problem

HEAVY = {
    *{"pycolmap", "matplotlib", "scipy", "pyproj", "PIL"},
    *{"bundle.synthetic", "bundle.html", "bundle.pictures", "bundle.georeference"},
}
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
    """Return the modules in memory after a command."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words], capture_output=True, text=True, check=True
    )
    return set(done.stderr.split())


def test_help_of_a_command_imports_no_other_command() -> None:
    found = imported("refine", "--help")
    assert "bundle.cli.refine" in found
    others = {f"bundle.cli.{name}" for name in ("compare", "inspect", "synth", "check", "info")}
    assert not found & (
        HEAVY | others | {"rich", "bundle.planning.comparison", "bundle.planning.inspection"}
    )


@pytest.mark.parametrize("format", ["colmap", "colmap-text"])
def test_refining_a_model_needs_no_pycolmap(tmp_path: Path, format: str) -> None:
    bundle.save(make_problem(), tmp_path / "in", format)
    words = ("refine", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--quiet")
    found = imported(*words, "--json", str(tmp_path / "report.json"))
    assert "bundle.reports.terminal.refine" in found
    assert not found & (
        HEAVY | {"bundle.analysis.statistics", "rich.live", "bundle.checking", "numpy.ma"}
    )
    assert (tmp_path / "out").is_dir()
