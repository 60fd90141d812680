"""`bundle refine` from the outside."""

import dataclasses
import json

import numpy as np
import pytest

import bundle
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary
from bundle.solving.result import Result
from tests.printed import figures, table
from tests.reports.terminal import fakes
from tests.scenes import scene

ITERATION = [
    "iteration",
    "cost",
    "cost_change",
    "gradient_max_norm",
    "step_norm",
    "relative_decrease",
    "trust_region_radius",
    "linear_solver_iterations",
    "step_is_successful",
    "iteration_time_in_seconds",
    "cumulative_time_in_seconds",
]


def test_refines_and_reports(run, model, tmp_path, backend):
    output = tmp_path / "refined.txt"
    code, out, err = run("refine", model, "-o", output, "--backend", backend, "--verbose")
    assert code == 0
    assert backend.upper() in out
    (counts,) = (line for line in out.splitlines() if "observations" in line and "points" in line)
    assert figures(counts) == ["4", "4", "30", "120"]
    rows = table(out)
    assert f"{output}(BAL)" in "".join(out.split())  # a long path goes on in the next line
    assert rows["total"][-1] == "100.0 %"
    assert "\x1b" not in out + err
    lines = err.splitlines()
    assert lines[0] == f"reading {model} ..."
    assert lines[2].split() == ["iteration", "cost", "change", "gradient", "radius", "elapsed"]
    assert lines[-2:] == [f"writing {output} ...", "measuring reprojection errors ..."]
    assert len({len(line) for line in lines[2:-2]}) == 1  # columns
    refined = bundle.load(output)
    errors, _ = bundle.model.residuals.reprojection_errors(refined)
    assert np.sqrt(np.mean(errors**2)) < 0.7  # the noise is 0.5 px in x and in y, less the fit


def test_json_against_the_contract(run, model, tmp_path, backend):
    report_path, output = tmp_path / "report.json", tmp_path / "r.txt"
    code, _, _ = run("refine", model, "-o", output, "--json", report_path, "--backend", backend)
    assert code == 0
    report = json.loads(report_path.read_text())
    assert list(report) == [
        "schema", "command", "version", "input", "headline", "findings", "options", "summary",
        "iterations", "reprojection_error",
        "held_cost", "convergence", "deleted", "edits", "movement", "cameras", "worst_images",
        "wall_time", "environment", "output",
    ]  # fmt: skip
    assert (report["schema"], report["command"]) == (1, "refine")
    assert report["version"] == bundle.__version__
    digests = report["input"].pop("digests")
    assert set(digests) == {"structure", "measurements", "start"}
    assert report["input"] == {
        "path": str(model),
        "format": "bal",
        "num_cameras": 4,
        "num_images": 4,
        "num_points": 30,
        "num_observations": 120,
    }
    assert set(report["options"]) == {field.name for field in dataclasses.fields(SolveOptions)}
    assert set(report["summary"]) == {field.name for field in dataclasses.fields(Summary)}
    assert all(list(iteration) == ITERATION for iteration in report["iterations"])
    used = {name: report["summary"][f"backend_{name}"] for name in ("given", "used", "choice")}
    assert used == {"given": backend.upper(), "used": backend.upper(), "choice": ""}
    assert report["options"]["backend"] == backend.upper()
    assert bool(report["summary"]["instruction_set"]) == (backend == "fused")
    assert report["summary"]["termination_type"] == "CONVERGENCE"
    assert report["summary"]["linear_solver_ordering_used"] == [30, 4]
    statistics = {"rmse", "mean", "median", "p95", "max"}
    errors = report["reprojection_error"]
    assert statistics <= set(errors["before"])
    assert statistics <= set(errors["after"])
    # RMSE is over observations: cost = 1/2 sum ||r||^2
    for when, cost in (("before", "initial_cost"), ("after", "final_cost")):
        rmse = np.sqrt(2 * report["summary"][cost] / 120)
        assert errors[when]["rmse"] == pytest.approx(rmse, rel=1e-12)
    wall = report["wall_time"]
    assert list(wall) == ["load", "build", "solve", "save", "statistics", "total"]
    assert wall["statistics"] > 0
    assert all(time > 0 for time in wall.values())
    assert wall["total"] > sum(wall.values()) - wall["total"]
    assert report["output"] == {"path": str(tmp_path / "r.txt"), "format": "bal"}


