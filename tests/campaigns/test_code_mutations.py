"""Edits of a source, the files that could see them, and verdicts."""

import os

import pytest

from tests.campaigns import code_mutations
from tests.campaigns.code_mutations import Mutation, candidates, seen_by, verdict


@pytest.mark.parametrize(
    ("line", "edits"),
    [
        ("LIMIT = 5.0", {"LIMIT = 50.0", "LIMIT = 0.5"}),
        ("def f(x): return g(x, -x)", {"def f(x): return g(-x, x)", "def f(x): return g(x, (x))"}),
        ("x = a + b", {"x = ((a) - (b))", "x = (a)", "x = b + b", "x = a + a"}),
        ("x = y and z", {"x = ((y) or (z))", "x = y and True", "x = z and z", "x = y and y"}),
        ("x = np.max(y)", {"x = np.min(y)"}),
        ("x[k] = y", {"pass"}),
        ("raise ValueError(f'{a + 1}')", set()),
    ],
)
def test_the_edits_of_a_line(tmp_path, line, edits):
    path = tmp_path / "source.py"
    path.write_text(f"# ä\n{line}\n")
    text = path.read_bytes()
    found = {
        (text[: edit.begin] + edit.new.encode() + text[edit.end :]).decode().splitlines()[1]
        for edit in candidates(path)
    }
    assert found == edits


def test_the_files_that_import_a_module_or_have_its_name():
    path = code_mutations.PACKAGE / "graphs" / "pose_graphs" / "certify.py"
    folder = "tests/graphs/pose_graphs"
    near, wide = seen_by(path), seen_by(path, wide=True)
    assert {f"{folder}/test_certify.py", f"{folder}/test_certified_thresholds.py"} <= {*near}
    assert f"{folder}/test_joints.py" in {*wide} - {*near}


@pytest.mark.parametrize(("new", "word"), [("1", "SURVIVED"), ("2", "killed"), ("1 / 0", "killed")])
def test_a_verdict_restores_the_source(tmp_path, new, word):
    source, test = tmp_path / "source.py", tmp_path / "test_source.py"
    source.write_text("x = 1\n")
    os.utime(source, (1e9, 1e9))
    test.write_text("def test_it():\n    import runpy\n")
    test.write_text(test.read_text() + f"    assert runpy.run_path({str(source)!r})['x'] == 1\n")
    assert verdict(Mutation(source, 1, 4, 5, "1", new), [str(test)]).startswith(word)
    assert (source.read_text(), source.stat().st_mtime) == ("x = 1\n", 1e9)
