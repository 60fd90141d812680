import pytest

from benchmarks import shutter_steps

SMALL = {"scene": "orbit", "num_images": 6, "num_points": 60, "rolling_shutter": 0.8}


def test_kinds_solve_what_their_names_say():
    plain, rolling = (shutter_steps.problem_of(SMALL, kind) for kind in ("global", "hard"))
    assert plain.rolling_shutter is None and rolling.rolling_shutter.is_rolling.all()
    assert plain.num_observations == rolling.num_observations


def test_a_run_has_times_of_every_kind(monkeypatch):
    monkeypatch.setattr(shutter_steps, "SCENES", {"small": SMALL})
    solved = []

    def solve(problem, **options):
        solved.append((problem.rolling_shutter is None, options.get("twists", "free")))
        return original(problem, **options)

    original = shutter_steps.bundle.solve
    monkeypatch.setattr(shutter_steps.bundle, "solve", solve)
    found = shutter_steps.measured(2)
    assert [len(times) for times in found["small"].values()] == [2] * len(shutter_steps.KINDS)
    kinds = [(True, "free"), (False, "free"), (False, "tied"), (False, "hard")]
    assert solved == [kind for _ in range(2) for kind in kinds for _ in range(2)]


def test_the_table_has_ratios_to_the_global_step():
    table = shutter_steps.steps_table({"x": {"global": [2.0, 4.0], "free": [4.0, 9.0]}})
    assert "2.12" in table or "2.13" in table
    with pytest.raises(ValueError):
        shutter_steps.steps_table({"x": {"global": [1.0], "free": [1.0, 2.0]}})
