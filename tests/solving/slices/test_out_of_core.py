"""Observations and points on disk: the bits of the solve in memory, and memory that is bounded."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks.out_of_core import TRACK_LENGTH, write_scene

import bundle
import bundle._core as _core
from bundle.errors import InputError
from bundle.solving import kept_errors
from bundle.solving.kept_errors import PixelErrors
from bundle.solving.slices import slice_process, slice_reading, sliced_refinement
from bundle.solving.slices.scratch_size import scratch_bytes
from bundle.solving.slices.sliced_refinement import scratch_folder
from tests.cli.conftest import command, environment, run  # noqa: F401
from tests.rig_scenes import rig_problem

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs the memory of Linux")

PLAIN = {"seed": 3, "num_images": 30, "num_points": 2000, "pixel_noise": 0.7, "outlier_share": 0.03}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A BAL file, and COLMAP models of one shared camera and of a rig."""
    folder = tmp_path_factory.mktemp("out_of_core")
    bal = bundle.synthesize(**PLAIN, camera_model="RADIAL", cameras="individual").problem
    shared = bundle.synthesize(**PLAIN, camera_model="OPENCV").problem
    paths = {name: folder / name for name in ("bal.txt", "shared", "rig")}
    bundle.save(bal, paths["bal.txt"])
    bundle.save(shared, paths["shared"])
    bundle.save(rig_problem(), paths["rig"])
    return paths


def contents(path):
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return {file.name if path.is_dir() else "": file.read_bytes() for file in files}


def records(report):
    times = ("seconds", "time", "memory")
    iterations = report["iterations"]
    rows = iterations if isinstance(iterations, list) else [iterations]
    return [{k: v for k, v in row.items() if not any(t in k for t in times)} for row in rows]


@pytest.mark.parametrize(
    ("name", "flags"),
    [
        ("bal.txt", ["--solver", "dense-schur"]),
        ("bal.txt", ["--solver", "sparse-schur", "--loss", "cauchy"]),
        ("bal.txt", ["--solver", "iterative-schur"]),
        ("bal.txt", ["--solver", "iterative-schur", "--schur-complement", "implicit"]),
        ("bal.txt", ["--trust-region", "dogleg", "--solver", "dense-schur"]),
        ("shared", ["--solver", "dense-schur"]),
        ("shared", ["--solver", "sparse-schur", "--loss", "huber"]),
        ("rig", []),
    ],
)
def test_the_result_has_the_bits_of_the_solve_in_memory(run, inputs, tmp_path, name, flags):  # noqa: F811
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    written, reports = [], []
    for which, more in (("memory", []), ("disk", ["--out-of-core", scratch])):
        output, report = tmp_path / f"{which}{name}", tmp_path / f"{which}.json"
        common = ("-o", output, "--threads", 1, "--json", report, "--quiet", *flags)
        done = run("refine", inputs[name], *common, *more)
        assert done.code == 0, done.err
        assert list(scratch.iterdir()) == []
        written.append(contents(output))
        reports.append(json.loads(report.read_text()))
    assert written[0] == written[1]
    assert records(reports[0]) == records(reports[1])
    for when in ("before", "after"):
        first, second = (report["reprojection_error"][when] for report in reports)
        np.testing.assert_allclose(list(first.values()), list(second.values()), rtol=1e-12)
    assert reports[1]["out_of_core"]["peak_bytes_on_disk"] > 0 or name == "rig"  # tiny arrays


GROWTH = """
import re, sys
from pathlib import Path
from bundle.cli.main import main
from bundle.solving.slices import sliced_refinement
sliced_refinement.RESIDENT_BYTES = 1 << 24
code = main(sys.argv[1:])
print(code, re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
"""


