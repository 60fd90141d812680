"""`bundle demo`: a scene that comes with the package, refined within two seconds."""

import json
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.cli import scenes

ROOT = Path(__file__).parents[2]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_scene_is_that_of_the_sources_and_small() -> None:
    source = ROOT / "data" / "street_colmap"
    with zipfile.ZipFile(scenes._SCENE) as packed:
        assert {n: packed.read(n) for n in packed.namelist()} == {
            path.name: path.read_bytes() for path in source.iterdir()
        }
    assert scenes._SCENE.stat().st_size < 1e6


def test_a_page_and_a_better_model_within_two_seconds(here, run) -> None:
    start = time.process_time()
    done = run("demo")
    assert time.process_time() - start < 4  # CPU time of a loaded machine; 1 s of a quiet one
    assert done.code == 0, done.err
    assert done.out.splitlines()[-1].strip() == (here / "bundle_demo/report.html").as_uri()
    assert "<html" in (here / "bundle_demo/report.html").read_text()[:200]
    after = bundle.load(here / "bundle_demo/refined")
    errors = bundle.reprojection_errors(after)[0]
    assert (
        np.sqrt(np.mean(errors**2)) < 1
        and after.image_names == bundle.load(here / "bundle_demo/scene").image_names
    )
    again = run("demo", "--json", "-", "--quiet")
    report = json.loads(again.out)
    assert again.code == 0 and report["command"] == "refine"


def test_other_files_stay(here, run) -> None:
    (here / "mine" / "scene").mkdir(parents=True)
    (here / "mine" / "scene" / "cameras.bin").write_text("mine")
    done = run("demo", "mine")
    assert done.code == 2 and "expected a new or empty folder" in done.err
    assert (here / "mine" / "scene" / "cameras.bin").read_text() == "mine"
    assert [path.name for path in (here / "mine").iterdir()] == ["scene"]
    (here / "file").write_text("x")
    assert run("demo", "file").code == 2
