from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import bundle
from benchmarks import bal, synthetic


def test_a_scene_is_made_once_and_is_what_its_problem_says(tmp_path):
    problem = synthetic.problem(synthetic.SCENES[0], tmp_path)
    synthetic.ensure(problem)
    made = bal.read(problem.path)
    assert len(made.cameras) == problem.num_images
    assert len(made.xy) == pytest.approx(problem.num_observations, rel=0.01)
    assert np.bincount(made.point_index).min() >= 2
    assert [path.name for path in tmp_path.iterdir()] == [problem.path.name]
    before = problem.path.stat()
    synthetic.ensure(problem)
    assert problem.path.stat() == before


def test_files_are_named_for_what_they_hold(tmp_path):
    scene = synthetic.SCENES[0]
    longer = dataclasses.replace(scene, num_observations=scene.num_observations + 5)
    assert scene.path(tmp_path) == scene.path(tmp_path)
    assert scene.path(tmp_path) != longer.path(tmp_path)
    names = [scene.name for scene in synthetic.SCENES]
    assert len(set(names)) == len(names)


def test_a_generator_that_fails_is_told(tmp_path):
    problem = dataclasses.replace(
        synthetic.problem(synthetic.SCENES[0], tmp_path), name="no-such-scene"
    )
    with pytest.raises(RuntimeError, match="no-such-scene: exit 1"):
        synthetic.ensure(problem)


def test_drives_one_way_differ_in_length_alone_and_laps_say_so():
    drives = [scene for scene in synthetic.SCENES if scene.kind == "street"]
    for scene in drives:
        assert scene.options()["loop_closure"] == scene.has_laps == scene.name.startswith("laps-")
    one_way = [scene for scene in drives if not scene.has_laps]
    assert len(one_way) > 3
    assert len({scene.num_observations // scene.num_images for scene in one_way}) == 1


def test_drives_start_at_a_tenth_of_the_generators_perturbation():
    defaults = {field.name: field.default for field in dataclasses.fields(bundle.SceneOptions)}
    for name, noise in synthetic.NEAR_START.items():
        assert noise == pytest.approx(0.1 * defaults[name])
