"""Each planted fault is found, alone and beside others; sound scenes have no findings."""

import dataclasses
import shlex
from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.cli.main import command_parser
from bundle.interface.finding import Finding, one_list
from bundle.judging.findings import find as module
from bundle.judging.findings.contradicted_constants import HELD
from bundle.judging.findings.find import IMPORTANCE, find
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.positions import RADIUS_FLAG
from tests.campaigns.findings import KINDS, judge, make

SEED = 20_000


@pytest.mark.parametrize("kind", KINDS)
def test_a_planted_fault_is_found_alone(kind):
    found = judge(make(SEED, (kind,)))
    assert [finding.kind for finding in found] == [kind]
    (finding,) = found
    assert finding.sentence.endswith(".") and finding.evidence
    if finding.command:
        words = shlex.split(finding.command)
        parsed = command_parser().parse_args(words[1:])
        assert parsed.command in ("refine", "diagnose") and parsed.input == "INPUT"


@pytest.mark.parametrize("seed", range(SEED, SEED + 6))
def test_sound_scenes_have_no_findings(seed):
    assert judge(make(seed, ())) == ()


@pytest.mark.parametrize(
    "kinds",
    [
        ("outliers", "lens_model", "weak_joint"),
        ("outliers", "shared_lens", "duplicate_points"),
        ("positions", "focal_drift", "image_residuals"),
        ("lens_model", "scale_drift", "image_residuals"),
    ],
)
def test_faults_are_found_beside_each_other(kinds):
    found = [finding.kind for finding in judge(make(SEED + 2, kinds))]
    assert set(found) == set(kinds)
    assert found == sorted(found, key=IMPORTANCE.index)


def test_every_kind_has_a_place():
    others = {"attitudes", "gps_offset", "rules", "shifted_pixels", *(row.kind for row in HELD)}
    assert {*KINDS, *others} == set(IMPORTANCE)


def test_findings_do_not_depend_on_the_order_of_images_and_points():
    scene = make(SEED, ("lens_model", "image_residuals", "weak_joint"))
    problem = bundle.solve(scene.start).problem
    rng = np.random.default_rng(0)
    images, points, rows = (
        rng.permutation(n)
        for n in (problem.num_images, problem.num_points, problem.num_observations)
    )
    mixed = bundle.Problem(
        format="colmap",
        cam_from_world=problem.cam_from_world[images],
        image_camera=problem.image_camera[images],
        image_ids=problem.image_ids[images],
        camera_models=problem.camera_models,
        camera_params=problem.camera_params,
        camera_sizes=problem.camera_sizes,
        camera_ids=problem.camera_ids,
        points=problem.points[points],
        point_ids=problem.point_ids[points],
        observation_image=np.argsort(images)[problem.observation_image[rows]].astype(np.int32),
        observation_point=np.argsort(points)[problem.observation_point[rows]].astype(np.int32),
        observation_xy=problem.observation_xy[rows],
    )
    one, other = find(problem), find(mixed)
    assert [finding.kind for finding in one] == [finding.kind for finding in other]
    for a, b in zip(one, other, strict=True):
        if a.kind == "lens_model":
            assert a.evidence["size"] == pytest.approx(b.evidence["size"], rel=1e-6)
        else:
            assert a.evidence["image_ids"] == b.evidence["image_ids"]


def test_findings_do_not_depend_on_the_frame_of_the_world():
    scene = make(SEED, ("motion", "shared_lens")[:1])
    problem = bundle.solve(scene.start).problem
    scaled = problem.cam_from_world.copy()
    scaled[:, 4:] *= 1e3
    moved = problem.replace(cam_from_world=scaled, points=problem.points * 1e3)
    (one,), (other,) = find(problem), find(moved)
    for name, ratio in one.evidence["chi2_per_dof"].items():
        assert other.evidence["chi2_per_dof"][name] == pytest.approx(ratio, rel=1e-5)


def test_one_list_keeps_the_first_of_a_kind_and_problems_first():
    from bundle.interface.finding import Finding

    def of(kind, **more):
        return Finding(kind=kind, sentence=kind, **more)

    given = [of("gross_errors"), of("a"), of("a"), of("c", is_problem=True)]
    kinds = [one.kind for one in one_list(given, [of("outliers"), of("a", command="x")])]
    assert kinds == ["c", "a", "a", "outliers"]


