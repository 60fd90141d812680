"""The command line on exports of learned reconstructions."""

import json

import bundle
from tests.io.formats.learned_exports import export, truth


def test_points_of_one_image_each_are_not_refined(run, tmp_path):
    single = tmp_path / "single"
    bundle.save(export(truth(0), "single", 5), single)
    refined = tmp_path / "refined"
    for arguments in (("refine", single, "-o", refined), ("compare", single)):
        code, out, err = run(*arguments, "--quiet")
        assert code == 2
        assert (out, err.count("\n")) == ("", 1)
        assert "single" in err
        assert "4500 points" in err
    assert not refined.exists()
    # Known points determine a pose each.
    for known in (("--refine", "poses"), ("--set", "point 1: position fixed")):
        assert run("refine", single, "-o", refined, *known, "--overwrite", "--quiet").code == 0


def test_common_lens_of_pairs_is_named(run, tmp_path):
    pairs = tmp_path / "pairs"
    bundle.save(export(truth(0), "pairs", 5), pairs)
    out = tmp_path / "refined"
    assert run("refine", pairs, "-o", out, "--quiet").code == 0
    text = run("info", out, "--json", "-", "--quiet").out
    assert "shared_lens" in {finding["kind"] for finding in json.loads(text)["findings"]}
