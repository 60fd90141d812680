"""Record all answers of a version of the package, and compare two records.

    python tools/same_answers.py record OLD.json [--data DIR] [--only WORD]
    python tools/same_answers.py compare OLD.json NEW.json

Moves of code must not change an answer. A record has, of every command line below, the exit code,
the text and the files; of every public function below, the values that it returns for seeded
inputs; and the public names, signatures and flags. Each entry is made twice: what differs between
two runs of one version (times, memory, the order of a sum) is not compared. So the tool needs no
list of keys that may change. `compare` prints each difference and exits 1 if there is one.

Commands run with one thread in a folder of their own. The folder, the package and the data are
written as $HERE, $PACKAGE and $DATA.
"""

from __future__ import annotations

import argparse
import bz2
import hashlib
import inspect
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
VARIES = "<varies>"
"""Stands for a value that differs between two runs of one version."""

MODELS = ("$REPO/data/street_colmap",)
SHARED_MODELS = tuple(
    f"$DATA/{name}"
    for name in (
        "colmap/maupertuis",
        "colmap/bartoszek",
        "colmap/crane_mast",
        "colmap/batmo_rigs",
        "colmap/lund_door",
        "colmap/video48",
        "colmap/vr_opencv",
        "rigs/kitti26_stereo_rig",
    )
)
GRAPHS = tuple(
    f"$DATA/g2o/{name}" for name in ("tinyGrid3D.g2o.bz2", "MIT.g2o.bz2", "ring2d_wound.g2o")
)
SMALL = "$REPO/data/street_colmap"

# A case is a list of commands that run one after the other in one folder; "out" is theirs.
EACH_MODEL: tuple[tuple[str, ...], ...] = (
    ("info {m}", "info {m} --json info.json"),
    ("refine {m} -o out --json r.json",),
    ("refine {m} -o out --loss cauchy --rounds 3 --json r.json", "evaluate out --reference {m}"),
    ("refine {m} -o out --backend ceres --json r.json",),
    ("inspect {m} --json i.json",),
    ("covariance {m} --of intrinsics -o c.npz --json c.json",),
    ("diagnose {m} --json d.json",),
    ("check {m} --json k.json",),
    ("convert {m} out.txt", "convert {m} out.nvm", "info out.nvm"),
)
EACH_GRAPH: tuple[tuple[str, ...], ...] = (
    ("info {m}",),
    ("refine {m} -o out.g2o --json r.json", "evaluate out.g2o --reference {m}"),
    ("refine {m} -o out.g2o --certify --json r.json",),
    ("inspect {m} --json i.json", "diagnose {m} --json d.json", "check {m} --json k.json"),
    ("covariance {m} -o c.npz --json c.json",),
)
COMMANDS = (
    *("info", "inspect", "refine", "compare", "validate", "check", "covariance", "diagnose"),
    *("align", "merge", "evaluate", "report", "triage", "vio", "convert", "synth", "demo"),
)
ONCE: tuple[tuple[str, ...], ...] = (
    ("--help", "--version", *(f"{name} --help" for name in COMMANDS)),
    ("synth scene --seed 3 --images 12 --points 400", "refine scene -o out",
     "refine scene -o two --hold-out 10 --json r.json",
     "evaluate two --reference scene_ground_truth"),
    ("synth scene --seed 4 --images 12 --points 400 --gravity 0.5 --orientations 1",
     "refine scene -o a --gravity scene_gravity.txt --orientations scene_orientations.txt"),
    ("synth scene --seed 5 --images 12 --points 400 --rolling-shutter 0.5 --scene drone-grid",
     "refine scene -o out --rolling-shutter rows --json r.json", "validate scene --json v.json"),
    ("synth flight --scene flight --duration 8 --seed 2", "vio flight -o track.tum --json v.json",
     "info flight", "evaluate track.tum --reference flight/ground_truth.csv"),
    (f"validate {SMALL} --json v.json",),
    (f"compare {SMALL} --repeat 1 --solvers dense_schur --json c.json",),
    (f"report {SMALL} -o page.html",),
    (f"refine {SMALL} -o a --json a.json", f"refine {SMALL} -o b --loss huber --json b.json",
     "triage a.json b.json --json t.json", "merge a b -o c", "align a --reference b -o d"),
    (f"refine {SMALL} -o a --checkpoint s --rounds 2",
     f"refine {SMALL} -o b --resume s --rounds 2"),
    (f"refine {SMALL} -o a --only-images 1-5 --set 'camera *: f prior 2%'",),
    ("refine missing -o out", "refine . -o out", f"refine {SMALL}",
     f"refine {SMALL} -o out --loss x", f"refine {SMALL} -o out --threads -1"),
    ("refine $DATA/georeferenced/brighton_gps -o out --gps exif --json r.json",),
    ("info $DATA/georeferenced/copr_gcp", "info $DATA/formats/opensfm_berlin",
     "info $DATA/formats/bundler_lightbender", "info $DATA/degenerate/pratikk0"),
    ("info $DATA/imu/euroc_V1_02", "info $DATA/rolling_shutter/phone"),
)  # fmt: skip