def test_intrinsics_before_and_after_and_the_worst_images(run, model, tmp_path, backend):
    report_path, output = tmp_path / "report.json", tmp_path / "r.txt"
    words = ("--json", report_path, "--backend", backend, "--verbose")
    _, out, _ = run("refine", model, "-o", output, *words)
    report, rows = json.loads(report_path.read_text()), table(out)
    first, last = bundle.load(model), bundle.load(output)
    assert {change["camera_id"] for change in report["cameras"]} == {0, 1, 2, 3}
    for change in report["cameras"]:
        camera = list(first.camera_ids).index(change["camera_id"])
        assert change["before"]["f"] == first.camera_params[camera, 0]
        assert change["after"]["f"] == last.camera_params[camera, 0]
        before, after = change["before"]["f"], change["after"]["f"]
        shown = ["f", f"{before:.7g}", f"{after:.7g}", f"{after - before:+.3g}"]
        assert rows[f"{change['camera_id']} RADIAL"] == shown
    # What is held, here the principal point, does not show.
    assert not [line for line in out.splitlines() if " cx " in line or " cy " in line]
    movements = [change["movement"] for change in report["cameras"]]
    assert movements == sorted(movements, reverse=True)
    for image in report["worst_images"]:
        assert rows[f"image {image['image_id']}"][1] == f"{image['rmse']:.4f}"
    worst = report["worst_images"][0]["rmse"]
    assert worst >= report["reprojection_error"]["after"]["rmse"]


def test_of_many_cameras_the_largest_movers_are_shown(run, tmp_path):
    problem = scene(num_images=9)
    bundle.save(problem, tmp_path / "many.txt")
    report_path = tmp_path / "report.json"
    arguments = ("-o", tmp_path / "r.txt", "--json", report_path, "--verbose")
    _, out, _ = run("refine", tmp_path / "many.txt", *arguments)
    changes = json.loads(report_path.read_text())["cameras"]
    assert len(changes) == 9
    labels = [f"{change['camera_id']} RADIAL" for change in changes]
    assert [label for label in labels if label in table(out)] == labels[:5]
    assert any(line.startswith("- ") and figures(line) == ["4"] for line in out.splitlines())


def test_json_to_standard_output_is_all_there_is(spawn, model, tmp_path):
    code, out, err = spawn("refine", model, "-o", tmp_path / "r.txt", "--json", "-")
    assert code == 0
    assert json.loads(out)["command"] == "refine"
    assert "iteration" in err


def test_quiet(run, model, tmp_path):
    code, out, err = run("refine", model, "-o", tmp_path / "r.txt", "--quiet")
    assert (code, err) == (0, "")
    assert table(out)["output"]


def test_auto_says_which_backend_and_why(run, model, tmp_path):
    words = ("refine", model, "-o", tmp_path / "r.txt", "--quiet", "--verbose")
    _, out, _ = run(*words)
    assert "FUSED" in out
    _, out, _ = run(*words, "--solver", "dense-qr")
    assert "CERES" in out
    words = " ".join(out.split())
    reason = words[words.index("CERES") :]
    assert "dense_qr" in reason and "linear_solver_type" in reason  # why not the fused one


def test_output_may_be_the_input(run, model):
    before = bundle.load(model)
    assert run("refine", model, "-o", model).code == 0
    after = bundle.load(model)
    assert not np.array_equal(before.points, after.points)
    np.testing.assert_array_equal(before.observation_xy, after.observation_xy)


def test_no_iterations_only_evaluates(run, model, tmp_path):
    code, out, _ = run("refine", model, "-o", tmp_path / "r.txt", "--max-iterations", 0)
    assert code == 0
    assert figures(out)[0] == "0"
    kept, given = bundle.load(tmp_path / "r.txt"), bundle.load(model)
    np.testing.assert_allclose(kept.points, given.points, rtol=1e-15)


