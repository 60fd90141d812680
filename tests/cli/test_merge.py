"""`bundle merge` from the outside."""

import json

import pytest

import bundle
from tests.editing.merging.halves import halves, whole
from tests.printed import table


@pytest.fixture
def models(tmp_path):
    a, b = halves(whole())
    bundle.save(a, f"{tmp_path}/a/")
    bundle.save(b, f"{tmp_path}/b/")
    return tmp_path, bundle.merge(a, b)


def test_two_models_become_one_and_the_report_says_how(run, models):
    folder, expected = models
    words = (folder / "a", folder / "b", "-o", f"{folder}/out/", "--quiet", "--verbose")
    code, out, err = run("merge", *words, "--json", folder / "report.json")
    assert (code, err) == (0, "")
    written = bundle.load(folder / "out")
    assert written.num_observations == expected.problem.num_observations
    assert written.image_names == expected.problem.image_names
    found = table(out)
    assert " ".join(found["shared"]).startswith("2 images")
    assert found["joined points"][-1] == str(expected.counts.num_points_joined)
    assert "bundle refine" in out
    report = json.loads((folder / "report.json").read_text())
    assert (report["command"], report["input"]["num_images"]) == ("merge", 5)
    assert report["other"]["num_images"] == 5
    assert report["merge"]["gauge"] == {"free_before": 14, "determined": 7, "free": 7}
    assert report["merge"]["similarity"]["scale"] == pytest.approx(0.4)
    assert report["merge"]["num_points_joined"] == expected.counts.num_points_joined
    assert report["merge"]["shared_images"] == ["image3.jpg", "image4.jpg"]
    assert report["output"]["format"] == "colmap"


def test_the_report_alone_goes_to_standard_output(run, models):
    folder, _ = models
    words = (folder / "a", folder / "b", "-o", f"{folder}/out/", "--quiet", "--json", "-")
    code, out, _ = run("merge", *words)
    assert code == 0 and json.loads(out)["merge"]["num_shared_images"] == 2