def peak_of(words):
    """Return the peak memory of a command in bytes."""
    done = subprocess.run(
        [sys.executable, "-c", GROWTH, *map(str, words), "--overwrite"],
        env=environment(), capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    code, kilobytes = map(int, done.stdout.split()[-2:])
    assert code in (0, 1), done.stderr
    return 1024 * kilobytes


@pytest.mark.parametrize("kind", ["bal", "colmap"])
def test_memory_does_not_grow_with_the_observations(tmp_path, kind):
    peaks = {}
    for num_observations in (60_000, 900_000):
        path = tmp_path / f"scene{num_observations}.txt"
        write_scene(path, num_observations)
        if kind == "colmap":
            bundle.save(bundle.load(path), path.with_suffix(""), format="colmap")
            path = path.with_suffix("")
        output = path.with_name(f"refined_{path.name}")
        words = ["refine", path, "-o", output, "--quiet", "--max-iterations", 1, "--threads", 1]
        for where, more in (("memory", []), ("disk", ["--out-of-core", tmp_path])):
            peaks[where, num_observations] = peak_of(words + more)
    # On a busy machine pages are dropped late, which only adds to a peak: the least of three.
    for _ in range(2):
        if peaks["disk", 900_000] - peaks["disk", 60_000] >= 30e6:
            peaks["disk", 900_000] = min(peaks["disk", 900_000], peak_of(words + more))
    grown = {w: peaks[w, 900_000] - peaks[w, 60_000] for w in ("memory", "disk")}
    assert grown["memory"] > 50e6, grown
    assert grown["disk"] < 30e6, grown


def test_the_files_go_with_a_killed_process(tmp_path):
    code = (
        "import sys, time, numpy as np, bundle._core as c; c.open_scratch(sys.argv[1], 1 << 20);"
        "a = c.large_array(1 << 22, np.dtype('i8')); a[:] = 7; print(1, flush=True); time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], env=environment(), stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"1\n"
        assert list(tmp_path.iterdir()) == []
        child.kill()
    assert list(tmp_path.iterdir()) == []


def test_arrays_keep_their_contents_while_pages_are_dropped(tmp_path):
    rng = np.random.default_rng(0)
    _core.open_scratch(os.fsencode(tmp_path), 1 << 20)
    try:
        arrays = [
            _core.large_array(size, np.dtype(np.int64)) for size in (1, 700, 10**6, 4 * 10**6)
        ]
        expected = [rng.integers(0, 9, len(array)) for array in arrays]
        for _ in range(5):
            for array, values in zip(arrays, expected, strict=True):
                array[:] = values
                values[::3] += 1
                array[::3] += 1
        for array, values in zip(arrays, expected, strict=True):
            np.testing.assert_array_equal(array, values)
        used, most = _core.scratch_use()
        assert 40e6 < used <= most < 160e6
    finally:
        _core.close_scratch()
    del array, arrays
    assert _core.scratch_use()[0] == 0


@pytest.mark.parametrize("limit", [None, 2.0])
@pytest.mark.parametrize("spoilt", [False, True])
@pytest.mark.parametrize("cheirality", ["zero", "algebraic"])
def test_statistics_by_blocks_are_those_of_all(monkeypatch, limit, spoilt, cheirality):
    monkeypatch.setattr(slice_reading, "_BLOCK", 37)
    rng = np.random.default_rng(5)

    def errors(seed):
        values = np.abs(np.random.default_rng(seed).normal(0, 1.5, 1000))
        behind = rng.random(1000) < 0.02 if spoilt else np.zeros(1000, bool)
        if spoilt:
            values[rng.integers(0, 1000, 9)] = np.nan
        return PixelErrors(values, behind, cheirality)

    def copied(found):
        return PixelErrors(found.errors.copy(), found.behind.copy(), found.cheirality)

    before, after = errors(1), errors(2)
    expected = kept_errors.measure(copied(before), copied(after), None, limit)
    found = slice_process.measure_on_disk(copied(before), copied(after), limit)
    assert expected is not None
    for one, other in zip(numbers(found), numbers(expected), strict=True):
        assert one == pytest.approx(other, rel=1e-12, nan_ok=True)


def numbers(measured):
    kept = measured.kept
    inliers = [] if kept.inliers is None else list(vars(kept.inliers).values())
    parts = (measured.before, measured.after, kept.before, kept.after)
    return [*(v for part in parts for v in vars(part).values()), kept.num_observations, *inliers]


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--rounds", "2"], "--rounds"),
        (["--html", "page.html"], "--html"),
        (["--camera-model", "OPENCV"], "--camera-model"),
        (["--checkpoint", "run.npz"], "--checkpoint"),
        (["--only-images", "1"], "--only-images"),
        (["--check-gradients"], "--check-gradients"),
        (["--hold-out", "5"], "--hold-out"),
        (["--backend", "ceres"], "--backend"),
        (["--twists", "tied", "--twist-sigma", "0.01,0.05"], "--twists"),
    ],
)
def test_what_needs_all_of_input_is_refused_by_name(run, inputs, tmp_path, flags, named):  # noqa: F811
    done = run(
        "refine", inputs["shared"], "-o", tmp_path / "out", "--out-of-core", tmp_path, *flags
    )
    assert done.code == 2
    assert done.err.startswith("error: --out-of-core") and done.err.count("\n") == 1
    assert named in done.err
    assert not (tmp_path / "out").exists()


def test_folders_and_inputs_that_do_not_do(run, inputs, tmp_path, monkeypatch):  # noqa: F811
    def refused(source, target, folder):
        done = run("refine", source, "-o", target, "--out-of-core", folder, "--quiet")
        assert done.code == 2 and done.err.count("\n") == 1, done.err
        assert not target.exists()
        return done.err

    bal, out = inputs["bal.txt"], tmp_path / "out.txt"
    assert "expected a folder" in refused(bal, out, tmp_path / "missing")
    assert "expected a folder" in refused(bal, out, bal)
    if Path("/dev/shm").is_dir():
        assert "in memory" in refused(bal, out, "/dev/shm")
    text = tmp_path / "text"
    bundle.save(bundle.load(inputs["shared"]), text, format="colmap-text")
    assert "binary COLMAP model" in refused(text, tmp_path / "model", tmp_path)
    assert "format of INPUT" in refused(bal, tmp_path / "out.txt.gz", tmp_path)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
    assert "of free disk" in refused(bal, out, tmp_path)


def test_the_predicted_disk_bounds_the_measured_one(tmp_path):
    path, num_observations = tmp_path / "scene.txt", 900_000
    write_scene(path, num_observations)
    with scratch_folder(str(tmp_path)):
        refinement = sliced_refinement.OutOfCoreRefinement(path, str(tmp_path))
        refinement.solve(bundle.SolveOptions(max_num_iterations=1), None)
        _, most = _core.scratch_use()
    predicted = scratch_bytes(num_observations, num_observations // TRACK_LENGTH)
    assert 0.9 * predicted < most < 1.02 * predicted + (1 << 27)  # two segments of small arrays


def test_one_folder_at_a_time(tmp_path):
    with scratch_folder(str(tmp_path)):
        with pytest.raises(InputError, match="--out-of-core"), scratch_folder(str(tmp_path)):
            pass
        done = subprocess.run(
            command("--version"), env=environment(), capture_output=True, check=False, timeout=60
        )
        assert done.returncode == 0
