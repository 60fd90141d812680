"""Judge of the judge: recommendations of ``bundle.validate`` on scenes of known truth.

    python -m tests.campaigns.judge COUNT [FIRST SEED] [--json FILE]
    python -m tests.campaigns.judge --from FILE

The second form repeats the decisions of a file under several rules, without a fit. Seeds below
10,000 tuned the rule; its figures are those of other seeds.

Measures, per scene:

- risk of a candidate: RMS distance of its predicted pixels from the true ones, which have neither
  noise nor row shift. At all observations (fit to all), and at held-out observations (fits without
  them). Points with an outlier do not count; a distance counts at most 10 sigma.
- position: RMS error of the projection centres after the best similarity.
- equivalent: the risk of the recommended candidate is at most 1.05 times the smallest risk.
- exact: the recommended candidate is the smallest that contains the truth.
- overfit: it has more lens parameters than this candidate.

"Within one standard error of the best" is no measure: the rule makes it true.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import beta

import bundle
from bundle.judging.validation import judgement
from bundle.judging.validation import validate_problem as validation_module
from bundle.judging.validation.validation_result import Cameras, DecisionRule, decide
from bundle.model.folds import are_repeated, folds_of
from bundle.model.residuals import residuals
from tests.campaigns import judge_scenes

EQUIVALENT = 1.05
_CLIP = 10.0  # sigmas
_CONTAINS = {  # smallest candidate model by the truth's
    "SIMPLE_PINHOLE": "SIMPLE_RADIAL",
    "PINHOLE": "OPENCV",
}


def record(scene: judge_scenes.JudgeScene) -> dict:
    """Validate one scene; return what the measures and further decisions need."""
    fits = []
    fit_candidates = validation_module.fit_candidates

    def kept(*arguments, **keywords):
        fits.extend(fit_candidates(*arguments, **keywords))
        return fits

    shutters = {}
    motion_test = judgement.motion_test

    def tested(plain, rolling, image, shared, rule):
        both = {"plain": plain[shared], "rolling": rolling}
        shutters.update({name: np.round(one, 3).tolist() for name, one in both.items()})
        shutters["shared"] = shared
        return motion_test(plain, rolling, image, shared, rule)

    cameras = []
    cameras_of = judgement.cameras_of

    def known(*arguments):
        cameras.append(cameras_of(*arguments))
        return cameras[0]

    criteria = []
    evidence_between = judgement.evidence_between

    def compared(*arguments):
        criteria.append(evidence_between(*arguments))
        return criteria[0]

    with (
        mock.patch.object(validation_module, "fit_candidates", kept),
        mock.patch.object(judgement, "evidence_between", compared),
        mock.patch.object(judgement, "cameras_of", known),
        mock.patch.object(judgement, "motion_test", tested),
    ):
        found = bundle.validate(scene.problem, num_threads=1)
    test = found.row_test
    evidence = criteria[0] if criteria else np.zeros((len(fits), len(fits)))
    folds = folds_of(scene.problem, found.num_folds, found.seed)
    counts = ~are_repeated(scene.problem, folds)[found.observations]
    return {
        "seed": scene.seed,
        "facts": scene.facts,
        "num_observations": scene.problem.num_observations,
        "candidates": [
            {
                "camera_model": one.camera_model,
                "share": one.share,
                "num_intrinsics": one.num_intrinsics,
                "vetoed": one.vetoed,
                "aic": one.aic,
                "bic": one.bic,
                **_measured(scene, fit),
            }
            for one, fit in zip(found.candidates, fits, strict=True)
        ],
        "cameras": {
            name: np.where(np.isfinite(values), values, -1.0).tolist()
            for name, values in vars(cameras[0]).items()
        },
        "evidence": np.nan_to_num(evidence, posinf=1e9, neginf=-1e9).tolist(),
        "recommended": found.recommended,
        "row_test": None if test is None else [test.anisotropy, test.shear, test.size],
        "image": found.image[counts].tolist(),
        "normalized": np.round(found.normalized[:, counts], 3).tolist(),
        "shutters": shutters,
    }


def _measured(scene: judge_scenes.JudgeScene, fit) -> dict:
    """Return the risks and the position error of one candidate; infinite without a fit."""
    if fit.error:
        return {"risk": np.inf, "held_out_risk": np.inf, "position": np.inf}
    noise = scene.problem.observation_xy - scene.true_xy
    counts = scene.is_clean[scene.problem.observation_point]
    full = residuals(fit.refined)
    held = np.isfinite(fit.held_out).any(axis=1) & counts
    sigma = scene.facts["sigma"]
    poses = fit.refined.cam_from_world
    centers = -Rotation.from_quat(poses[:, :4].copy()).inv().apply(poses[:, 4:].copy())
    return {
        "risk": _rms((full.xy + noise)[counts], sigma),
        "held_out_risk": _rms((fit.held_out + noise)[held], sigma),
        "position": _aligned_rms(centers, scene.centers),
    }


def _rms(distance: np.ndarray, sigma: float) -> float:
    length = np.hypot(*distance.T)
    length = np.minimum(np.where(np.isfinite(length), length, np.inf), _CLIP * sigma)
    return float(np.sqrt(np.mean(length**2)))


def _aligned_rms(centers: np.ndarray, truth: np.ndarray) -> float:
    """Return the RMS distance after the similarity that makes it least (Umeyama 1991)."""
    a, b = centers - centers.mean(0), truth - truth.mean(0)
    u, values, v = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    scale = (values * signs).sum() / (a**2).sum()
    return float(np.sqrt((((scale * a @ (u * signs @ v).T) - b) ** 2).sum(1).mean()))


def generating(entry: dict) -> int | None:
    """Return the smallest candidate that contains the truth; None if none does."""
    facts, names = entry["facts"], [(c["camera_model"], c["share"]) for c in entry["candidates"]]
    model = _CONTAINS.get(facts["model"], facts["model"])
    share = "size" if facts["sharing"] == "all" else facts["sharing"]
    if facts["model"] == "SIMPLE_PINHOLE" and share == "each":
        share = "focal"
    family = list(dict.fromkeys(name for name, _ in names))
    for wider in family[family.index(model) :]:
        for sharing in [share, "each"] if share == "focal" else [share]:
            if (wider, sharing) in names:
                return names.index((wider, sharing))
    return None


def decided(entry: dict, rule: DecisionRule, *, veto: bool = True) -> int:
    """Return the recommended candidate of a record under another rule."""
    return decide(
        np.array(entry["normalized"], float),
        np.array(entry["image"]),
        [one["num_intrinsics"] for one in entry["candidates"]],
        [one["vetoed"] if veto else "" for one in entry["candidates"]],
        rule,
        Cameras(
            **{
                name: np.where(np.array(values) < 0, np.nan, values)
                for name, values in entry["cameras"].items()
            }
        ),
        np.array(entry["evidence"]),
    ).recommended


def measures(entry: dict, chosen: int | None = None) -> dict:
    """Return the measures of a recommendation; by default that of the record."""
    chosen = entry["recommended"] if chosen is None else chosen
    candidates, truth = entry["candidates"], generating(entry)
    one = candidates[chosen]

    def ratio(name: str) -> float:
        return one[name] / min(c[name] for c in candidates)

    return {
        "risk": ratio("risk"),
        "held_out_risk": ratio("held_out_risk"),
        "position": ratio("position"),
        "exact": chosen == truth,
        "overfit": truth is not None
        and one["num_intrinsics"] > candidates[truth]["num_intrinsics"],
        "vetoed": any(c["vetoed"] for c in candidates if c["share"] == "each"),
        "shifted": entry["facts"]["rows"] > 0,
        "one_lens": one["share"] not in ("each", "focal"),
    }


def is_misled(entry: dict) -> bool:
    """Return True for shifted rows where the errors alone recommend a lens per image."""
    chosen = entry["candidates"][decided(entry, DecisionRule(), veto=False)]
    return entry["facts"]["rows"] > 0 and chosen["share"] in ("each", "focal")


def interval(count: int, total: int) -> str:
    """Return a share with its 95 % interval of Clopper and Pearson."""
    if not total:
        return "-"
    low = beta.ppf(0.025, count, total - count + 1) if count else 0.0
    high = beta.ppf(0.975, count + 1, total - count) if count < total else 1.0
    return f"{count}/{total} = {count / total:.3f} [{low:.3f}, {high:.3f}]"


def table(entries: list[dict], choices: list[int] | None = None) -> str:
    """Return the table of the measures over scenes."""
    choices = [entry["recommended"] for entry in entries] if choices is None else choices
    found = [measures(entry, chosen) for entry, chosen in zip(entries, choices, strict=True)]
    shifted = [one for one in found if one["shifted"]]
    clean = [one for one in found if not one["shifted"]]

    def share(rows: list[dict], test) -> str:
        return interval(sum(bool(test(one)) for one in rows), len(rows))

    ranks = np.quantile([one["position"] for one in found], [0.5, 0.9, 0.95])
    misled = [one for entry, one in zip(entries, found, strict=True) if is_misled(entry)]
    rows = [
        ("exact", share(found, lambda one: one["exact"])),
        ("equivalent (risk <= 1.05)", share(found, lambda one: one["risk"] <= EQUIVALENT)),
        (
            "  at held-out observations",
            share(found, lambda one: one["held_out_risk"] <= EQUIVALENT),
        ),
        ("overfit", share(found, lambda one: one["overfit"])),
        ("position / best: median, p90, p95", ", ".join(f"{value:.2f}" for value in ranks)),
        ("'each' vetoed: rows shifted", share(shifted, lambda one: one["vetoed"])),
        ("  where errors alone recommend it", share(misled, lambda one: one["vetoed"])),
        ("'each' vetoed: clean", share(clean, lambda one: one["vetoed"])),
        ("one lens recommended: rows shifted", share(shifted, lambda one: one["one_lens"])),
    ]
    return "\n".join(f"{name:38s} {value}" for name, value in rows)


def line_of(entry: dict) -> str:
    """Return one line on a scene: truth, recommendation, measures."""
    facts, found = entry["facts"], measures(entry)
    chosen = entry["candidates"][entry["recommended"]]
    best = min(entry["candidates"], key=lambda one: one["risk"])
    marks = [
        "RISK" if found["risk"] > EQUIVALENT else "",
        "OVER" if found["overfit"] else "",
        "VETO" if found["vetoed"] != found["shifted"] else "",
    ]
    return (
        f"{entry['seed']:6d} {facts['model']}/{facts['sharing']} {facts['layout']} "
        f"{facts['num_images']} images, {entry['num_observations']} obs, {facts['sigma']:.2f} px"
        f"{' rows' if facts['rows'] else ''}"
        f"{' twins' if facts['duplicated'] else ''}: {chosen['camera_model']}/{chosen['share']} "
        f"(best {best['camera_model']}/{best['share']}) risk {found['risk']:.3f} "
        f"{found['held_out_risk']:.3f} position {found['position']:.2f} {' '.join(marks)}"
    ).rstrip()


def compare_rules(entries: list[dict]) -> str:
    """Return one row per rule: the decision's numbers and what they recommend."""
    base = DecisionRule()
    rules = {
        "default": (base, True),
        "no veto": (base, False),
        "1.5 SE, 0.5 %": (replace(base, num_standard_errors=1.5, threshold=0.005), True),
        "1 SE": (replace(base, num_standard_errors=1.0), True),
        "threshold 0": (replace(base, threshold=0.0), True),
        "threshold 0.5 %": (replace(base, threshold=0.005), True),
        "clip 2": (replace(base, clip=2.0), True),
        "clip 10": (replace(base, clip=10.0), True),
        "cameras ignored": (replace(base, movement=1e9, price=1.0), True),
        "criteria ignored": (replace(base, evidence=np.inf), True),
    }
    rows = [f"{'rule':16s} exact equivalent (held out) overfit  p90 position"]
    for name, (rule, veto) in rules.items():
        found = [measures(entry, decided(entry, rule, veto=veto)) for entry in entries]
        mean = {key: np.mean([one[key] for one in found]) for key in ("exact", "overfit")}
        same = [np.mean([m[k] <= EQUIVALENT for m in found]) for k in ("risk", "held_out_risk")]
        p90 = np.quantile([one["position"] for one in found], 0.9)
        rows.append(
            f"{name:16s} {mean['exact']:5.2f} {same[0]:10.3f} {same[1]:10.3f} "
            f"{mean['overfit']:7.3f} {p90:13.2f}"
        )
    return "\n".join(rows)


def main() -> int:
    """Run or reload scenes and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("count", type=int, nargs="?", default=200)
    parser.add_argument("first", type=int, nargs="?", default=10_000)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--from", dest="source", type=Path)
    given = parser.parse_args()
    if given.source:
        entries = [json.loads(line) for line in given.source.read_text().splitlines()]
        print(*map(line_of, entries), sep="\n")
    else:
        entries = []
        for seed in range(given.first, given.first + given.count):
            entries.append(record(judge_scenes.make(seed)))
            print(line_of(entries[-1]), flush=True)
            if given.json:
                with given.json.open("a") as file:
                    file.write(json.dumps(entries[-1]) + "\n")
    print(table(entries), compare_rules(entries), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
