"""One whole text of each report: the one place where its wording is held.

After a change of words, UPDATE_GOLDEN=1 writes the texts anew; read what git shows as changed.
Other tests look at kinds, columns and numbers.
"""

from __future__ import annotations

import os
import re
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from bundle import _core
from bundle.analysis.statistics.description import describe
from bundle.base.tables import render
from bundle.cli.scenes import _tally
from bundle.georeference.alignment import align
from bundle.graphs.factors.checks import check_jacobians
from bundle.interface.finding import one_list
from bundle.interface.judging_options import EvaluateOptions
from bundle.interface.options import SolveOptions
from bundle.interface.scene_options import SceneOptions
from bundle.interface.summary import sentence
from bundle.judging.evaluation.evaluate_models import evaluate
from bundle.judging.findings.find import find
from bundle.planning.inspection.graph_inspection import inspect_graph
from bundle.planning.inspection.problem_inspection import inspect
from bundle.planning.inspection.rank_prediction import NETWORK
from bundle.reports.sections import Report
from bundle.reports.terminal import analyses, compare, judged, outputs, refine
from bundle.reports.terminal import inspect as inspect_report
from bundle.reports.terminal.screen import laid_out
from bundle.reports.terminal.solve_data import WallTime
from bundle.synthetic.synthesis import synthesize
from tests.figures.matplotlib.comparisons import comparison
from tests.georeference.blocks import block
from tests.judging.validation.validations import validation
from tests.reports.terminal import fakes
from tests.reports.terminal.test_report import ENDS
from tests.scenes import make_problem, scene

GOLDEN = Path(__file__).parent / "golden"
WIDTH = 80
OPTIONS = SolveOptions(num_threads=2)


def problem():
    """Two cameras, one of them shared; an image far off and a point seen once."""
    made = make_problem(model="RADIAL", num_images=6, num_points=20, track=4, format="colmap")
    poses = made.cam_from_world.copy()
    poses[2, 4] += 0.5
    return made.replace(cam_from_world=poses)


def informed(_):
    path, description = "garden/sparse/0", describe(problem())
    found = one_list(description.suspicions, find(problem(), source=path))
    return outputs.information(path, problem(), description, found)


def refined(_):
    moved = problem().camera_params * 1.01
    summary = fakes.summary(warnings=("The gauge could not be held.",))
    solved = fakes.result(
        problem().replace(camera_params=moved), initial_problem=problem(), summary=summary
    )
    wall = WallTime(load=0.25, build=0.125, solve=1.0, save=0.25, statistics=0.125, total=2.0)
    output = {"path": "out.txt", "format": "bal"}
    return refine.refinement("garden/sparse/0", problem(), solved, wall, output, ("Names.",))


def compared(_):
    return compare.compared(comparison(name="garden.txt"))


def inspected(_):
    options = OPTIONS
    return inspect_report.inspected(
        "garden/sparse/0", problem(), inspect(problem(), options), options, (), (), NETWORK, 0.0
    )


def eliminated(_):
    return inspect_report.inspected_steps(
        "cycle.txt", inspect_graph([(i, (i + 1) % 6) for i in range(6)], 6), 0.0
    )


def checked(monkeypatch):
    original = _core.check_reprojections

    def spoilt(*arguments):
        analytic, *others = original(*arguments)
        analytic[..., 9] *= 2
        return (analytic, *others)

    monkeypatch.setattr(_core, "check_reprojections", spoilt)
    return analyses.checked(
        "garden/sparse/0", problem(), check_jacobians(problem(), num_threads=1), {}, 0.0
    )


def converted(_):
    lost = ("Image names are left out.", "Colours are left out.")
    output = {"path": "garden.txt", "format": "bal"}
    return outputs.converted("garden/sparse/0", scene(), output, lost)


def aligned(_):
    flight = block(6, pixel_noise=0.5, survey_noise=0.02)
    x, y, z = flight.gcps[2].position
    object.__setattr__(flight.gcps[2], "position", (x + 1.0, y, z))
    object.__setattr__(flight.gcps[5], "measurements", flight.gcps[5].measurements[:1])
    found = align(flight.problem, gcps=flight.gcps, check_points=["t4"])
    output = {"path": "placed/", "format": "colmap"}
    return outputs.alignment("garden/sparse/0", flight.problem, found, output, ())


def synthesized(_):
    options = SceneOptions(num_images=5, num_points=40, mean_track_length=3.0)
    made = synthesize(options)
    output, truth = ({"path": path, "format": "colmap"} for path in ("s", "s_ground_truth"))
    num_cameras = made.problem.num_cameras
    return outputs.synthesized(options, num_cameras, _tally(made), output, truth)


def normalised(text):
    """Without what differs between machines: rounding errors, and how many lines they take."""
    text = re.sub(r"\d[\d.]*(e[-+]\d+)?", "0", text)
    lines = (re.sub(r" +", " ", re.sub("#+", "|", line)) for line in text.splitlines())
    return "".join(f"{line}\n" for line, _ in groupby(lines))


def terminated(_):
    ends = [*ENDS, {"interrupted": True, "termination_type": "USER_SUCCESS"}]
    return [sentence(fakes.summary(**end), 5, 2) for end in ends]


def evaluated(_):
    """A model with a lens of its own, two images far off, against its truth."""
    truth = make_problem(num_images=12, perturbation=0, shared=True, format="colmap")
    poses = truth.cam_from_world.copy()
    poses[:, 4:] += 0.01 * np.random.default_rng(0).standard_normal((12, 3))
    poses[[2, 7], 4] += [0.5, 0.3]
    names = tuple(f"other/{name}" for name in truth.image_names)
    lens = truth.camera_params * [[1.02, 1, 1, 1]]
    made = truth.replace(cam_from_world=poses, camera_params=lens, image_names=names)
    options = EvaluateOptions(align="rigid")
    found = evaluate(made, truth, options)
    return judged.evaluated(("refined", "truth"), found, options)


def validated(_):
    made, found = validation()
    return judged.validated("garden/sparse/0", made, found, {})


REPORTS = {
    "validate": validated,
    "evaluate": evaluated,
    "termination": terminated,
    "info": informed,
    "refine": refined,
    "compare": compared,
    "inspect": inspected,
    "inspect_graph": eliminated,
    "check": checked,
    "convert": converted,
    "align": aligned,
    "synth": synthesized,
}


@pytest.mark.parametrize("name", REPORTS)
def test_report(name, monkeypatch):
    monkeypatch.setattr(_core, "available_memory", lambda: 16e9)
    monkeypatch.setattr(_core, "CERES_VERSION", "2.1.0")
    made = REPORTS[name](monkeypatch)
    text = render(*(laid_out(made) if isinstance(made, Report) else made), width=WIDTH)
    if name in ("align", "check", "inspect"):
        text = normalised(text)
    path = GOLDEN / f"{name}.txt"
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(text)
    assert text == path.read_text()
