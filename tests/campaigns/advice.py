"""Commands of findings, followed as printed to the end: each must run, keep the flags, and help.

python -m tests.campaigns.advice scenes|held COUNT [SEED]
python -m tests.campaigns.advice models [NAME ...]

Scenes are those of tests.campaigns.findings, with zero to three planted faults and flags that a
user might have given, or (held) that hold something at its value in the start, which is wrong. Each
command of each finding of the first run is followed; after it, the first command of each next run,
until none is printed. The position error against the truth, after a similarity, may grow by at most
5 % at a step.

A weak scene may begin near the truth by chance, because two errors cancel. Where a step is worse,
the flags of the user therefore also run on the scene without its planted errors of measurements,
with other noise: a perfect repair. A step does no harm if it ends at most 5 % above its error. This
is no proof that the step helps, so both counts are printed.

Models are the real ones of BUNDLE_DATA. They have no truth: 10 % of their observations are held out
of the file that the commands read. All points are triangulated again from that file, robustly and
with the cameras of each result, so that deleted points count, too. The RMSE of the held-out
observations, clipped at 4 px, may grow by at most 5 % at a step.

A command also fails if it does not end with exit 0, if a flag of the user is missing, if the solve
does not converge and prints no further command, or if it repeats a command that was followed.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import shlex
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import bundle
from bundle.cli.main import command_parser
from bundle.cli.main import main as run_bundle
from bundle.cli.run import DROPPED
from bundle.model.problem import Problem
from bundle.model.residuals import errors_or_nan, residuals, summarize_clipped
from tests.campaigns import findings

WORSE = 1.05
SMALLEST = 1e-7
"""Error that no longer counts, as a share of the size of the scene."""
CHI3_MEDIAN = 1.538
"""Median length of three standard normal values."""
LONGEST = 6
"""Commands in a chain, after which it does not end."""
USER = (
    (),
    ("--set", "cameras *: f in [1, 1000000]"),
    ("--set", "image 2: rotation prior sigma 20", "--deterministic"),
    ("--max-iterations", "150", "--no-check-solution"),
    ("--hold-out", "10"),
    ("--loss", "soft-l1", "--loss-scale", "2"),
)
"""Flags that a user might have given."""
HELD = (
    ("--refine", "poses,points"),
    ("--fix-images", "1,2,3"),
    ("--fix-points", "1-20"),
    ("--set", "image 1-3: position fixed"),
    ("--set", "cameras *: f fixed"),
)
"""Flags that hold something, which the commands of findings about it drop."""
DROPPED_BY = {
    "rules": ("rules",),
    "constant": ("fixed_camera_ids", "fixed_image_ids", "fixed_point_ids"),
}
"""Arguments that the commands of a kind of findings drop."""
ORIGIN = np.array([500_000.0, 5_300_000.0, 100.0])
"""Place of the synthetic positions in EPSG:32632."""
MODELS: dict[str, tuple[str, ...]] = {
    **{f"colmap/{name}": () for name in ("bartoszek", "batmo_rigs", "crane_mast", "lund_door")},
    **{f"colmap/{name}": () for name in ("maupertuis", "video48", "vr_opencv", "long_tracks")},
    "degenerate/pratikk0": (),
    "rigs/kitti26_stereo_rig": (),
    "rolling_shutter/phone/model": (),
    "georeferenced/brighton_gps/model": (),
    "georeferenced/copr_gcp/model": ("--gcp", "georeferenced/copr_gcp/gcp_list.txt"),
}
"""Real models and the flags of the first run; paths are those in BUNDLE_DATA."""


@dataclass(frozen=True)
class Step:
    """A command that was followed.

    Attributes:
        kind: finding that it came from.
        words: its words.
        before: error of the run before it.
        after: its error; infinite if it failed.
        faults: what is wrong with it; empty if it helps or does no harm.
        repaired: error of a perfect repair; NaN if the step is not worse.
    """

    kind: str
    words: tuple[str, ...]
    before: float
    after: float
    faults: tuple[str, ...]
    repaired: float = np.nan


Judge = Callable[[Problem], float]
"""Error of a result."""
Run = Callable[..., tuple[dict[str, Any] | None, int, float]]
"""From the words of a command to its report, exit code and error."""


def follow(
    source: Path, flags: tuple[str, ...], judge: Judge, clean: tuple[Path, tuple[str, ...]] | None
) -> list[Step]:
    """Refine a model and follow its findings; return the commands that were followed.

    ``clean``: the model without errors of measurements, and its flags.
    """
    target = source.with_name("out")
    first = ["refine", str(source), "-o", f"{target}/", "--overwrite", *flags]

    @functools.cache  # chains of one scene often have the same commands
    def run(*words: str) -> tuple[dict[str, Any] | None, int, float]:
        report, code = _run(list(words), target)
        return report, code, np.inf if code != 0 else judge(bundle.load(target))

    @functools.cache
    def perfect() -> float:
        if clean is None:
            return np.nan
        return run("refine", str(clean[0]), "-o", f"{target}/", "--overwrite", *clean[1])[2]

    begun, _, error = run(*first)
    steps: list[Step] = []
    if begun is None:
        return steps
    for finding in begun["findings"]:
        if finding["command"].startswith("bundle refine"):
            steps += _chain(finding, {_key(first)}, first, run, error)
    for k, step in enumerate(steps):
        if "worse" in step.faults:
            steps[k] = replace(step, repaired=perfect())
    return steps


def _chain(
    finding: dict[str, Any], known: set[str], last: list[str], run: Run, before: float
) -> Iterator[Step]:
    """Yield the steps that begin with a finding."""
    for _ in range(LONGEST):
        words = shlex.split(finding["command"])[1:]
        dropped = DROPPED_BY.get(finding["kind"].partition("_")[0], ())
        faults = [f"lost {name}" for name in _lost(last, words) if name not in dropped]
        if _key(words) in known:
            faults.append("repeats a command")
        known = known | {_key(words)}
        report, code, after = run(*words)
        if report is None or code != 0:
            faults.append(f"exit {code}")
        if not after <= max(WORSE * before, SMALLEST):
            faults.append("worse")
        found = [] if report is None else report["findings"]
        following = [one for one in found if one["command"].startswith("bundle refine")]
        is_converged = report is not None and report["summary"]["termination_type"] == "CONVERGENCE"
        if not is_converged and not following:
            faults.append("neither converged nor a next command")
        yield Step(finding["kind"], tuple(words), before, after, tuple(faults))
        if not following or "repeats a command" in faults:
            return
        finding, last, before = following[0], words, after if code == 0 else before
    yield Step(finding["kind"], tuple(words), before, after, ("the chain does not end",))


def _run(words: list[str], target: Path) -> tuple[dict[str, Any] | None, int]:
    """Run a command; return its report, or None, and its exit code."""
    report = target.with_name("report.json")
    report.unlink(missing_ok=True)
    more = ["--quiet", "--threads", "1", "--json", str(report)]
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            code = run_bundle([*words, *more])
        except SystemExit as error:
            code = int(str(error.code))
    if not report.exists():
        print(f"exit {code}: {shlex.join(words)}: {said.getvalue().strip()}", flush=True)
        return None, code
    return json.loads(report.read_text("utf-8")), code


def _key(words: list[str]) -> str:
    return repr(sorted(_given(words).items()))


def _given(words: list[str]) -> dict[str, Any]:
    """Return the arguments of a command."""
    arguments = vars(command_parser().parse_args(words))
    beside = {*DROPPED, "taken", "flags", "kind", "command"}
    return {name: value for name, value in arguments.items() if name not in beside}


def _lost(before: list[str], after: list[str]) -> list[str]:
    """Return the arguments of a command that the next one lacks."""
    given, now = _given(before), _given(after)
    return [
        name
        for name, value in given.items()
        if value not in (None, False)
        and (now[name] is None or (isinstance(value, list) and not set(value) <= set(now[name])))
    ]


def position_error(image_ids: np.ndarray, truth: np.ndarray) -> Judge:
    """Return the judge by true positions: their RMS error after a similarity, by the size."""
    row = {image: k for k, image in enumerate(image_ids.tolist())}
    size = float(np.sqrt(((truth - truth.mean(axis=0)) ** 2).sum(axis=1).mean()))

    def judge(result: Problem) -> float:
        given = truth[[row[image] for image in result.image_ids.tolist()]]
        moved = similar(result.projection_centers, given)
        return float(np.sqrt(((moved - given) ** 2).sum(axis=1).mean())) / size

    return judge


def similar(points: np.ndarray, onto: np.ndarray, others: np.ndarray | None = None) -> np.ndarray:
    """Return points, or others, moved by the similarity of least squares (Umeyama 1991)."""
    a, b = points.mean(axis=0), onto.mean(axis=0)
    u, d, v = np.linalg.svd((onto - b).T @ (points - a))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    scale = (d * sign).sum() / ((points - a) ** 2).sum()
    return ((points if others is None else others) - a) @ (u * sign @ v).T * scale + b


def held_out_error(whole: Problem, held: np.ndarray) -> Judge:
    """Return the judge by held-out observations; see the top of this file."""
    fitted = np.ones(whole.num_observations, bool)
    fitted[held] = False
    row = {point: k for k, point in enumerate(whole.point_ids.tolist())}

    def judge(result: Problem) -> float:
        kept = [row[point] for point in result.point_ids.tolist() if point in row]
        shared = np.isin(result.point_ids, whole.point_ids)
        points = similar(whole.points[kept], result.points[shared], whole.points)
        points[kept] = result.points[shared]
        seen = whole.select(observations=fitted).problem
        names = (
            *("cam_from_world", "image_camera", "camera_models", "camera_params", "camera_sizes"),
            *("camera_ids", "rig_from_world", "sensor_from_rig", "rolling_shutter"),
        )
        cameras = {name: getattr(result, name) for name in names}
        robust = {"refine": ("points",), "loss": "cauchy", "num_threads": 1}
        again = bundle.solve(seen.replace(points=points, **cameras), **robust).problem
        errors = errors_or_nan(whole.replace(points=again.points, **cameras), "auto", 1)
        return float(summarize_clipped(errors[held]).clipped_rmse)

    return judge


def scene_steps(
    seed: int, folder: Path, given_flags: tuple[tuple[str, ...], ...] = USER
) -> list[Step]:
    """Follow the findings of a seeded scene."""
    scene = findings.make(seed)
    rng = np.random.default_rng([seed, 7])
    flags = list(given_flags[int(rng.integers(len(given_flags)))])
    has_sigmas = bool(rng.random() < 0.5)
    truth = scene.truth.projection_centers
    if "scale_drift" in scene.planted:  # planted into the positions: these are the truth
        truth = np.array([np.asarray(prior.position) for prior in scene.priors])
    judge = position_error(scene.truth.image_ids, truth)
    given = (*flags, *_saved(scene, folder / "model", has_sigmas=has_sigmas))
    if "scale_drift" in scene.planted:  # images without the drift have another truth
        return follow(folder / "model", given, judge, None)
    clean = without_errors(scene, np.random.default_rng([seed, 8]))
    repaired = (*flags, *_saved(clean, folder / "clean", has_sigmas=has_sigmas))
    return follow(folder / "model", given, judge, (folder / "clean", repaired))


def without_errors(scene: findings.Scene, rng: np.random.Generator) -> findings.Scene:
    """Return a scene whose pixels and positions have nothing but noise, of other random numbers.

    Its images, tracks and cameras are the same.
    """
    exact = scene.truth.observation_xy + residuals(scene.truth, "algebraic").xy
    noise = scene.noise * rng.standard_normal(exact.shape)
    pixels = np.where(np.isfinite(exact), exact + noise, scene.start.observation_xy)
    priors = scene.priors  # one for each image, in their order
    if priors:
        given, centers = np.array([one.position for one in priors]), scene.truth.projection_centers
        sigma = float(np.median(np.linalg.norm(given - centers, axis=1))) / CHI3_MEDIAN
        places = centers + sigma * rng.standard_normal(centers.shape)
        own = zip(scene.truth.image_ids.tolist(), places, strict=True)
        priors = [bundle.PositionPrior(image, place, sigma) for image, place in own]
    return replace(scene, start=scene.start.replace(observation_xy=pixels), priors=priors)


def _saved(scene: findings.Scene, source: Path, *, has_sigmas: bool) -> list[str]:
    """Save the start of a scene, and its positions; return the flags of these."""
    bundle.save(scene.start, f"{source}/", format="colmap")
    if not scene.priors:
        return []
    names = dict(zip(scene.start.image_ids.tolist(), scene.start.image_names, strict=True))
    sigma = float(np.max(scene.priors[0].sigma))
    lines = ["EPSG:32632"]
    for prior in scene.priors:
        east, north, up = np.asarray(prior.position) + ORIGIN
        own = f" 0 0 0 {sigma:.4g} {sigma:.4g}" if has_sigmas else ""
        lines.append(f"{names[prior.image]} {east:.6f} {north:.6f} {up:.6f}{own}")
    geo = source.with_name(f"{source.name}.txt")
    geo.write_text("\n".join(lines) + "\n", "utf-8")
    return ["--gps", str(geo), *([] if has_sigmas else ["--gps-sigma", f"{sigma:.4g}"])]


def model_steps(name: str, folder: Path) -> list[Step]:
    """Follow the findings of a real model."""
    data = Path(os.environ["BUNDLE_DATA"])
    whole = bundle.load(data / name)
    kept, held = bundle.hold_out(whole, percent=10, seed=0)
    bundle.save(kept, f"{folder / 'model'}/", format="colmap")
    given = MODELS.get(name, ())
    flags = tuple(str(data / word) if (data / word).exists() else word for word in given)
    return follow(folder / "model", flags, held_out_error(whole, held), None)


def does_no_harm(step: Step) -> bool:
    """Return True if a step is good, or worse only than what it was by chance."""
    bound = max(WORSE * step.repaired, SMALLEST)
    return not step.faults or (step.faults == ("worse",) and step.after <= bound)


def summary(steps: list[Step]) -> str:
    """Return the numbers of steps that are not worse, and of those that do no harm, by kind."""
    total, good, harmless = Counter(), Counter(), Counter()
    for step in steps:
        for kind in (step.kind, "all"):
            total[kind] += 1
            good[kind] += not step.faults
            harmless[kind] += does_no_harm(step)
    rows = [f"{kind:24} {good[kind]} {harmless[kind]} of {total[kind]}" for kind in sorted(total)]
    return "\n".join([f"{'':24} not worse, without harm", *rows])


def main() -> int:
    """Follow the findings of scenes or models and print what fails."""
    names: list[Any]
    steps_of: Callable[[Any, Path], list[Step]]
    if sys.argv[1] in {"scenes", "held"}:
        first = int(sys.argv[3]) if len(sys.argv) > 3 else 50_000
        names = list(range(first, first + int(sys.argv[2])))
        flags = HELD if sys.argv[1] == "held" else USER
        steps_of = functools.partial(scene_steps, given_flags=flags)
    else:
        names, steps_of = sys.argv[2:] or list(MODELS), model_steps
    steps: list[Step] = []
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = steps_of(name, Path(folder))
            except bundle.InputError as error:
                print(f"{name}: {error}", flush=True)
                continue
        steps += found
        for step in found:
            told = f"{step.before:.4g} -> {step.after:.4g}"
            bad = f" FAULT {', '.join(step.faults)}" if step.faults else ""
            bad += f" ({step.repaired:.4g} by a perfect repair)" if step.repaired >= 0 else ""
            print(f"{name} {step.kind} {told}{bad}: {shlex.join(step.words[4:])}", flush=True)
    print(summary(steps))
    return 0


if __name__ == "__main__":
    sys.exit(main())
