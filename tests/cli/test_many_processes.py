"""`mpirun -n N bundle refine`, from the outside; tests/solving/ranks has the steps, without MPI."""

import json
import os
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from tests.graphs.loops.drift import closures_of, drifted_street
from tests.scenes import scene
from tests.solving.ranks.mpirun import MPIRUN
from tests.solving.ranks.mpirun import mpirun_command as command


@pytest.fixture(scope="session", autouse=True)
def _installed():
    if MPIRUN.exists() and shutil.which(MPIRUN):
        return
    if os.environ.get("CI") == "true":
        pytest.fail("the extra mpi is not installed")
    pytest.skip("needs the extra mpi")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("mpi") / "model.txt"
    bundle.save(scene(), path)
    return path


def mpirun(num_processes, *words, script=None, cwd=None, **environment):
    line = command(num_processes, *words)
    if script is not None:
        at = line.index("-m")
        line[at : at + 2] = [str(script)]
    done = subprocess.run(
        line,
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"} | environment,
    )
    return done.returncode, done.stdout, done.stderr


def error_lines(text):
    return [line for line in text.splitlines() if line.startswith("error: ")]


def test_refines_as_one_process_does(model, tmp_path):
    output, report = tmp_path / "refined.txt", tmp_path / "report.json"
    words = ("refine", model, "-o", output, "--json", report, "--threads", 1, "--verbose")
    code, out, err = mpirun(3, *words)
    assert (code, error_lines(err)) == (0, [])
    assert out.count("RMSE [px]") == 2  # before and after, and of the worst images
    assert "messages and waiting" in out
    alone = bundle.solve(model, num_threads=1)
    given = json.loads(report.read_text())
    costs = [step["cost"] for step in given["iterations"]]
    np.testing.assert_allclose(costs, alone.iterations["cost"], rtol=1e-9)
    assert given["summary"]["num_processes"] == 3
    assert len(given["summary"]["processes"]["parts"]) == 3
    np.testing.assert_allclose(bundle.load(output).points, alone.problem.points, atol=1e-6)


def test_a_colmap_model_in_slices_and_without_pycolmap(model, tmp_path):
    source, output, report = (tmp_path / name for name in ("model", "out", "report.json"))
    bundle.save(bundle.load(model), source, "colmap")
    script = tmp_path / "looks.py"
    script.write_text(
        "import sys\nfrom bundle.__main__ import run\n"
        "code = run()\nsys.exit(9 if 'pycolmap' in sys.modules else code)\n"
    )
    words = ("refine", source, "-o", output, "--json", report, "--threads", 1)
    code, _, err = mpirun(2, *words, script=script)
    assert (code, error_lines(err)) == (0, [])
    given = json.loads(report.read_text())
    alone = bundle.solve(source, num_threads=1)
    costs = [step["cost"] for step in given["iterations"]]
    np.testing.assert_allclose(costs, alone.iterations["cost"], rtol=1e-9)
    assert given["output"]["format"] == "colmap"
    parts = given["summary"]["processes"]["parts"]
    assert sum(part["num_points"] for part in parts) == alone.problem.num_points
    np.testing.assert_allclose(bundle.load(output).points, alone.problem.points, atol=1e-6)


@pytest.mark.parametrize(
    ("num_processes", "strategy"),
    [(2, "dogleg"), (3, "levenberg-marquardt"), (4, "dogleg")],
)
def test_files_are_those_of_one_process(model, tmp_path, num_processes, strategy):
    """Twofold sums go up a tree, which has two levels from three processes on."""
    words = ("refine", model, "--solver", "sparse-schur", "--trust-region", strategy)
    alone, divided = tmp_path / "alone.txt", tmp_path / "divided.txt"
    assert main([*map(str, words), "-o", str(alone), "--quiet"]) == 0
    code, _, err = mpirun(num_processes, *words, "-o", divided)
    assert (code, error_lines(err)) == (0, [])
    assert divided.read_bytes() == alone.read_bytes()


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("info", "MODEL"), "info"),
        (("refine", "nowhere.txt", "-o", "OUTPUT"), "nowhere.txt"),  # before any solve
        (("refine", "MODEL", "-o", "OUTPUT", "--fix-points", "999999"), "999999"),  # within one
        (("refine", "MODEL", "-o", "OUTPUT", "--loops", "x.g2o"), "x.g2o"),
    ],
)
def test_one_line_of_one_process(model, tmp_path, words, found):
    output = tmp_path / "refined.txt"
    names = {"MODEL": model, "OUTPUT": output}
    code, out, err = mpirun(2, *(names.get(word, word) for word in words))
    assert (code, out) == (2, "")
    (line,) = error_lines(err)
    assert found in line
    assert "Traceback" not in err
    assert not output.exists()