def cases() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the name and the command lines of each case."""
    for models, tables in ((MODELS + SHARED_MODELS, EACH_MODEL), (GRAPHS, EACH_GRAPH)):
        for model in models:
            for lines in tables:
                yield _named(tuple(line.format(m=model) for line in lines))
    for lines in ONCE:
        yield _named(lines)


def _named(lines: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    return "; ".join(lines)[:160], lines


def run_case(lines: tuple[str, ...], places: dict[str, str]) -> dict[str, Any]:
    """Run command lines in a new folder; return exit codes, texts and files."""
    found: dict[str, Any] = {}
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment |= {"COLUMNS": "100", "NO_COLOR": "1", "SOURCE_DATE_EPOCH": "0"}
    with tempfile.TemporaryDirectory(prefix="same") as folder:
        places = {**places, "$HERE": str(Path(folder).resolve())}
        for line in lines:
            words = [_with_places(word, places) for word in _split(line)]
            done = subprocess.run(
                [sys.executable, "-m", "bundle", *words],
                cwd=folder, env=environment, capture_output=True, text=True, check=False,
                timeout=900,
            )  # fmt: skip
            found[line] = {
                "exit": done.returncode,
                "out": _without_places(done.stdout, places).splitlines(),
                "err": _without_places(done.stderr, places).splitlines(),
            }
        for path in sorted(Path(folder).rglob("*")):
            if path.is_file():
                found[str(path.relative_to(folder))] = _content(path, places)
    return found


def _split(line: str) -> list[str]:
    return [word.strip("'") for word in re.findall(r"'[^']*'|\S+", line)]


def _with_places(text: str, places: dict[str, str]) -> str:
    for name, path in places.items():
        text = text.replace(name, path)
    return text


def _without_places(text: str, places: dict[str, str]) -> str:
    for name, path in sorted(places.items(), key=lambda item: -len(item[1])):
        text = text.replace(path, name)
    return text


def _content(path: Path, places: dict[str, str]) -> Any:
    data = path.read_bytes()
    if path.suffix == ".bz2":
        data = bz2.decompress(data)
    try:
        text = _without_places(data.decode(), places)
    except UnicodeDecodeError:
        return hashlib.sha256(data).hexdigest()
    if path.suffix == ".json":
        return json.loads(text)
    if len(text) > 100_000:  # a model as text: its digest
        return hashlib.sha256(text.encode()).hexdigest()
    return text.splitlines()


def functions() -> dict[str, Callable[[], Any]]:
    """Return a call on seeded inputs of each public function."""
    import bundle

    def scene(name: str = "street", **changes: Any) -> Any:
        sizes = {"num_images": 8, "num_points": 150, "seed": 5, **changes}
        return bundle.synthesize(scene=name, **sizes)

    flight = bundle.synthesize_flight(duration=4.0, seed=2, num_tracks=30)
    start, truth = scene().problem, scene().ground_truth
    solved = bundle.solve(start, num_threads=1)
    rng = np.random.default_rng(0)
    accel, points = rng.normal(size=(50, 3)), rng.uniform(1, 2, (3, 3))
    square = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    identity = np.array([0.0, 0, 0, 1, 0, 0, 0])
    poses = np.tile(identity, (3, 1))
    poses[:, 4] = [0.0, 1.0, 2.1]
    edges = np.array([[0, 1], [1, 2], [2, 0]])
    measured = np.tile(identity, (3, 1))
    measured[:, 4] = [1.0, 1.0, -2.0]
    graph = bundle.PoseGraph(
        poses=poses, edges=edges, measurements=measured, information=np.tile(np.eye(6), (3, 1, 1))
    )
    imu = flight.sequence
    return {
        "align": lambda: bundle.align(solved.problem, to=truth),
        "camera_models": bundle.camera_models,
        "certify": lambda: bundle.certify(graph),
        "change_camera_model": lambda: bundle.change_camera_model(start, "OPENCV"),
        "check_gradients": lambda: bundle.check_gradients(
            bundle.PriorFactor("x", [1.0, 2.0], np.eye(2)), {"x": [0.0, 1.0]}
        ),
        "check_jacobians": lambda: bundle.check_jacobians(start, samples_per_image=5),
        "chi2_kinds": lambda: bundle.chi2_kinds(graph),
        "compare_trajectories": lambda: bundle.compare_trajectories(
            *[bundle.run_odometry(imu).trajectory] * 2
        ),
        "covariance": lambda: bundle.covariance(solved.problem, num_threads=1),
        "covariance of a graph": lambda: bundle.covariance(graph),
        "describe": lambda: bundle.describe(start),
        "diagnose": lambda: bundle.diagnose(solved.problem),
        "diagnose a graph": lambda: bundle.diagnose(graph),
        "evaluate": lambda: bundle.evaluate(solved.problem, truth),
        "excitation": lambda: bundle.excitation(accel),
        "filter_observations": lambda: bundle.filter_observations(solved.problem),
        "gauge_freedom": lambda: bundle.gauge_freedom(start),
        "hold_out": lambda: bundle.hold_out(start, 20.0, 1),
        "initial_poses": lambda: bundle.initial_poses(graph),
        "initialize_vio": lambda: bundle.initialize_vio(imu),
        "inspect": lambda: bundle.inspect(start),
        "inspect a graph": lambda: bundle.inspect(graph),
        "inspect_graph": lambda: bundle.inspect_graph(square),
        "merge": lambda: bundle.merge(truth, solved.problem),
        "pose_graph_chi2": lambda: bundle.pose_graph_chi2(graph),
        "project": lambda: bundle.project(
            "PINHOLE", [500.0, 500, 320, 240], points, jacobians=True
        ),
        "reprojection_errors": lambda: bundle.reprojection_errors(start),
        "run_odometry": lambda: bundle.run_odometry(imu),
        "share_cameras": lambda: bundle.share_cameras(bundle.split_cameras(start)),
        "solve": lambda: bundle.solve(start, num_threads=1),
        "solve by Ceres": lambda: bundle.solve(
            start, num_threads=1, backend="ceres", loss="cauchy"
        ),
        "solve a graph": lambda: bundle.solve(graph),
        "solve_rounds": lambda: bundle.solve_rounds(start, num_rounds=2, num_threads=1),
        "split_cameras": lambda: bundle.split_cameras(start),
        "synthesize": lambda: scene("orbit"),
        "synthesize_flight": lambda: flight,
        "to_global_shutter": lambda: bundle.to_global_shutter(scene(rolling_shutter=0.5).problem),
        "validate": lambda: bundle.validate(start, num_folds=3),
    }  # fmt: skip


def values(of: Any, depth: int = 0) -> Any:
    """Return public values of an object as JSON, arrays as digests."""
    if isinstance(of, np.ndarray):
        return (
            f"{of.dtype}{of.shape}{hashlib.sha256(np.ascontiguousarray(of).tobytes()).hexdigest()}"
        )
    if of is None or isinstance(of, (bool, int, str)):
        return of
    if isinstance(of, (float, np.generic)):
        return repr(of)
    if isinstance(of, dict):
        return {str(key): values(one, depth + 1) for key, one in of.items()}
    if isinstance(of, (list, tuple)):
        return [values(one, depth + 1) for one in of]
    if depth > 5 or callable(of):
        return type(of).__name__
    names = [name for name in dir(of) if not name.startswith("_")]
    found: dict[str, Any] = {"type": type(of).__name__, "repr": repr(of).splitlines()}
    for name in names:
        try:
            value = getattr(of, name)
        except Exception as error:  # an answer too
            value = f"{type(error).__name__}: {error}"
        if not callable(value):
            found[name] = values(value, depth + 1)
    return found


def interface() -> dict[str, Any]:
    """Return the public names with their signatures."""
    import bundle

    found: dict[str, Any] = {}
    for name in sorted(bundle.__all__):
        one = getattr(bundle, name)
        try:
            found[name] = str(inspect.signature(one)) if callable(one) else type(one).__name__
        except ValueError:
            found[name] = type(one).__name__
        if inspect.isclass(one):
            found[name] = [found[name], [key for key in dir(one) if not key.startswith("_")]]
    return found


def agreed(one: Any, other: Any) -> Any:
    """Return what two runs of one version agree on; VARIES elsewhere."""
    if isinstance(one, dict) and isinstance(other, dict):
        keys = [*one, *(key for key in other if key not in one)]
        return {
            key: agreed(one[key], other[key]) if key in one and key in other else VARIES
            for key in keys
        }
    if isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            return VARIES
        return [agreed(a, b) for a, b in zip(one, other, strict=True)]
    if one == other:
        return one
    if isinstance(one, str) and isinstance(other, str):
        words, others = one.split(), other.split()
        if len(words) == len(others):
            return " ".join(a if a == b else VARIES for a, b in zip(words, others, strict=True))
    return VARIES


def differences(old: Any, new: Any, place: str = "") -> Iterator[str]:
    """Yield the places where two records differ."""
    if VARIES in (old, new):
        return
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*old, *(key for key in new if key not in old)]:
            if key not in old or key not in new:
                yield f"{place}/{key}: only in the {'new' if key in new else 'old'} record"
            else:
                yield from differences(old[key], new[key], f"{place}/{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from differences(a, b, f"{place}[{k}]")
    elif isinstance(old, str) and isinstance(new, str) and VARIES in old + new:
        a, b = old.split(), new.split()
        pairs = zip(a, b, strict=False)
        if len(a) != len(b) or any(x != y and VARIES not in (x, y) for x, y in pairs):
            yield f"{place}: {old!r} -> {new!r}"
    elif old != new:
        yield f"{place}: {str(old)[:200]!r} -> {str(new)[:200]!r}"


def record(target: Path, data: Path, only: str) -> None:
    """Write a record of this version."""
    package = subprocess.run(
        [sys.executable, "-c", "import bundle; print(bundle.__path__[0])"],
        capture_output=True, text=True, check=True,
    ).stdout.strip()  # fmt: skip
    places = {"$DATA": str(data.resolve()), "$REPO": str(ROOT), "$PACKAGE": package}
    found: dict[str, Any] = {"interface": interface(), "commands": {}, "functions": {}}
    for name, lines in cases():
        if only not in name:
            continue
        print(name, file=sys.stderr)
        found["commands"][name] = agreed(run_case(lines, places), run_case(lines, places))
    for name, call in functions().items() if not only else ():
        print(name, file=sys.stderr)
        found["functions"][name] = agreed(*(_answer(call) for _ in range(2)))
    target.write_text(json.dumps(found, indent=1))


def _answer(call: Callable[[], Any]) -> Any:
    try:
        return values(call())
    except Exception as error:  # an answer too
        return f"{type(error).__name__}: {error}"


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("record")
    one.add_argument("target", type=Path)
    one.add_argument(
        "--data", type=Path, default=Path(os.environ.get("BUNDLE_DATA", "../shared/data"))
    )
    one.add_argument("--only", default="")
    two = commands.add_parser("compare")
    two.add_argument("old", type=Path)
    two.add_argument("new", type=Path)
    given = parser.parse_args()
    if given.command == "record":
        record(given.target, given.data, given.only)
        return 0
    found = list(differences(json.loads(given.old.read_text()), json.loads(given.new.read_text())))
    print("\n".join(found) or "The same answers.")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