def test_every_flag_reaches_the_solve(run, model, tmp_path, monkeypatch):
    """Each field of SolveOptions, given as anything but its default, but what no dogleg has."""
    wanted = SolveOptions(
        backend="ceres",
        linear_solver_type="iterative_schur",
        linear_solver_ordering="automatic",
        preconditioner_type="schur_jacobi",
        schur_complement="explicit",
        trust_region_strategy_type="subspace_dogleg",
        initial_trust_region_radius=1e3,
        min_trust_region_radius=1e-20,
        min_relative_decrease=1e-2,
        max_num_consecutive_invalid_steps=4,
        min_lm_diagonal=1e-5,
        max_lm_diagonal=1e30,
        use_nonmonotonic_steps=True,
        max_consecutive_nonmonotonic_steps=3,
        loss="soft_l1",
        loss_scale=2.5,
        max_num_iterations=7,
        convergence="ceres",
        function_tolerance=1e-3,
        gradient_tolerance=1e-4,
        parameter_tolerance=1e-5,
        num_threads=1,
        deterministic=True,
        refine=("points", "focal"),
        refine_sensor_from_rig=True,
        fixed_sensors=((1, 2), (1, 3)),
        fixed_camera_ids=(0, 2),
        fixed_image_ids=(1,),
        fixed_point_ids=(3, 4, 5, 9),
        twists="tied",
        twist_sigma=(0.002, 0.01),
        refine_readout=True,
        gauge="three_points",
        cheirality="zero",
        check_solution=False,
    )
    defaults = SolveOptions().asdict()
    same = [name for name, value in wanted.asdict().items() if value == defaults[name]]
    assert same == ["max_trust_region_radius"]
    seen = []

    def solve(prepared, _):
        seen.append(prepared.options)
        return fakes.result(prepared.start)

    monkeypatch.setattr("bundle.solving.rounds.solve_rounds.solve_prepared", solve)
    code, _, err = run(
        "refine", model, "-o", tmp_path / "r.txt", "--backend", "CERES", "--solver",
        "ITERATIVE_SCHUR", "--ordering", "automatic", "--preconditioner", "schur-jacobi",
        "--trust-region", "subspace-dogleg", "--loss", "soft-l1", "--loss-scale", "2.5",
        "--max-iterations", 7, "--convergence", "ceres", "--function-tolerance", "1e-3",
        "--gradient-tolerance", "1e-4",
        "--parameter-tolerance", "1e-5", "--threads", 1, "--deterministic", "--refine",
        "points,focal", "--fix-cameras", "2,0", "--fix-images", 1, "--fix-points", "3-5, 9,4",
        "--gauge", "three-points", "--cheirality", "zero", "--no-check-solution",
        "--refine-sensor-from-rig", "--fix-sensors", "1:2,1:3",
        "--initial-trust-region-radius", "1e3",
        "--min-trust-region-radius", "1e-20", "--min-relative-decrease", "1e-2",
        "--max-invalid-steps", 4, "--min-lm-diagonal", "1e-5",
        "--max-lm-diagonal", "1e30", "--use-nonmonotonic-steps",
        "--max-nonmonotonic-steps", 3, "--schur-complement", "explicit",
        "--twists", "tied", "--twist-sigma", "0.002,0.01", "--refine-readout",
    )  # fmt: skip
    assert code == 0, err
    assert seen == [wanted]


@pytest.mark.parametrize(
    ("changes", "code", "saved"),
    [
        ({}, 0, True),
        ({"termination_type": "NO_CONVERGENCE", "message": "Maximum number of"}, 0, True),
        ({"interrupted": True, "termination_type": "USER_SUCCESS"}, 1, True),
        ({"is_solution_usable": False, "termination_type": "FAILURE", "message": "x"}, 1, False),
    ],
)
def test_exit_codes_and_what_is_saved(run, model, tmp_path, monkeypatch, changes, code, saved):
    def solve(prepared, _) -> Result:
        return fakes.result(prepared.start, summary=fakes.summary(**changes))

    monkeypatch.setattr("bundle.solving.rounds.solve_rounds.solve_prepared", solve)
    output, report = tmp_path / "r.txt", tmp_path / "r.json"
    assert run("refine", model, "-o", output, "--json", report).code == code
    assert output.exists() == saved
    written = json.loads(report.read_text())["output"]
    assert written == ({"path": str(output), "format": "bal"} if saved else None)
    # Where the report for people is not printed, they still learn what happened.
    told = run("refine", model, "-o", output, "--json", "-", "--quiet")
    assert (told.err == "") == (code == 0)
    assert json.loads(told.out)["summary"]["message"] == fakes.summary(**changes).message


def test_the_initial_radius_is_used_and_reported(run, model, tmp_path, backend):
    report = tmp_path / "report.json"
    radius = ("--initial-trust-region-radius", "1e6")
    code, _, _ = run(
        *("refine", model, "-o", tmp_path / "out.txt", "--json", report, "--backend", backend),
        *radius,
    )
    assert code == 0
    written = json.loads(report.read_text())
    assert written["options"]["initial_trust_region_radius"] == 1e6
    assert written["iterations"][0]["trust_region_radius"] == 1e6
    for wrong in ("0", "nan", "2e16"):
        code, _, err = run("refine", model, "-o", tmp_path / "no.txt", radius[0], wrong)
        assert (code, err.count("\n")) == (2, 1)
        assert radius[0] in err
    assert not (tmp_path / "no.txt").exists()


def test_hopeless_problem_ends_with_a_sentence(run, tmp_path):
    """All points behind all cameras, and counted as zero: there is nothing to lower."""
    problem = scene()
    poses = problem.cam_from_world.copy()
    poses[:, 6] = -6.0
    path = tmp_path / "behind.txt"
    bundle.save(problem.replace(cam_from_world=poses), path)
    words = ("--cheirality", "zero", "--verbose")
    code, out, _ = run("refine", path, "-o", tmp_path / "r.txt", *words)
    assert code in (0, 1)
    assert table(out)["behind camera"] == ["120", "120"]
    assert "There is no usable solution." in out