def test_the_next_command_replaces_flags_with_their_values():
    given = (
        "--set",
        "camera 1: f fixed",
        "--camera-model",
        "RADIAL",
        "--loss=huber",
        "--rounds",
        "2",
    )
    command = NextCommand("a b", "c", given).refine("--camera-model", "OPENCV", "--loss", "cauchy")
    assert shlex.split(command) == [
        *("bundle", "refine", "a b", "-o", "c", "--set", "camera 1: f fixed", "--rounds", "2"),
        *("--camera-model", "OPENCV", "--loss", "cauchy"),
    ]


def test_a_drift_of_bent_images_is_no_single_wrong_position():
    # Sigmas of a ninth bend the images; the way back, without the positions, is long.
    scene = make(51_002, ("scale_drift", "undetermined_intrinsics", "image_residuals"))
    scene.priors = [
        bundle.PositionPrior(one.image, one.position, np.asarray(one.sigma) / 9)
        for one in scene.priors
    ]
    (found,) = (one for one in judge(scene) if one.kind in ("positions", "scale_drift"))
    assert found.kind == "scale_drift" or not found.command


def test_lenses_are_not_shared_while_the_scale_drifts():
    found = {one.kind: one for one in judge(make(51_025))}
    assert set(found) == {"scale_drift", "shared_lens"}
    assert found["scale_drift"].command and not found["shared_lens"].command


def test_a_lens_per_image_whose_term_is_missing_is_found_and_shared():
    """The field is significant, but less than 1 % of the residuals: positions alone were named."""
    found = {one.kind: shlex.split(one.command)[5:] for one in judge(make(72_025))}
    assert set(found) == {"lens_model", "positions", "shared_lens"}
    lens, share = ["--camera-model", "OPENCV"], ["--share-cameras", "all"]
    scale = ["--gps-sigma-scale", found["positions"][-1]]
    assert found == {
        "lens_model": [*scale, *lens],
        "positions": [*lens, *scale],
        "shared_lens": [*scale, *lens, *share],
    }
    # The file has 0.0089 m, and the errors are 0.041 m.
    np.testing.assert_allclose([float(one) for one in scale[1].split("/")], 4.6, rtol=0.25)


@pytest.mark.parametrize("is_varied", [True, False])
@pytest.mark.parametrize("significant", [True, False])
def test_what_hints_at_a_lens_that_poses_have_absorbed(monkeypatch, is_varied, significant):
    monkeypatch.setattr(module, "lens_model", lambda *_: None)
    monkeypatch.setattr(module, "absorbed_lens", lambda _, has_hint: has_hint)
    monkeypatch.setattr(module, "variation", lambda *_: ({}, {}, is_varied))
    fields = [SimpleNamespace(significant=one) for one in (False, significant)]
    hint = module._lens(SimpleNamespace(scale=1.0), None, fields)
    assert hint == (is_varied or significant)


def test_a_drift_is_mended_with_the_prior_of_what_is_not_determined():
    # Without it, the solve with smaller sigmas does not end in 6,400 steps.
    found = {one.kind: one for one in judge(make(45_065))}
    assert found["scale_drift"].command == found["undetermined_intrinsics"].command
    drift = shlex.split(found["scale_drift"].command)
    for word in ("camera 1: f prior 2 %", "--loss", "--gps-sigma-scale", RADIUS_FLAG):
        assert drift.count(word) == 1


def test_a_larger_lens_is_advised_with_what_mends_a_drift():
    """Alone, it lets the positions bend the model more: its errors grew from 0.054 to 0.071."""
    found = {one.kind: shlex.split(one.command)[5:] for one in judge(make(76_000))}
    assert {"scale_drift", "lens_model"} <= found.keys()
    lens, drift = found["lens_model"], found["scale_drift"]
    assert sorted(lens) == sorted(drift) and lens[-2:] == ["--camera-model", "OPENCV"]
    assert "--gps-sigma-scale" in lens and RADIUS_FLAG in lens


