"""The names that `import bundle` gives, and what their arguments accept."""

import dataclasses
import inspect
import re
import subprocess
import sys

import numpy as np
import pytest
from tools import public_stub

import bundle
from bundle.base.words import contents, plural
from bundle.interface.option_class import spellings
from bundle.interface.planning_options import COMPARED
from bundle.model.residuals import reprojection_error
from tests import scenes
from tests.campaigns.triage_inputs import chain_of_poses

LAZY = (
    *("reports.page", "model.losses", "figures.matplotlib", "planning.comparison"),
    *("planning.inspection", "checking", "synthetic"),
)


@pytest.fixture(scope="module")
def problem():
    return scenes.make_problem(num_images=3, num_points=12)


def test_dir_has_every_public_name_and_each_is_there():
    assert set(bundle.__all__) <= set(dir(bundle))
    assert {"html", "losses", "pictures", "describe", "reprojection_errors"} <= set(bundle.__all__)
    for name in bundle.__all__:
        assert getattr(bundle, name) is not None
        assert name == "__version__" or getattr(bundle, name).__doc__, name
    with pytest.raises(AttributeError, match=r"no attribute 'nothing'$"):
        _ = bundle.nothing


def test_names_by_other_words_are_answered_by_the_names_here(problem, tmp_path):
    for name, meant in {**bundle._ELSEWHERE, "covarience": "covariance"}.items():
        assert name not in bundle.__all__ and meant in bundle.__all__
        with pytest.raises(AttributeError, match=f"no attribute '{name}'; did you mean {meant}"):
            getattr(bundle, name)
    assert not hasattr(bundle, "_solve")  # a probe, such as those of notebooks
    with pytest.raises(bundle.InputError, match=r"found FactorGraph .*; call its \.solve\(\)$"):
        bundle.solve(bundle.FactorGraph())
    graph = chain_of_poses(0, 30, 3)
    for function, given in (
        (bundle.solve, problem),
        (bundle.inspect, problem),
        (bundle.solve, graph),
    ):
        result = bundle.solve(given, max_num_iterations=1)
        with pytest.raises(bundle.InputError, match=r"; pass its \.problem$"):
            function(result)
        function(result.problem)
        with pytest.raises(bundle.InputError, match=r"a Problem, such as result\.problem, found "):
            bundle.save(result, tmp_path / "x")


def test_public_functions_describe_every_parameter():
    """Docstrings of internals describe only what the signature does not say."""
    faces = (bundle, bundle.constraints, bundle.georeference, bundle.losses, bundle.pictures)
    public = [getattr(face, name) for face in faces for name in face.__all__]
    kinds = [kind for kind in public if inspect.isclass(kind)]
    methods = [
        method
        for kind in kinds
        for name, method in inspect.getmembers(kind, inspect.isfunction)
        if not name.startswith("_")
    ]
    described = 0
    for function in [*filter(inspect.isfunction, public), *methods]:
        _, args, entries = (inspect.getdoc(function) or "").partition("\nArgs:\n")
        entries = re.split(r"\n(?=\S)", entries)[0]
        code = inspect.unwrap(function).__code__
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        for name in names if args else ():
            described += 1
            found = re.search(rf"^    (\w+, )*\**{name}(, \**\w+)*: ", entries, re.MULTILINE)
            assert name == "self" or found, f"{function.__qualname__}: {name}"
    assert described > 300


def test_packages_are_imported_when_asked_for_and_not_before():
    script = f"""
import sys, bundle
early = {LAZY!r}
assert not [name for name in early if f"bundle.{{name}}" in sys.modules]
assert not {{"rich", "matplotlib", "pycolmap", "difflib"}} & set(sys.modules)
assert bundle.losses.evaluate_loss and bundle.pictures.figure and bundle.html.write_comparison
_ = bundle.compare, bundle.inspect, bundle.check_jacobians, bundle.synthesize
assert all(f"bundle.{{name}}" in sys.modules for name in early)
"""
    subprocess.run([sys.executable, "-c", script], check=True)


