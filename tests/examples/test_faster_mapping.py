"""The example that maps images with bundle's adjuster."""

import ast
import subprocess
import sys
from pathlib import Path

import pycolmap
import pytest

import bundle
from tests.track_scenes import synthesize

EXAMPLE = Path(__file__).parents[2] / "examples" / "faster_mapping" / "faster_mapping.py"


@pytest.mark.parametrize("rigs", [{}, {"num_cameras_per_rig": 2, "num_frames_per_rig": 7}])
def test_model_is_that_of_pycolmap(tmp_path, rigs):
    truth = synthesize(tmp_path, **rigs)
    database = tmp_path / "database.db"
    done = subprocess.run(
        [sys.executable, EXAMPLE, database, tmp_path / "sparse"],
        check=True, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    progress = [line for line in done.stderr.splitlines() if " images, " in line]
    assert progress[-1].startswith(f"{truth.num_images} images, ")
    options = pycolmap.IncrementalPipelineOptions(
        random_seed=0, multiple_models=False, extract_colors=False
    )
    (tmp_path / "mapped").mkdir()
    expected = pycolmap.incremental_mapping(database, tmp_path, tmp_path / "mapped", options)[0]
    found = pycolmap.Reconstruction(tmp_path / "sparse")
    assert found.is_valid()
    assert found.num_reg_images() == expected.num_reg_images() == truth.num_images
    assert abs(found.num_points3D() - expected.num_points3D()) <= 2
    counts = found.compute_num_observations(), expected.compute_num_observations()
    assert abs(counts[0] - counts[1]) <= 0.001 * counts[1]
    errors = [model.compute_mean_reprojection_error() for model in (found, expected)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)
    models = [bundle.Problem.from_pycolmap(model) for model in (found, expected)]
    difference = bundle.evaluate(*models).position.rmse
    assert difference < 0.1 * bundle.evaluate(models[1], truth).position.rmse


def test_it_has_at_most_sixty_lines_of_code():
    text = EXAMPLE.read_text()
    code = {number for number, line in enumerate(text.splitlines(), 1) if line.strip()}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.FunctionDef) and ast.get_docstring(node):
            code -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    assert 30 < len(code) <= 60