@pytest.mark.parametrize(
    ("drift", "loose", "expected"),
    [
        ("--gps-sigma 1", "--gps-sigma 1 --share-cameras all", "--gps-sigma 1 --share-cameras all"),
        ("--gps-sigma 1", "", "--gps-sigma 1"),  # the lens has left its start
        ("", "--share-cameras all", ""),  # the images contradict the drift
        ("--gps-sigma 1", None, "--gps-sigma 1"),
    ],
)
def test_only_a_drift_with_a_command_gets_what_determines_the_lens(
    monkeypatch, drift, loose, expected
):
    def refine(flags):
        return f"bundle refine INPUT -o OUTPUT {flags}" if flags else ""

    known = [("scale_drift", drift), ("undetermined_intrinsics", loose)]
    given = [
        Finding(kind=kind, sentence="", command=refine(flags))
        for kind, flags in known
        if flags is not None
    ]
    monkeypatch.setattr(module, "_findings", lambda _: given)
    found = {one.kind: one.command for one in find(make(SEED, ()).start)}
    assert found.pop("scale_drift") == refine(expected)
    assert all(command == refine(loose) for command in found.values())


@pytest.mark.parametrize(
    ("kind", "rule", "why"),
    [
        ("undetermined_intrinsics", "camera 1: f prior 10 %", "already has a prior"),
        ("shared_lens", "cameras 1,2: share f", "there is no camera 2"),
        ("lens_model", "camera 1: k fixed", "has no parameter 'k'"),
        ("lens_model", "camera 1: f prior 5 %", ""),
    ],
)
def test_rules_of_the_run_that_contradict_a_command_are_named(kind, rule, why):
    seed = next(n for n in range(SEED, SEED + 50) if _has_radial_lens(make(n, (kind,))))
    scene = make(seed, (kind,))
    result = bundle.solve(scene.start, constraints=rule, num_threads=1, max_num_iterations=200)
    given = {"constraints": bundle.Constraints(rule), "given": ("--set", rule)}
    (found,) = find(result.problem, options=result.options, start=scene.start, **given)
    assert found.kind == kind and bool(found.command) == (not why)
    assert ("Rules of this run contradict the command" in found.sentence) == bool(why)
    assert why in found.sentence


def _has_radial_lens(scene):
    return scene.start.camera_models[0] == "SIMPLE_RADIAL" and not scene.priors


def test_cameras_that_a_run_has_split_are_shared_by_not_splitting_them():
    """The input may have one camera, which cannot be shared."""
    command = NextCommand("a", "b", ("--split-cameras", "--threads", "2"))
    for share in ("all", "1,2"):
        flags = ("--share-cameras", share, "--loss", "cauchy")
        assert shlex.split(command.refine(*flags))[5:] == [*("--threads", "2", "--loss", "cauchy")]
    assert "--split-cameras" in command.refine("--loss", "cauchy")
    added = command.added(command.refine("--set", "camera 1: f fixed", "--threads", "3"))
    assert added == [("--set", "camera 1: f fixed"), ("--threads", "3")]


def test_no_larger_lens_is_advised_whose_terms_stay_constant():
    scene = make(SEED, ("lens_model",))
    result = bundle.solve(scene.start, refine=("poses", "points", "focal"), num_threads=1)
    (found,) = (one for one in find(result.problem, options=result.options) if "lens" in one.kind)
    assert found.kind == "lens_model" and not found.command
    assert find(result.problem)[0].command.endswith("OPENCV")


def test_positions_with_a_robust_loss_do_not_mend_a_drift():
    """Smaller sigmas make all drifted positions outliers: the loss goes first."""
    scene = make(SEED, ("scale_drift",))
    priors = [dataclasses.replace(one, loss="cauchy") for one in scene.priors]
    known = {"priors": priors, "align": True, "num_threads": 1, "max_num_iterations": 200}
    result = bundle.solve(scene.start, **known)
    given = ("--prior-loss", "cauchy")
    found = find(result.problem, options=result.options, priors=priors, given=given)
    (drift,) = (one for one in found if one.kind == "scale_drift")
    words = shlex.split(drift.command)[5:]
    assert words == [RADIUS_FLAG, "1", "--prior-loss", "trivial"]