@pytest.mark.parametrize("kind", ["bal", "colmap"])  # which slices would be read of
def test_ceres_solves_in_one_process(model, tmp_path, kind):
    source, output, report = (tmp_path / name for name in ("model", "out", "report.json"))
    bundle.save(bundle.load(model), source, kind)
    words = ("refine", source, "-o", output, "--json", report, "--threads", 1)
    code, out, err = mpirun(2, *words, "--solver", "dense-qr")
    assert (code, error_lines(err)) == (0, [])
    assert "the other one waited" in " ".join(out.split())
    given = json.loads(report.read_text())
    alone = bundle.solve(source, num_threads=1, linear_solver_type="dense_qr")
    assert [step["cost"] for step in given["iterations"]] == alone.iterations["cost"].tolist()
    assert given["summary"]["warning_kinds"] == ["one_process"]


def test_a_pose_graph_is_one_process_work(tmp_path):
    lines = [f"VERTEX_SE2 {i} {i} {0.1 * i} 0" for i in range(4)]
    lines += [f"EDGE_SE2 {i} {i + 1} 1 0 0 1 0 0 1 0 1" for i in range(3)]
    graph, output = tmp_path / "graph.g2o", tmp_path / "out.g2o"
    graph.write_text("\n".join(lines) + "\n")
    code, _, err = mpirun(3, "refine", graph, "-o", output)
    assert (code, error_lines(err)) == (0, [])
    assert err.count("note: one of 3 processes") == 1
    assert output.exists()


def test_loops_are_closed_by_one_process_and_the_rest_is_divided(tmp_path):
    truth, model, scales = drifted_street()
    bundle.save(model, tmp_path / "model", "colmap")
    bundle.save(closures_of(truth, scales, 8, wrong=2), tmp_path / "x.g2o")
    reports = [tmp_path / "alone.json", tmp_path / "divided.json"]
    words = ("refine", tmp_path / "model", "-o", tmp_path / "out", "--loops", tmp_path / "x.g2o")
    words = (*words, "--threads", 1, "--json")
    for n, report in zip((1, 3), reports, strict=True):
        code, _, err = mpirun(n, *words, report)
        assert (code, error_lines(err)) == (0, [])
    alone, divided = (json.loads(report.read_text()) for report in reports)
    assert divided["loops"] == alone["loops"]
    assert divided["summary"]["num_processes"] == 3
    costs = [[step["cost"] for step in of["iterations"]] for of in (alone, divided)]
    np.testing.assert_allclose(*costs, rtol=1e-9)


def test_a_process_that_fails_alone_ends_all(model, tmp_path):
    """As one does that has too little memory."""
    script = tmp_path / "fails.py"
    script.write_text(
        "import os, sys, bundle.solving.slices.slice_process as c\n"
        "def fail(*given):\n"
        "    raise MemoryError('no room')\n"
        "if os.environ['OMPI_COMM_WORLD_RANK'] == '1': c.work_on = fail\n"
        "from bundle.__main__ import run\n"
        "sys.exit(run())\n"
    )
    code, _, err = mpirun(2, "refine", model, "-o", tmp_path / "refined.txt", script=script)
    assert code != 0
    (line,) = error_lines(err)
    assert "process 1 of 2" in line
    assert "no room" in line
    assert not (tmp_path / "refined.txt").exists()


def test_without_mpi4py(model, tmp_path):
    (tmp_path / "mpi4py").mkdir()
    (tmp_path / "mpi4py" / "__init__.py").write_text("raise ImportError('gone')\n")
    code, _, err = mpirun(2, "refine", model, "-o", tmp_path / "r.txt", PYTHONPATH=str(tmp_path))
    assert code == 2
    (line,) = error_lines(err)
    assert "found no mpi4py" in line