@pytest.mark.parametrize("kind", [bundle.SolveOptions, bundle.SceneOptions])
def test_help_documents_every_option(kind):
    text = " ".join(kind.__doc__.split())
    for field in dataclasses.fields(kind):
        entry = text[text.index(f" {field.name}: ") :]
        entry = entry[: entry.index(f"command line: {field.metadata['flag']}")]
        assert f"Default {field.default!r};" in entry, field.name
        for choice in field.metadata["choices"] or ():
            assert choice in entry
        assert " ".join(field.metadata["help"].split()) in entry


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("solver", "linear_solver_type"),
        ("--solver", "linear_solver_type"),
        ("max_iterations", "max_num_iterations"),
        ("max-iterations", "max_num_iterations"),
        ("loss-scale", "loss_scale"),
        ("Loss_Scale", "loss_scale"),
        ("threads", "num_threads"),
        ("fix_cameras", "fixed_camera_ids"),
        ("preconditioner", "preconditioner_type"),
        ("num_thread", "num_threads"),
        ("linear_solver", "linear_solver_type"),
        ("functoin_tolerance", "function_tolerance"),
    ],
)
def test_a_wrong_keyword_is_answered_with_the_right_one(problem, given, meant):
    calls = (
        lambda **options: bundle.solve(problem, **options),
        lambda **options: bundle.inspect(problem, **options),
        bundle.SolveOptions,
        bundle.SolveOptions().replace,
    )
    for call in calls:
        with pytest.raises(bundle.InputError, match=rf"did you mean {meant}\b") as caught:
            call(**{given: 1})
        assert repr(given) in str(caught.value)


def test_every_flag_of_the_command_line_is_understood():
    for kind in (bundle.SolveOptions, bundle.SceneOptions):
        for spelling, name in spellings(kind).items():
            if spelling != name:
                with pytest.raises(bundle.InputError, match=f"did you mean {name}\\?"):
                    kind(**{spelling: 1})


@pytest.mark.parametrize(
    "spelling", ["function-tolerance", "FUNCTION_TOLERANCE", "Function-Tolerance_"]
)
def test_another_spelling_of_a_name_is_answered_with_that_alone(spelling):
    with pytest.raises(bundle.InputError, match=r"; did you mean function_tolerance\?$"):
        bundle.SolveOptions(**{spelling: 1})


def test_no_noise_of_what_is_not_there_is_no_mistake():
    options = bundle.SceneOptions(camera_model="PINHOLE", distortion_noise=0.0)
    assert options.distortion_noise == 0
    with pytest.raises(
        bundle.InputError, match=r"^distortion_noise: valid only with camera_model="
    ):
        bundle.SceneOptions(camera_model="PINHOLE", distortion_noise=0.1)


def test_a_keyword_like_nothing_is_answered_with_all():
    with pytest.raises(bundle.InputError) as caught:
        bundle.solve(scenes.make_problem(num_images=2), xyzzy=1)
    assert all(field.name in str(caught.value) for field in dataclasses.fields(bundle.SolveOptions))


@pytest.mark.parametrize(
    ("name", "given", "meant"),
    [
        ("loss", "hubber", "huber"),
        ("linear_solver_type", "sparse-shur", "sparse_schur"),
        ("backend", "cerres", "ceres"),
        ("refine", ["pose"], "poses"),
        ("gauge", "TWO-CAMERA", "two_cameras"),
    ],
)
def test_a_misspelt_value_is_answered_with_the_right_one(name, given, meant):
    with pytest.raises(bundle.InputError, match=f"^{name}: .* found .*; did you mean {meant}"):
        bundle.SolveOptions(**{name: given})


def test_words_are_accepted_in_any_case(problem):
    assert reprojection_error(problem, "Algebraic").rmse > 0
    assert bundle.check_jacobians(problem, samples_per_image=1, cheirality="ZERO").ok
    assert bundle.inspect_graph([(0, 1)], ordering="Minimum-Degree").ordering == "minimum_degree"
    params = [500.0, 320, 240, 0.1]
    xy, _ = bundle.project("simple-radial", params, [[0, 0, 1.0]])
    assert xy.tolist() == [[320, 240]]
    with pytest.raises(bundle.InputError, match="did you mean SIMPLE_RADIAL"):
        bundle.project("SIMPLE_RADAIL", params, [[0, 0, 1.0]])
    quaternion = np.array([0.0, 0, 0, 1])
    report = bundle.check_gradients(
        lambda blocks: (blocks[0], [np.eye(4)]), [quaternion], ["Quaternion-XYZW"]
    )
    assert report.ok


