"""Comparisons read from JSON are those that were written, with all conditions."""

import dataclasses
import datetime
import json
import math
import platform

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.errors import InputError
from bundle.interface import environment
from bundle.interface.environment import Environment
from bundle.planning.comparison.compare_methods import compare
from bundle.reports.sections import dumps
from bundle.reports.terminal.compare import compared
from tests.figures.matplotlib.comparisons import comparison
from tests.planning.comparison import fakes
from tests.scenes import make_problem


@pytest.fixture
def written(tmp_path):
    def write(made):
        path = tmp_path / "comparison.json"
        path.write_text(dumps(compared(made).json()))
        return path

    return write


@pytest.mark.parametrize("num_problems", [1, 2])
def test_every_outcome_survives(written, num_problems):
    made = comparison(num_problems)
    path = written(made)
    read = bundle.read_comparison(path)
    assert compared(read).json() == json.loads(path.read_text())
    assert read.methods == made.methods and read.options == made.options
    for one, other in zip(read.runs, made.runs, strict=True):
        assert (one.outcome, one.message) == (other.outcome, other.message)
        for mine, its in zip(one.trace, other.trace, strict=True):
            assert np.array_equal(mine, its)


@pytest.mark.usefixtures("unpredicted")
def test_real_runs_survive(written, tmp_path):
    path = tmp_path / "scene.txt"
    bundle.save(make_problem(num_images=4, num_points=40, model="SIMPLE_RADIAL"), path)
    made = compare(
        path, solvers=["dense_schur", "dense_qr"], backends=["fused"], threads=[1], repeat=2,
        trust_regions=["dogleg"], perturb=0.01, seed=7, loss="huber", loss_scale=2.0,
    )  # fmt: skip
    read = bundle.read_comparison(written(made))
    assert compared(read).json() == compared(made).json()
    assert (read.perturb, read.seed, read.options.loss) == (0.01, 7, "huber")
    (run,) = (run for run in read.runs if run.is_usable)
    for measurement in run.measurements:
        assert 0 < measurement.cpu_per_wall <= _core.hardware_threads() + 1
        assert measurement.load >= 0
    totals = [measurement.total_time_in_seconds for measurement in run.measurements]
    assert (run.spread.min, run.spread.max) == (min(totals), max(totals))
    assert run.spread.relative == pytest.approx((max(totals) - min(totals)) / run.spread.median)
    report = json.loads(written(made).read_text())
    assert report["environment"]["versions"]["ceres"] == _core.CERES_VERSION
    assert report["runs"][0]["spread"]["num_repeats"] == 2


def test_conditions_are_complete(monkeypatch):
    monkeypatch.setattr(environment, "load_average", lambda: 1.25)
    begun = datetime.datetime.now(datetime.UTC)
    here = Environment.now()
    assert abs(datetime.datetime.fromisoformat(here.date) - begun).total_seconds() < 2
    assert here.cpu_model and here.num_cores == _core.hardware_threads()
    assert here.versions["python"] == platform.python_version()
    assert here.versions["bundle"] == bundle.__version__
    assert here.versions["os"].startswith(f"{platform.system()}-{platform.release()}")
    assert platform.libc_ver()[1] in here.versions["os"]
    assert any(character.isdigit() for character in here.versions["blas"])
    assert here.load_before == 1.25 and math.isnan(here.load_after)
    assert here.finished().load_after == 1.25


@pytest.mark.parametrize(
    ("load", "threads", "busy"), [(0.4, 2, False), (0.6, 2, True), (1.4, 1, False), (9, 1, True)]
)
def test_busy_machine(load, threads, busy):
    here = dataclasses.replace(Environment.now(), load_before=load, num_cores=2)
    assert here.is_busy(threads) is busy


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("no json", "found no JSON"),
        ("[1]", "found"),
        ('{"command": "refine"}', "found 'refine'"),
        ('{"command": "compare", "runs": []}', "pose graph"),
        ('{"command": "compare", "inputs": []}', "expected an entry"),
        (
            '{"command": "compare", "inputs": [1], "recommendation": null, "runs": [], '
            '"profiles": []}',
            "found other contents",
        ),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        bundle.read_comparison(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(OSError, match=r"missing\.json"):
        bundle.read_comparison(tmp_path / "missing.json")


def test_unknown_numbers_stay_unknown(written):
    made = fakes.comparison(fakes.done(fakes.DENSE), fakes.failed(fakes.CERES))
    done, failed = bundle.read_comparison(written(made)).runs
    assert math.isnan(done.distance_in_sigmas) and done.minimum == -1
    assert math.isnan(done.measurement.cpu_per_wall) and failed.spread is None
