"""`bundle inspect --shape`: textbook flops from three numbers."""

import json

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