def test_solve_inspect_check_describe_take_a_path_or_a_reconstruction(problem, tmp_path):
    bundle.save(problem, tmp_path / "model")
    loaded = bundle.load(tmp_path / "model")
    for source in (tmp_path / "model", str(tmp_path / "model"), loaded.to_pycolmap()):
        result = bundle.solve(source, max_num_iterations=0)
        np.testing.assert_array_equal(result.problem.points, loaded.points)
        assert bundle.check_jacobians(source, samples_per_image=1).ok
        assert (
            bundle.describe(source).reprojection_error == bundle.describe(loaded).reprojection_error
        )
        np.testing.assert_array_equal(
            bundle.reprojection_errors(source)[0], bundle.reprojection_errors(loaded)[0]
        )
        with pytest.raises(bundle.InputError, match=r"^refine: expected observations"):
            bundle.inspect(source, refine=[])
    with pytest.raises(bundle.InputError, match=r"pass its \.problem"):
        bundle.solve(bundle.solve(problem, max_num_iterations=0))


def test_reprojection_errors_are_those_of_the_formulas(problem):
    errors, behind = bundle.reprojection_errors(problem)
    np.testing.assert_allclose(errors, np.linalg.norm(scenes.residuals(problem), axis=1), rtol=1e-9)
    assert not behind.any()


def test_a_loss_scale_without_a_loss_is_refused(problem):
    with pytest.raises(
        bundle.InputError, match=r"^loss_scale: valid only with loss=huber, .*trivial$"
    ):
        bundle.solve(problem, loss_scale=2.0)
    assert bundle.SolveOptions(loss_scale=1.0).loss == "trivial"
    assert bundle.SolveOptions(loss="huber", loss_scale=2.0).loss_scale == 2.0


NOTED = [
    ("preconditioner_type", "jacobi", ("dense_schur", "dense_normal_cholesky", "dense_qr")),
    ("linear_solver_ordering", "cameras_first", ("dense_normal_cholesky", "dense_qr", "cgnr")),
    ("linear_solver_ordering", "automatic", ("dense_normal_cholesky", "dense_qr", "cgnr")),
]


@pytest.mark.parametrize(("name", "value", "solvers"), NOTED)
def test_options_that_change_nothing_are_noted_as_declared(problem, name, value, solvers):
    field = bundle.SolveOptions.__dataclass_fields__[name]
    assert field.metadata["idle"] == "note"
    _, effective = field.metadata["only_with"]
    for solver in ("dense_schur", "sparse_normal_cholesky", *solvers):
        options = {"linear_solver_type": solver, name: value, "max_num_iterations": 0}
        kinds = bundle.solve(problem, backend="ceres", **options).summary.warning_kinds
        noted = f"{name.split('_')[-1 if 'ordering' in name else 0]}_not_used" in kinds
        assert noted == (solver not in effective), solver
        idle = bundle.SolveOptions(**options).without_idle()
        assert (getattr(idle, name) == field.default) == (solver not in effective)


def test_compare_takes_no_option_that_it_compares(problem):
    for name, argument in COMPARED.items():
        with pytest.raises(bundle.InputError, match=f"did you mean {argument}\\?"):
            bundle.compare(problem, **{name: 1})
    with pytest.raises(bundle.InputError, match="did you mean solvers"):
        bundle.compare(problem, solver="dense_schur")
    with pytest.raises(bundle.InputError, match=r"^options: linear_solver_type is compared"):
        bundle.compare(problem, bundle.SolveOptions(linear_solver_type="dense_schur"))


def test_one_is_singular():
    assert [plural(n, "camera") for n in (0, 1, 2)] == ["0 cameras", "1 camera", "2 cameras"]
    assert plural(1200, "match", "matches", grouped=True) == "1,200 matches"
    one = scenes.make_problem(num_images=1, num_points=1)
    assert contents(one) == "1 image, 1 camera, 1 point, 1 observation"


def test_examples_and_pages_are_importable_without_an_installed_matplotlib():
    script = (
        "import sys; sys.modules['matplotlib'] = None; import bundle; bundle.pictures, bundle.html"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_the_stub_has_the_public_names() -> None:
    """`python tools/public_stub.py` writes it."""
    for target, package in public_stub.TARGETS.items():
        assert public_stub.stub(package) == target.read_text(encoding="utf-8")
