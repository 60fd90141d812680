"""Standardized residuals: power and false alarms of their test, and filters against raw errors.

1. Errors of the minimal detectable size, 3 to 200 px, are planted one by one along the weakest
   direction of an observation; the problem is solved again. The noise is 0.7 to 7 px, in images of
   1,280 to 12,800 px, as linear theory needs. At the level 0.1 % (limit 3.29), 80 % have to be
   found, and 0.1 % of the clean observations.
2. Errors of 3 to 200 px in some of the observations: rounds with raw and with standardized errors
   remove them. The errors of positions against the truth, as geometric means of each group.

python -m tests.campaigns.standardized ERRORS SCENES [SEED]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar

import numpy as np

import bundle

T = TypeVar("T")
LIMIT = 3.2905267314919255  # the normal distribution exceeds it on both sides in 0.1 %
KINDS = ("street", "orbit", "drone_grid", "photo_collection")
PER_SCENE = 10
TIGHT = {"function_tolerance": 1e-10, "num_threads": 1}
SHARES = (0.01, 0.05, 0.1)


class Planted(NamedTuple):
    """Tests of one scene."""

    sizes: list[float]  # of the planted errors [px]
    num_found: int
    num_clean: int
    num_false: int


def along_weakest(found: bundle.Reliability) -> np.ndarray:
    """Return the standardized residual along the weakest direction; NaN if nothing checks it."""
    residual = found.standardized * np.sqrt(found.redundancy)
    least = np.where(np.isfinite(found.minimal_detectable_error), found.least_redundancy, np.nan)
    return (residual * found.weakest_direction).sum(axis=1) / np.sqrt(least)


def plant(seed: int) -> Planted:
    """Plant errors in a scene, one by one."""
    rng = np.random.default_rng(seed)
    enlarged = float(np.exp(rng.uniform(0, np.log(10))))
    sigma = 0.7 * enlarged
    scene = bundle.synthesize(
        scene=KINDS[seed % len(KINDS)], num_images=10, num_points=100, pixel_noise=sigma,
        image_size=(int(1280 * enlarged), int(960 * enlarged)), seed=seed,
    )  # fmt: skip
    sigmas = np.full(scene.problem.num_observations, sigma)
    problem = scene.ground_truth.replace(
        observation_xy=scene.problem.observation_xy, observation_sigma=sigmas
    )
    problem = bundle.solve(problem, **TIGHT).problem
    before = bundle.reliability(problem)
    w = along_weakest(before)
    w = w[np.isfinite(w)]
    sizes = before.minimal_detectable_error
    usable = np.flatnonzero((sizes >= 3) & (sizes <= 200))
    # Weak observations as often as strong ones.
    logs = np.log(sizes[usable])
    wanted = rng.uniform(logs.min(), logs.max(), PER_SCENE)
    chosen = usable[np.abs(logs - wanted[:, None]).argmin(axis=1)]
    num_found = 0
    for row in chosen.tolist():
        moved = problem.observation_xy.copy()
        sign = rng.choice([-1.0, 1.0])
        moved[row] += sign * sizes[row] * before.weakest_direction[row]
        after = bundle.reliability(bundle.solve(problem.replace(observation_xy=moved), **TIGHT))
        num_found += bool(abs(along_weakest(after)[row]) > LIMIT)
    return Planted(sizes[chosen].tolist(), num_found, len(w), int((np.abs(w) > LIMIT).sum()))


class Compared(NamedTuple):
    """Errors of positions after both filters, in shares of the extent."""

    group: str
    raw: float
    standardized: float


def compare(seed: int, loss: str = "trivial") -> Compared:
    """Filter one scene by raw and by standardized errors."""
    rng = np.random.default_rng(seed)
    kind, share = KINDS[seed % len(KINDS)], SHARES[seed // len(KINDS) % len(SHARES)]
    scene = bundle.synthesize(scene=kind, num_images=12, num_points=200, pixel_noise=0.7, seed=seed)
    problem, truth = scene.problem, scene.ground_truth
    xy = problem.observation_xy.copy()
    rows = rng.permutation(len(xy))[: round(share * len(xy))]
    angles = rng.uniform(0, 2 * np.pi, len(rows))
    lengths = np.exp(rng.uniform(np.log(3), np.log(200), len(rows)))
    xy[rows] += lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    errors = []
    for standardized in (False, True):
        found = bundle.solve_rounds(
            problem.replace(observation_xy=xy), num_rounds=5, standardized=standardized,
            loss=loss, num_threads=1,
        )  # fmt: skip
        errors.append(bundle.evaluate(found.problem, truth).position.rmse)
    return Compared(f"{kind} {share:g}", *errors)


def ratios(found: list[Compared]) -> Iterator[tuple[str, int, float]]:
    """Yield each group, its size, and the geometric mean of standardized over raw errors."""
    groups = [one.group.split()[0] for one in found], [one.group.split()[1] for one in found]
    for names in groups:
        for name in dict.fromkeys(names):
            logs = [
                np.log(one.standardized / one.raw)
                for one, own in zip(found, names, strict=True)
                if own == name
            ]
            yield name, len(logs), float(np.exp(np.mean(logs)))


def tried(function: Callable[[int], T], seeds: Iterable[int]) -> list[T]:
    """Return the outcome of each scene, and print the refusal of one without full rank."""
    done = []
    for seed in seeds:
        try:
            done.append(function(seed))
        except bundle.InputError as refusal:
            print(f"scene {seed}: {refusal}")
    return done


def main(num_errors: int, num_scenes: int, seed: int = 0) -> None:
    """Print the rates and the ratios."""
    done = tried(plant, range(seed, seed - (-num_errors // PER_SCENE)))
    sizes = np.concatenate([one.sizes for one in done])
    clean = sum(one.num_clean for one in done)
    print(
        f"{len(sizes)} errors of {sizes.min():.1f} to {sizes.max():.1f} px (median "
        f"{np.median(sizes):.1f}): {100 * sum(one.num_found for one in done) / len(sizes):.1f} % "
        f"found; {100 * sum(one.num_false for one in done) / clean:.3f} % of {clean} false alarms"
    )
    found = tried(compare, range(seed, seed + num_scenes))
    for one in found:
        print(*one)
    for name, count, ratio in ratios(found):
        print(f"{name}: {count} scenes, standardized / raw {ratio:.3f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