def test_killed_process_and_resume(model, tmp_path):
    """Without one of them all end soon; the checkpoint is whole and leads to the same end."""
    script = tmp_path / "dies.py"
    script.write_text(DIES_IN_THE_THIRD_SOLVE)
    options = ("--deterministic", "--checkpoint-interval", "1", "--threads", "1")
    checkpoint = tmp_path / "run.npz"
    words = ("refine", model, "-o", tmp_path / "killed.txt", *options, "--checkpoint", checkpoint)
    begun = time.monotonic()
    code, _, err = mpirun(2, *words, script=script)
    assert code != 0
    assert time.monotonic() - begun < 50  # the process dies after a second or two
    assert error_lines(err) == ["error: process 1 of 2 was lost"]
    assert not (tmp_path / "killed.txt").exists()
    ends = []
    for name, more in (("resumed", ("--resume", checkpoint)), ("whole", ("--checkpoint", "c.npz"))):
        output = tmp_path / f"{name}.txt"
        code, _, err = mpirun(2, "refine", model, "-o", output, *options, *more, cwd=tmp_path)
        assert (code, error_lines(err)) == (0, [])
        ends.append(output.read_bytes())
    assert ends[0] == ends[1]


def test_ctrl_c_ends_all_with_one_line(tmp_path):
    model = tmp_path / "model.txt"  # of which the steps take longer than a look at the checkpoint
    scene = {"num_images": 30, "num_points": 20_000, "mean_track_length": 8.0, "seed": 5}
    bundle.save(bundle.synthesize(**scene).problem, model, format="bal")
    checkpoint, output = tmp_path / "run.npz", tmp_path / "refined.txt"
    options = ("--function-tolerance", 0, "--gradient-tolerance", 0, "--parameter-tolerance", 0)
    often = ("--checkpoint", checkpoint, "--checkpoint-interval", 1)
    run = subprocess.Popen(
        command(2, "refine", model, "-o", output, "--threads", 1, *options, *often),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "2"},  # libraries have threads of their own
    )
    while not checkpoint.exists() and run.poll() is None:
        time.sleep(0.01)
    run.send_signal(signal.SIGINT)
    _, err = run.communicate(timeout=30)
    assert run.returncode != 0
    (line,) = error_lines(err)
    assert "Ctrl-C" in line
    assert not output.exists()


def test_sigusr1_ends_a_solve_as_ctrl_c_does_in_one_process(model, tmp_path):
    script = tmp_path / "told.py"
    script.write_text(ALL_ARE_TOLD_IN_THE_SECOND_STEP)
    output = tmp_path / "refined.txt"
    code, out, err = mpirun(2, "refine", model, "-o", output, "--threads", 1, script=script)
    assert (code, error_lines(err)) == (1, [])
    assert "nterrupted" in out
    assert bundle.load(output).num_points == bundle.load(model).num_points


DIES_IN_THE_THIRD_SOLVE = """
import os, signal, sys
import bundle.solving.ranks.mpi_crew as crew
import bundle.solving.slices.slice_process as slices
work_on, solves = slices.work_on, []

class Dying(crew.MpiRanks):
    def sum_double_doubles_to_first(self, what, *values):
        if len(solves) == 3 and what == "normal equations":
            os.kill(os.getpid(), signal.SIGKILL)
        super().sum_double_doubles_to_first(what, *values)

def work(*given):
    solves.append(given)
    return work_on(*given)

if os.environ["OMPI_COMM_WORLD_RANK"] == "1":
    slices.work_on, crew.MpiRanks = work, Dying
from bundle.__main__ import run
sys.exit(run())
"""

# mpirun passes the signal on to all processes.
ALL_ARE_TOLD_IN_THE_SECOND_STEP = """
import os, signal, sys
import bundle.solving.ranks.mpi_crew as crew
sums = []

class Told(crew.MpiRanks):
    def sum_double_doubles_to_first(self, what, *values):
        sums.append(what)
        if sums.count("normal equations") == 4:
            os.kill(os.getpid(), signal.SIGUSR1)
        super().sum_double_doubles_to_first(what, *values)

crew.MpiRanks = Told
from bundle.__main__ import run
sys.exit(run())
"""
