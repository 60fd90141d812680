"""Healthy and degenerate scenes under a rolling shutter: only the degenerate ones are named.

python -m tests.campaigns.degenerate_shutters COUNT [SEED]
"""

from __future__ import annotations

import sys

import numpy as np

import bundle
from bundle.analysis.diagnosis.shutter_modes import shutter_modes
from bundle.synthetic.video_scene import Car, DroneGrid, Motion, PhoneWalk, film

MODELS = ("PINHOLE", "SIMPLE_RADIAL", "OPENCV")
HEALTHY = ("phone", "car", "drone", "phone that does not turn", "drone that does not turn")
PLANTED = {
    "flat": "flat_scene_parallel_readout",
    "flat, back without turning": "flat_scene_parallel_readout",
    "flat, pure translation": "flat_scene_pure_translation",
    "table": "flat_scene_parallel_readout",
    "road": "flat_scene_parallel_readout",
}
"""Kind of the finding of each planted degeneracy."""


class Table(PhoneWalk):
    """A walk around a table with flat objects."""

    def draw_points(self, rng: np.random.Generator, count: int) -> np.ndarray:
        return rng.uniform([-1.5, -1.5, 0], [1.5, 1.5, 1e-9], (count, 3))


class Road(Car):
    """A drive through a desert."""

    def draw_points(self, rng: np.random.Generator, count: int) -> np.ndarray:
        points = super().draw_points(rng, count)
        points[:, 1:] = rng.uniform([-6, 0], [6, 1e-9], (count, 2))
        return points


def motion_of(name: str, rng: np.random.Generator, count: int) -> Motion:
    """Return the motion of a scene by name."""
    if name.startswith("phone"):
        return PhoneWalk(rng, count)
    if name.startswith(("car", "road", "table")):
        return {"car": Car, "road": Road, "table": Table}[name](rng, count)
    flat = name.startswith("flat")
    return DroneGrid(rng, count, 0.0 if flat else 3.0, turns="back" not in name)


def scene_of(name: str, seed: int) -> bundle.Problem:
    """Return the true problem of a seeded scene."""
    rng = np.random.default_rng([seed, len(name)])
    count = int(rng.integers(6, 40))
    options = bundle.SceneOptions(
        scene={"p": "orbit", "t": "orbit", "c": "street", "r": "street"}.get(name[0], "drone_grid"),
        num_images=count,
        num_points=count * int(rng.integers(14, 30)),
        rolling_shutter=float(rng.uniform(0.3, 0.9)),
        camera_model=str(rng.choice(MODELS)),
        seed=seed,
    )
    turns = "not turn" not in name and "pure" not in name
    return film(options, motion_of(name, rng, count), turning=turns).ground_truth


def kinds(problem: bundle.Problem) -> list[str]:
    """Return the kinds of the findings about the rolling shutter."""
    return [mode.kind for mode in shutter_modes(problem)]


def main(count: int, seed: int) -> int:
    """Print every scene with a wrong answer; return their number."""
    wrong = 0
    for name, expected in [*((name, None) for name in HEALTHY), *PLANTED.items()]:
        named = 0
        for k in range(seed, seed + count):
            found = kinds(scene_of(name, k))
            named += bool(found)
            if found != ([] if expected is None else [expected]):
                wrong += 1
                print(f"{name}, seed {k}: expected {expected}, found {found}", flush=True)
        print(f"{name}: {named} of {count} named", flush=True)
    return wrong


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1) > 0)
