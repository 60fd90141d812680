"""Reports of a summary with known numbers."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from bundle.base.tables import render
from bundle.base.words import number, pixels, plural, seconds
from bundle.interface.summary import sentence, solver_phases
from bundle.model.problem import Problem
from bundle.reports.sections import dumps, plain
from bundle.reports.terminal import refine
from bundle.reports.terminal.inputs import about_input
from bundle.reports.terminal.refine import refinement
from bundle.reports.terminal.screen import laid_out
from bundle.reports.terminal.solve_data import WallTime, result_data
from bundle.solving.parameter_changes import CameraChange
from tests.printed import figures
from tests.reports.terminal import fakes

WALL = WallTime(load=0.25, build=0.125, solve=1.0, save=0.25, statistics=0.125, total=2.0)

NO_FACTOR = {
    "num_factor_columns": None,
    "num_reduced_nonzeros": None,
    "num_factor_nonzeros": None,
    "factor_flops": None,
    "factor_ordering": "",
    "symbolic_time_in_seconds": None,
}


@pytest.fixture
def problem() -> Problem:
    return Problem(
        cam_from_world=np.array([[0, 0, 0, 1, 0, 0, 0]]),
        image_ids=np.array([3]),
        image_names=("a.jpg",),
        image_camera=np.array([0]),
        camera_ids=np.array([1]),
        camera_models=("SIMPLE_PINHOLE",),
        camera_params=np.array([[500.0, 320, 240]]),
        camera_sizes=np.array([[640, 480]]),
        points=np.array([[0.0, 0, 5]]),
        point_ids=np.array([9]),
        observation_image=np.array([0]),
        observation_point=np.array([0]),
        observation_xy=np.array([[320.0, 240]]),
        observation_keypoint=np.array([0]),
        format="colmap",
    )


def text_of(*arguments) -> str:
    return render(*laid_out(refinement(*arguments), verbose=True))


def rows(text: str) -> dict[str, list[str]]:
    """First column to the others, of a table whose columns are two blanks apart."""
    cells = (re.split(r" {2,}", line.strip()) for line in text.splitlines() if line.strip())
    return {first: rest for first, *rest in cells}


def test_breakdown_adds_up_to_the_total():
    table = rows(fakes.CONVERGED.breakdown())
    assert table["total"] == ["1.000", "100.0 %"]
    # 1 - (0.25 + 0.0625 + 0.125 + 0.25 + 0.0625)
    assert table["other"] == ["0.250", "25.0 %"]
    shares = [float(cells[1].rstrip(" %")) for name, cells in table.items() if name != "time"]
    assert sum(shares) == pytest.approx(200.0, abs=0.4)
    assert sum(time for _, time in solver_phases(fakes.CONVERGED)) == pytest.approx(1.0)


def test_times_that_ceres_did_not_measure_are_not_invented():
    unmeasured = fakes.summary(
        residual_evaluation_time_in_seconds=-1.0, postprocessor_time_in_seconds=-1.0
    )
    table = rows(unmeasured.breakdown())
    assert table["residual evaluation"] == ["-", "-"]
    assert table["postprocessor"] == ["-", "-"]
    assert table["other"] == ["0.375", "37.5 %"]


def test_breakdown_of_a_solve_that_took_no_time():
    nothing = dict.fromkeys(
        (f.name for f in dataclasses.fields(fakes.CONVERGED) if f.name.endswith("in_seconds")), 0.0
    )
    assert rows(fakes.summary(**nothing).breakdown())["total"] == ["0.000", "-"]


def test_full_report_has_ceres_sections_in_ceres_order():
    report = fakes.summary(
        warnings=("Group 0 lost a block.",), warning_kinds=("ordering_replaced",)
    ).full_report()
    order = ["66510", "LEVENBERG_MARQUARDT", "DENSE_SCHUR", "22106, 16", "4.185659518e+06"]
    order += ["1.803390348e+04", "0.250", "CONVERGENCE", "Group 0 lost a block."]
    positions = [report.index(words) for words in order]
    assert positions == sorted(positions)
    assert ["167436", "167434"] in rows(report).values()
    assert "4.167625615e+06" in report  # the change of cost
    assert "CONVERGENCE: Function tolerance reached." in report
    assert "preconditioner" not in report


def test_full_report_tells_of_the_factor():
    report = rows(fakes.CONVERGED.full_report())
    assert report["elimination order"] == ["natural"]
    assert report["columns"] == ["144"]
    assert report["nonzeros of the information matrix"] == ["4721598"]
    assert report["nonzeros of the reduced system"] == ["20736"]
    assert report["nonzeros of the factor"] == ["10440"]
    assert report["flops"] == ["1.0159e+06"]
    assert report["symbolic time [s]"] == ["0.000000"]
    none = rows(fakes.summary(**NO_FACTOR).full_report())
    for name in ("elimination order", "columns", "nonzeros of the factor", "flops"):
        assert none[name] == ["-"], name
    assert none["nonzeros of the information matrix"] == ["4721598"]


def test_report_of_a_refinement_tells_of_the_factor_where_there_is_one(problem):
    report = rows(text_of("in", problem, fakes.result(problem), WALL, None, ()))
    assert figures(report["factor"][0]) == ["144", "10440", "1.016e+06", "0.000"]
    assert "natural" in report["factor"][0]
    iterative = fakes.result(problem, summary=fakes.summary(**NO_FACTOR))
    assert "factor" not in rows(text_of("in", problem, iterative, WALL, None, ()))
    said = refinement("in", problem, iterative, WALL, None).json()["summary"]
    assert {name: said[name] for name in NO_FACTOR} == NO_FACTOR


def test_full_report_names_the_preconditioner_of_an_iterative_solver():
    report = fakes.summary(linear_solver_type_used="ITERATIVE_SCHUR").full_report()
    assert rows(report)["preconditioner"] == ["SCHUR_JACOBI", "IDENTITY"]
    assert rows(report)["linear algebra"] == ["EIGEN", "EIGEN"]


# How Ceres ends, and what it says then.
ENDS = [
    {"termination_type": kind, "message": message}
    for kind, message in [
        ("CONVERGENCE", "Function tolerance reached. |cost_change|/cost: 1 <= 2"),
        ("CONVERGENCE", "Function tolerance reached. No non-constant parameter blocks found."),
        ("CONVERGENCE", "Gradient tolerance reached. Gradient max norm: 1"),
        ("CONVERGENCE", "Parameter tolerance reached. Relative step_norm: 1"),
        ("CONVERGENCE", "Minimum trust region radius reached. Trust"),
        ("NO_CONVERGENCE", "Maximum number of iterations reached. Number: 5"),
        ("NO_CONVERGENCE", "Maximum solver time reached. Total: 5"),
        ("FAILURE", "Number of consecutive invalid steps more than 5"),
        ("FAILURE", "Residual and Jacobian evaluation failed."),
        ("FAILURE", "Initial residual and Jacobian evaluation failed."),
        ("FAILURE", "Linear solver failed due to unrecoverable"),
        ("FAILURE", "Something\nnew"),
    ]
]


def test_every_end_has_a_sentence_of_its_own():
    """One verdict a kind, one reason a message; golden/termination.txt has the words."""
    said = [sentence(fakes.summary(**end), 5, 2) for end in ENDS]
    assert len(set(said)) == len(ENDS)
    assert all(figures(one)[:2] == ["5", "2"] and "\n" not in one for one in said)
    verdicts = {
        (end["termination_type"], one.split(" 5 ")[0]) for end, one in zip(ENDS, said, strict=True)
    }
    assert len(verdicts) == 3
    # What Ceres says comes through only where it is not known.
    raw = [" ".join(end["message"].split()) in one for end, one in zip(ENDS, said, strict=True)]
    assert raw == [False] * 11 + [True]


def test_interruption_comes_before_what_ceres_calls_it():
    interrupted = fakes.summary(interrupted=True, termination_type="USER_SUCCESS", message="User")
    said = sentence(interrupted, 1)
    assert figures(said) == ["1"]
    assert said.split()[0] not in {sentence(fakes.summary(**one), 1).split()[0] for one in ENDS}


def test_report_of_a_refinement(problem):
    solved = fakes.result(problem)
    output = {"path": "out.txt", "format": "bal"}
    lost = ("image names",)
    report = text_of("[red]in", problem, solved, WALL, output, lost)
    table = rows(report)
    assert table["input"] == ["[red]in (COLMAP)"]  # not taken for a colour
    assert table["cost"] == ["4.185659518e+06", "1.803390348e+04"]
    assert table["RMSE [px]"] == ["10.0000", "1.0000"]
    assert table["behind camera"] == ["31", "0"]
    assert table["load"] == ["0.250", "12.5 %"]
    assert table["statistics"] == ["0.125", "6.2 %"]
    assert table["everything else"] == ["0.250", "12.5 %"]
    assert table["linear solver"] == ["0.250", "25.0 %", "12.5 %"]
    first = " ".join(report.split())
    assert figures(first)[:5] == ["2", "10.0000", "1.0000", "5.0000", "0.5000"]  # steps, errors
    assert "out.txt (BAL)" in report
    assert "image names" in report
    assert max(map(len, report.splitlines())) <= 100
    assert report.isascii()


def test_report_says_when_the_ordering_was_not_used_as_given(problem):
    changed = fakes.summary(linear_solver_ordering_used=(22000, 16))
    solved = fakes.result(problem, summary=changed)
    report = text_of("in", problem, solved, WALL, None, ())
    ordering = rows(report)["ordering"][0]
    assert re.findall(r"\d+(?=[, );])", ordering)[:4] == ["22000", "16", "22106", "16"]
    assert "out.txt" not in report


def test_what_is_held_has_a_line_of_its_own(problem):
    solved = fakes.result(problem)
    shown = "".join(rows(text_of("in", problem, solved, WALL, None, ())))
    assert "held cost" not in shown
    solved = fakes.result(problem, summary=fakes.summary(held_cost=233.25))
    report = rows(text_of("in", problem, solved, WALL, None, ()))
    assert report["held cost"] == ["-", "2.332500000e+02"]
    assert "233.2" in str(solved)
    assert "233.2" in str(solved.summary)
    assert "2.332500000e+02" in solved.summary.full_report()
    written = refinement("in", problem, solved, WALL, None).json()
    assert written["held_cost"] == written["summary"]["held_cost"] == 233.25


def test_json_has_what_the_contract_lists(problem):
    solved = fakes.result(problem)
    report = refinement("in", problem, solved, WALL, None).json()
    assert list(report) == [
        "schema",
        "command",
        "version",
        "input",
        "headline",
        "findings",
        "options",
        "summary",
        "iterations",
        "reprojection_error",
        "held_cost",
        "convergence",
        "deleted",
        "edits",
        "movement",
        "cameras",
        "worst_images",
        "wall_time",
        "environment",
        "output",
    ]
    assert set(report["input"].pop("digests")) == {"structure", "measurements", "start"}
    assert report["input"] == {
        "path": "in",
        "format": "colmap",
        "num_cameras": 1,
        "num_images": 1,
        "num_points": 1,
        "num_observations": 1,
    }
    assert report["summary"]["linear_solver_ordering_used"] == [22106, 16]
    assert report["options"]["linear_solver_type"] == "DENSE_SCHUR"
    assert report["options"]["refine"] == ["poses", "points", "focal", "extra"]
    assert set(report["options"]) == {field.name for field in dataclasses.fields(fakes.OPTIONS)}
    assert report["wall_time"] == {
        "load": 0.25,
        "build": 0.125,
        "solve": 1.0,
        "save": 0.25,
        "statistics": 0.125,
        "total": 2.0,
    }
    assert report["iterations"][1] == {
        "iteration": 1,
        "cost": 2.0,
        "cost_change": 1.0,
        "gradient_max_norm": 4.0,
        "step_norm": 1.0,
        "relative_decrease": 0.9,
        "trust_region_radius": 3e4,
        "linear_solver_iterations": 1,
        "step_is_successful": True,
        "iteration_time_in_seconds": 0.1,
        "cumulative_time_in_seconds": 0.2,
    }
    # nan and -inf of the fake's last iteration
    assert report["iterations"][2]["cost_change"] is None
    assert report["iterations"][2]["relative_decrease"] is None
    assert {**report, **plain(result_data(solved))} == report
    assert json.loads(dumps(report)) == report


def test_json_takes_any_path(problem):
    path = "caf\u00e9 \udcff"  # the second is how Python names a byte that is not UTF-8
    text = dumps({"input": about_input(path, problem)})
    assert text.isascii()
    assert json.loads(text)["input"]["path"] == path


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0, "0"), (3, "3"), (4.0949, "4.095"), (12345.6, "12346"), (1.5e7, "1.500e+07")],
)
def test_number(value, shown):
    assert number(value) == shown


def test_what_does_not_exist_is_a_dash():
    assert {number(math.nan), pixels(math.inf), seconds(-1.0), seconds(math.nan)} == {"-"}
    assert pixels(2.5e7) == "2.5000e+07"


def test_plural():
    assert [plural(n, "image") for n in (0, 1, 2)] == ["0 images", "1 image", "2 images"]


def test_the_fused_backend_is_named_and_so_is_what_it_does():
    fused = fakes.summary(
        backend_given="AUTO",
        backend_used="FUSED",
        backend_choice="It is the faster one.",
        instruction_set="avx2+fma",
    )
    table = rows(fused.breakdown())
    assert table["back-substitution, residuals"] == ["0.062", "6.2 %"]
    assert table["Jacobians, elimination"] == ["0.125", "12.5 %"]
    assert table["reduced linear solver"] == ["0.250", "25.0 %"]
    report = rows(fused.full_report())
    assert report["backend"] == ["AUTO", "FUSED"]
    assert report["why this backend"] == ["It is the faster one."]
    assert report["instruction set"] == ["avx2+fma", "avx2+fma"]
    assert "instruction set" not in fakes.CONVERGED.full_report()


@pytest.mark.parametrize(("count", "folded"), [(5, False), (6, True)])
def test_five_changed_cameras_are_shown_and_the_others_counted(count, folded):
    changes = [
        CameraChange(camera_id=i, model="M", before={"f": 1.0}, after={"f": 2.0}, movement=1.0)
        for i in range(count)
    ]
    text = render(*laid_out(refine._cameras(changes)), width=80)
    assert text.count(" M ") == 5
    assert ("1 other camera" in text) == folded
    assert ("other camera" in text) == folded


def test_only_a_usable_solution_has_converged():
    """A result that is dropped is told in the words of a solve that ended elsewhere."""
    end = {"termination_type": "CONVERGENCE", "message": "Parameter tolerance reached. 0 <= 0"}
    usable, dropped = (
        sentence(fakes.summary(**end, is_solution_usable=usable), 5) for usable in (True, False)
    )
    assert usable.split()[0] != dropped.split()[0]
    assert usable.split()[2:] == dropped.split()[2:]
