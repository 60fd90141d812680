"""Everything but conversion from and to pycolmap's objects, in a process that cannot import it."""

import json
import subprocess
import sys

import pytest

BLOCKED = """
import copy, pickle, sys
from pathlib import Path

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "pycolmap":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocker())
import bundle
from bundle.cli.main import main
folder = Path(sys.argv[1])
"""


def run(folder, script):
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED + script, str(folder)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_models_are_read_solved_copied_and_written(tmp_path):
    run(
        tmp_path,
        """
import numpy as np
scene = bundle.synthesize(num_images=6, num_points=60, seed=3).problem
bundle.save(scene, folder / "model", "colmap")
bundle.save(scene, folder / "text", "colmap-text")
bundle.save(scene, folder / "bal.txt")
for name in ("model", "text", "bal.txt"):
    problem = bundle.load(folder / name)
    for again in (pickle.loads(pickle.dumps(problem)), copy.deepcopy(problem)):
        assert (again.points == problem.points).all() and again.format == problem.format
        bundle.save(again, folder / "again", "colmap")
        back = bundle.load(folder / "again")
        assert back.image_names == problem.image_names or name == "bal.txt"
    result = bundle.solve(problem, max_num_iterations=3)
    pickle.loads(pickle.dumps(result))
    bundle.save(result.problem, folder / "solved.txt", "bal")
problem = bundle.load(folder / "model")
bundle.describe(problem), bundle.diagnose(problem), bundle.covariance(problem)
bundle.change_camera_model(problem, "OPENCV")
bundle.report(result, folder / "report.html")
bundle.close_loops
""",
    )


COMMANDS = (
    "info IN",
    "convert IN OUT --format colmap-text",
    "convert IN OUT.txt",
    "refine IN -o OUT2 --max-iterations 3 --camera-model OPENCV --json JSON",
    "diagnose IN",
    "covariance IN -o OUT.npz",
    "inspect IN",
    "report IN -o OUT.html",
    "evaluate IN --reference IN",
    "merge IN IN -o OUT3",
    "validate IN",
    "align IN -o OUT4 --reference IN",
)


def test_commands(tmp_path):
    places = ("IN", "JSON", "OUT.txt", "OUT.npz", "OUT.html", "OUT", "OUT2", "OUT3", "OUT4")
    given = {word: str(tmp_path / word.lower()) for word in places}
    given["JSON"] += ".json"
    lines = [[given.get(word, word) for word in words.split()] for words in COMMANDS]
    run(
        tmp_path,
        f"""
bundle.save(bundle.synthesize(num_images=6, num_points=60, seed=3).problem, folder / "in", "colmap")
for words in {json.dumps(lines)}:
    code = main([*words, "--quiet"])
    assert code == 0, (code, words)
    assert "pycolmap" not in sys.modules, words
""",
    )


def test_a_visual_inertial_sequence(tmp_path):
    run(
        tmp_path,
        """
assert main(["synth", str(folder / "s"), "--scene", "flight", "--duration", "3", "--quiet"]) == 0
sequence = bundle.load_sequence(folder / "s")
assert sequence.calibration.camera_model
import numpy as np
assert np.isfinite(sequence.normalized()).all()
""",
    )


def test_what_needs_it_says_so_in_one_line(tmp_path):
    printed = run(
        tmp_path,
        """
bundle.save(bundle.synthesize(num_images=6, num_points=60, seed=3).problem, folder / "in", "colmap")
problem = bundle.load(folder / "in")
for call in (
    lambda: problem.source,
    problem.to_pycolmap,
    lambda: bundle.Problem.from_pycolmap(None),
    lambda: bundle.bundle_adjustment(None),
):
    try:
        call()
    except bundle.InputError as error:
        print(error)
""",
    )
    lines = printed.splitlines()
    assert len(lines) == 4
    assert all("expected the package pycolmap" in line for line in lines)


def test_pixels_are_inverted_as_by_pycolmap(monkeypatch):
    import numpy as np

    from bundle.model.lenses import exact_image
    from tests.formulas import PARAMS

    rng = np.random.default_rng(4)
    for model in ("SIMPLE_RADIAL", "OPENCV", "OPENCV_FISHEYE", "FOV"):
        xy = rng.uniform(100, 500, (50, 2))
        expected = exact_image.normalized(model, PARAMS[model], xy)
        with monkeypatch.context() as patch:
            patch.setattr(exact_image, "has_pycolmap", lambda: False)
            found = exact_image.normalized(model, PARAMS[model], xy)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-7), model
