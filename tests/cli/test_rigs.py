"""Rigs of several sensors on the command line."""

import json

import numpy as np
import pytest

import bundle
from tests.editing.test_rig_config import config, scattered, write
from tests.rig_scenes import STEREO, rig_problem


def test_on_the_command_line(tmp_path, run):
    problem = scattered(rig_problem(), noise=0)
    bundle.save(problem, tmp_path / "in")
    path = write(tmp_path, config(2))
    done = run("convert", tmp_path / "in", tmp_path / "out", "--rig-config", path)
    assert done.code == 0, done.err
    assert bundle.load(tmp_path / "out").num_frames == 4
    done = run("info", tmp_path / "in", "--rig-config", path, "--json", "-")
    report = json.loads(done.out)
    assert report["input"]["num_rigs"] == 1
    sensors = report["rigs"][0]["sensors"]
    assert [sensor["is_reference"] for sensor in sensors] == [True, False]
    assert sensors[1]["baseline"] == pytest.approx(np.linalg.norm(STEREO[0][3:]))
    done = run("info", tmp_path / "in", "--rig-config", write(tmp_path, "[]"))
    assert done.code == 2


def test_a_sequence_takes_no_rig_configuration(tmp_path, run):
    assert run("synth", tmp_path / "s", "--scene", "flight", "--duration", "3").code == 0
    done = run("info", tmp_path / "s", "--rig-config", write(tmp_path, config(2)))
    assert done.code == 2
    assert "--rig-config: valid only with a reconstruction, found a sequence" in done.err
