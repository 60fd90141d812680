"""Inputs and reports of the triage campaign: a walk, an orbit, a flight, and their faults."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import bundle
from bundle.cli.main import main

__all__ = ["Workshop", "chain_of_poses", "graph_of", "relative"]


def chain_of_poses(
    seed: int, num_poses: int, num_loops: int, reach: int = 0, noise: float = 0.02
) -> bundle.PoseGraph:
    """A plane walk with closures; ``reach``: largest distance along the walk, 0: any."""
    rng = np.random.default_rng(seed)
    turns = 0.15 * rng.standard_normal(num_poses)
    heading = np.cumsum(turns)
    steps = np.stack([np.cos(heading), np.sin(heading)], 1)
    truth = np.column_stack([np.cumsum(steps, 0), heading])
    first = rng.integers(0, num_poses - 12, num_loops)
    most = reach or num_poses
    second = np.minimum(first + rng.integers(10, max(most, 11), num_loops), num_poses - 1)
    chain = np.stack([np.arange(num_poses - 1), np.arange(1, num_poses)], 1)
    edges = np.vstack([chain, np.stack([first, second], 1)])
    return graph_of(truth, edges, rng, noise)


def graph_of(
    truth: np.ndarray[Any, Any], edges: np.ndarray[Any, Any], rng: Any, noise: float
) -> bundle.PoseGraph:
    """Edges measured with noise that their information states; a noisy start."""
    measured = relative(truth[edges[:, 0]], truth[edges[:, 1]])
    measured = measured + noise * np.array([1, 1, 0.3]) * rng.standard_normal(measured.shape)
    weights = np.diag(1 / (noise * np.array([1, 1, 0.3])) ** 2)
    start = truth + 0.05 * rng.standard_normal(truth.shape)
    return bundle.PoseGraph(
        poses=start,
        edges=edges.astype(np.int32),
        measurements=measured,
        information=np.tile(weights, (len(edges), 1, 1)),
    )


def relative(a: np.ndarray[Any, Any], b: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Pose b in the frame of a."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    d = b[:, :2] - a[:, :2]
    turn = (b[:, 2] - a[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], turn])


@dataclass
class Workshop:
    """A folder of inputs and reports, made once."""

    folder: Path
    seed: int = 0

    def __post_init__(self) -> None:
        self._made: dict[str, Path] = {}
        self._count = 0

    def run(self, command: str, source: Path, *flags: Any) -> Path:
        """Run a command; return its report."""
        self._count += 1
        report = self.folder / f"{self._count}.json"
        output = {
            "refine": ["-o", self.folder / f"{self._count}{source.suffix}", "--overwrite"],
            "vio": ["-o", self.folder / f"{self._count}.tum", "--time-budget", 1],
        }.get(command, [])
        words = [command, source, *output, "--quiet", "--json", report, *flags]
        with contextlib.redirect_stdout(io.StringIO()):
            code = main([str(word) for word in words])
        assert code in (0, 1) and report.exists(), words
        return report

    def graph(self, change: Callable[..., bundle.PoseGraph] | None = None) -> Path:
        """The graph of all faults of graphs, or a changed one, under the same name."""
        graph = chain_of_poses(self.seed, 600, 100)
        return self._save(graph if change is None else change(graph, self._rng()))

    def local_graph(self, reach: int) -> Path:
        """A graph with closures of limited length."""
        return self._save(chain_of_poses(self.seed, 600, 300, reach))

    def grid(self, is_permuted: bool = False) -> Path:
        """A plane grid of poses, with their ids in another order if desired."""
        index = np.arange(3600).reshape(60, 60)
        edges = np.vstack(
            [np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()], 1),
             np.stack([index[:-1].ravel(), index[1:].ravel()], 1)]
        )  # fmt: skip
        truth = np.column_stack([*np.divmod(index.ravel(), 60), np.zeros(3600)]).astype(float)
        graph = graph_of(truth, edges, np.random.default_rng(self.seed), 0.02)
        order = self._rng().permutation(3600) if is_permuted else np.arange(3600)
        place = np.argsort(order)
        return self._save(graph.replace(poses=graph.poses[order], edges=place[graph.edges]))

    def _save(self, graph: bundle.PoseGraph) -> Path:
        self._count += 1
        path = self.folder / str(self._count) / "walk.g2o"
        path.parent.mkdir()
        bundle.save(graph, path)
        return path

    def model(self, change: Callable[..., bundle.Problem] | None = None) -> Path:
        """The model of all faults of models, or a changed one."""
        problem = bundle.synthesize(
            scene="orbit", num_images=30, num_points=600, seed=self.seed
        ).problem
        self._count += 1
        path = self.folder / str(self._count) / "orbit.txt"
        path.parent.mkdir()
        bundle.save(problem if change is None else change(problem, self._rng()), path)
        return path

    def flight(self, change: Callable[..., Any] | None = None, **options: Any) -> Path:
        """The sequence of all faults of odometry, or a changed one."""
        settings = {"duration": 7.0, "motion": "loop", "seed": self.seed, **options}
        sequence = bundle.synthesize_flight(**settings).sequence
        self._count += 1
        path = self.folder / str(self._count) / "flight"
        path.parent.mkdir()
        bundle.save_sequence(sequence if change is None else change(sequence, self._rng()), path)
        return path

    def factor_report(self, scale: float) -> Path:
        """A chain of 2-D poses whose closures have Jacobians wrong by a factor."""
        graph, walk = bundle.FactorGraph(), chain_of_poses(self.seed, 60, 20, noise=0.05)
        for k, pose in enumerate(walk.poses):
            graph.add_variable(k, pose + 0.3 * np.sin(k), "se2", fixed=k == 0)
        root = np.diag(np.sqrt(np.diag(walk.information[0])))
        for (a, b), z in zip(walk.edges.tolist(), walk.measurements, strict=True):
            graph.add_factor(bundle.FunctionFactor([a, b], _Between(z, root, scale)))
        self._count += 1
        report = self.folder / f"{self._count}.json"
        bundle.save_report(graph.solve(check_solution=False), report, name="factors")
        return report

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng(self.seed + 1)


class _Between:
    """A relative pose with its Jacobian, whose rotation column is scaled."""

    def __init__(self, measured: Any, root: Any, scale: float) -> None:
        self.measured, self.root, self.scale = measured, root, scale

    def __call__(self, values: Any) -> Any:
        a, b = (np.asarray(value, float) for value in values)
        residual = relative(a[None], b[None])[0] - self.measured
        residual[2] = (residual[2] + np.pi) % (2 * np.pi) - np.pi
        d = relative(a[None], b[None])[0]
        first = np.array([[-1, 0, d[1]], [0, -1, -d[0]], [0, 0, -1.0]])
        turn = d[2]
        second = np.eye(3)
        second[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        first[:2, 2] *= self.scale
        return self.root @ residual, [self.root @ first, self.root @ second]
