"""`bundle refine --colmap-options FILE` against the same options in pycolmap."""

import json

import pycolmap
import pytest

import bundle
from bundle.cli.main import main
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem


def refine(folder, ini, *flags):
    (folder / "project.ini").write_text(ini)
    words = ["refine", str(folder / "in"), "-o", str(folder / "out"), "--overwrite"]
    words += ["--quiet", "--colmap-options", str(folder / "project.ini")]
    code = main([*words, "--json", str(folder / "report.json"), *flags])
    return code, json.loads((folder / "report.json").read_text()) if code != 2 else None


@pytest.mark.parametrize(
    ("problem", "ini", "changes"),
    [
        (make_problem, "[BundleAdjustment]\nrefine_principal_point=1\n", {"principal_point": True}),
        (make_problem, "[BundleAdjustment]\nrefine_focal_length=0\n", {"focal_length": False}),
        (rig_problem, "[BundleAdjustment]\nrefine_focal_length=0\n", {"focal_length": False}),
        (
            make_problem,
            "[BundleAdjustment]\nconstant_rig_from_world_rotation=1\nrefine_focal_length=0\n",
            {"focal_length": False, "rotation": True},
        ),
    ],
)
def test_minimum_of_pycolmap(tmp_path, problem, ini, changes, capsys):
    bundle.save(problem(), tmp_path / "in", "colmap")
    flags = ["--gauge", "two-cameras"] if "rotation" in changes else []
    code, report = refine(tmp_path, ini, *flags)
    assert code == 0
    reconstruction = pycolmap.Reconstruction(tmp_path / "in")
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_principal_point = changes.get("principal_point", False)
    options.refine_focal_length = changes.get("focal_length", True)
    options.constant_rig_from_world_rotation = changes.get("rotation", False)
    summary = bundle.bundle_adjustment(reconstruction, options)
    cost = summary.ceres_summary.final_cost
    assert report["summary"]["final_cost"] == pytest.approx(cost, rel=1e-9)
    capsys.readouterr()


def test_flags_replace_the_file(tmp_path, capsys):
    bundle.save(make_problem(), tmp_path / "in", "colmap")
    ini = "[BundleAdjustmentCeres]\nmax_num_iterations=1\ngradient_tolerance=1e-3\n"
    _, report = refine(tmp_path, ini, "--max-iterations", "9", "--refine", "poses,points")
    assert report["options"]["max_num_iterations"] == 9
    assert report["options"]["refine"] == ["poses", "points"]
    assert report["options"]["gradient_tolerance"] == 1e-3
    capsys.readouterr()


@pytest.mark.parametrize(
    ("ini", "message"),
    [
        ("[BundleAdjustment]\nmin_track_length=3\n", "min_track_length: expected at most 2"),
        ("[BundleAdjustment]\nnew=3\n", "project.ini:2: BundleAdjustment.new: expected an option"),
    ],
)
def test_what_no_flag_expresses_is_refused(tmp_path, ini, message, capsys):
    bundle.save(make_problem(), tmp_path / "in", "colmap")
    assert refine(tmp_path, ini)[0] == 2
    assert not (tmp_path / "out").exists()
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert error.count("\n") == 1
