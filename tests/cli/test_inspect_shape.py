"""`bundle inspect --shape`: textbook flops from three numbers."""

import json

import pytest

from tests.printed import table


def test_flops_of_a_shape(run, tmp_path):
    path = tmp_path / "shape.json"
    code, out, _ = run("inspect", "--shape", "100,20000,4", "--json", path, "--verbose")
    assert code == 0
    report = json.loads(path.read_text())
    assert report["shape"] == {"num_cameras": 100, "num_points": 20000, "track_length": 4}
    assert report["points"] == 27 * 20_000
    assert report["products"] == 162 * 16 * 20_000
    assert report["reduced"] == 600**3 / 3
    assert report["dense"] == 60_600**3 / 3
    assert report["schur"] == report["points"] + report["products"] + report["reduced"]
    assert table(out)["together"][-1] == "1.244e+08"
    assert "flops per step" in report["headline"][0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--shape", "100,20000"], "expected three whole numbers"),
        (["--shape", "a,b,c"], "expected three whole numbers"),
        (["--shape", "3,10,4"], "cameras of a point: expected 1 to 3, found 4"),
        (["--shape", "0,10,1"], "cameras: expected 1 to"),
        (["--shape", "3,-1,2"], "points: expected 1 to"),
        (["model", "--shape", "3,10,2"], "valid only without INPUT"),
        (["--shape", "3,10,2", "--refine", "poses"], "--refine"),
        (["--shape", "3,10,2", "--recalibrate"], "--recalibrate"),
    ],
)
def test_bad_shapes_are_one_line(run, words, message):
    code, out, err = run("inspect", *words)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert message in err
