"""Types of the C++ core, one section a binding file."""

import os
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__version__: str

# The classes above that the core reads, by some of their arrays.
class _Problem(Protocol):
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def observation_xy(self) -> NDArray[np.float64]: ...

class _PoseGraph(Protocol):
    @property
    def poses(self) -> NDArray[np.float64]: ...
    @property
    def measurements(self) -> NDArray[np.float64]: ...

class _Restrictions(Protocol):
    @property
    def held_pose_parts(self) -> NDArray[np.uint8] | None: ...
    @property
    def camera_tie(self) -> NDArray[np.int32] | None: ...

class _Ranks(Protocol):
    rank: int
    num_ranks: int
    traffic: dict[str, list[float]]

class InputError(ValueError): ...
class NotEnoughMemoryError(InputError): ...

# bind_problem.cpp
def validate(problem: _Problem) -> None: ...
def freeze(array: NDArray[Any]) -> NDArray[Any]: ...
def is_immutable(array: NDArray[Any]) -> bool: ...
def reprojection_errors(
    problem: _Problem, num_threads: int, cheirality: str
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...
def reprojection_residuals(
    problem: _Problem, num_threads: int, cheirality: str
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...
def linearize(
    problem: _Problem, cheirality: str, rotation_offsets: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]: ...

# bind_cameras.cpp
PROJECTION_VALID: int
PROJECTION_BEHIND: int
PROJECTION_UNDEFINED: int

def camera_models() -> list[tuple[str, list[tuple[str, str]], str]]: ...
def project(
    model: str, params: NDArray[np.float64], points: NDArray[np.float64], jacobians: bool
) -> tuple[
    NDArray[np.float64],
    NDArray[np.int8],
    NDArray[np.float64] | None,
    NDArray[np.float64] | None,
]: ...

# bind_bal.cpp
def read_bal(
    path: str | os.PathLike[str],
    progress: Callable[[int], None] | None = None,
) -> tuple[
    NDArray[np.float64],  # cam_from_world (num_images, 7)
    NDArray[np.float64],  # rotations (num_images, 3): the file's angle-axis
    NDArray[np.float64],  # camera_params (num_images, 5): f cx cy k1 k2
    NDArray[np.float64],  # points (num_points, 3)
    NDArray[np.int32],  # observation_image (num_observations,)
    NDArray[np.int32],  # observation_point (num_observations,)
    NDArray[np.float64],  # observation_xy (num_observations, 2)
]: ...
def survey_bal(
    path: str | os.PathLike[str],
) -> tuple[
    int,  # num_images
    int,  # num_observations
    NDArray[np.int32],  # first image of each point (num_points,); num_images if there is none
    NDArray[np.int32],  # last image of each point (num_points,); -1 if there is none
    NDArray[np.int32],  # observations of each point (num_points,)
]: ...
def read_bal_part(
    path: str | os.PathLike[str],
    place: NDArray[np.int32],  # (num_points,) index in the part, -1: not in it
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int32],
    NDArray[np.int32],
    NDArray[np.float64],
]: ...  # as read_bal

class BalStream:
    def __init__(
        self, paths: list[str | os.PathLike[str]], num_images: int, num_points: int
    ) -> None: ...
    def add_observations(
        self,
        camera_params: NDArray[np.float64],
        observation_image: NDArray[np.int32],
        observation_point: NDArray[np.int32],
        observation_xy: NDArray[np.float64],
    ) -> None: ...
    def add_cameras(
        self, file: int, cam_from_world: NDArray[np.float64], camera_params: NDArray[np.float64]
    ) -> None: ...
    def add_points(self, file: int, points: NDArray[np.float64]) -> None: ...
    def close(self) -> None: ...

def write_bal_like(
    source: str | os.PathLike[str],
    num_observations: int,
    path: str | os.PathLike[str],
    cam_from_world: NDArray[np.float64],
    camera_params: NDArray[np.float64],
    points: NDArray[np.float64],
    rotations: NDArray[np.float64],
    keeps_rotation: NDArray[np.bool_],
    compression: str,
) -> None: ...
def write_bal(
    path: str | os.PathLike[str],
    cam_from_world: NDArray[np.float64],
    camera_params: NDArray[np.float64],
    points: NDArray[np.float64],
    observation_image: NDArray[np.int32],
    observation_point: NDArray[np.int32],
    observation_xy: NDArray[np.float64],
    rotations: NDArray[np.float64],
    keeps_rotation: NDArray[np.bool_],
    compression: str,
    progress: Callable[[int], None] | None = None,
) -> None: ...

# bind_point_tracks.cpp
def read_point_tracks(
    path: str | os.PathLike[str],
    skip: int,
    num_lines: int,
    num_images: int,
    num_points: int,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]: ...  # PointTracks of core/io/point_tracks.h by name
def read_tracks_csv(
    path: str | os.PathLike[str],
    images: list[bytes],
    names: bytes,
    ends: NDArray[np.int64],
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]: ...

# bind_json_models.cpp; structs of core/io/json_models.h by name
def read_openmvg(
    path: str | os.PathLike[str], progress: Callable[[int], None] | None = None
) -> dict[str, Any]: ...
def read_opensfm(
    path: str | os.PathLike[str], entry: int, progress: Callable[[int], None] | None = None
) -> dict[str, Any]: ...

# bind_colmap.cpp
class ColmapModel:
    @property
    def is_binary(self) -> bool: ...
    @property
    def has_changed(self) -> bool: ...
    @property
    def names_with_spaces(self) -> dict[int, str]: ...
    @property
    def image_poses(self) -> NDArray[np.float64]: ...
    def files(self) -> dict[str, bytes]: ...
    def write(
        self,
        folder: str | os.PathLike[str],
        cam_from_world: NDArray[np.float64],
        camera_params: NDArray[np.float64],
        points: NDArray[np.float64],
        point_errors: NDArray[np.float64],
        rig_from_world: NDArray[np.float64],
        sensor_from_rig: NDArray[np.float64],
        point_ids: NDArray[np.int64],
    ) -> None: ...

def read_colmap_model(
    folder: str | bytes, may_be_empty: bool = False
) -> tuple[ColmapModel, dict[str, Any]]: ...
def survey_colmap_model(
    folder: str | bytes,
) -> tuple[
    int,
    int,
    NDArray[np.int64],
    NDArray[np.int32],
    NDArray[np.int32],
    NDArray[np.int32],
]: ...
def read_colmap_part(
    folder: str | bytes, point_ids: NDArray[np.int64], place: NDArray[np.int32]
) -> tuple[ColmapModel, dict[str, Any], tuple[int, int, str] | None]: ...

# bind_colmap_records.cpp
def colmap_views(model: ColmapModel) -> dict[str, Any]: ...
def colmap_contents(model: ColmapModel) -> dict[str, Any]: ...
def write_colmap_records(folder: str | os.PathLike[str], is_binary: bool, records: Any) -> None: ...

# bind_losses.cpp
def evaluate_loss(
    loss: str, scale: float, squared_norms: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def correct(
    rho: NDArray[np.float64],
    residual: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    second_order_term: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None: ...
def second_order_block(
    rho: NDArray[np.float64], residual: NDArray[np.float64], jacobian: NDArray[np.float64]
) -> NDArray[np.float64]: ...

# bind_solve.cpp
CERES_VERSION: str

def end_in_one_line() -> None: ...

# bind_launcher.cpp
def wait_for_the_end(mark: str, num_processes: int) -> None: ...
def know_processes(pid_of_rank: dict[int, int]) -> None: ...
def take_the_word(mark: str) -> bool: ...
def hardware_threads() -> int: ...
def changeable_options() -> list[str]: ...
def default_options() -> dict[str, Any]: ...
def option_choices() -> dict[str, list[str]]: ...
def reason_for_ceres(options: dict[str, Any]) -> str: ...
def watch_convergence(iterations: dict[str, Any], advice: str) -> str: ...
def solve(
    problem: _Problem,
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
    restrictions: _Restrictions | None = None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None = None,
) -> dict[str, Any]: ...
def solve_part(
    problem: _Problem,
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
    restrictions: _Restrictions | None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
    ranks: _Ranks,
    image_is_observed: NDArray[np.uint8],
) -> dict[str, Any]: ...
def open_scratch(folder: str | bytes, resident_bytes: int) -> None: ...
def close_scratch() -> None: ...
def scratch_use() -> tuple[int, int]: ...  # bytes of files: now, at most
def large_array(size: int, dtype: np.dtype[Any]) -> NDArray[Any]: ...  # not initialised
def num_point_sections(num_observations: int) -> int: ...
def add_double_doubles(
    sums: NDArray[np.float64],
    errors: NDArray[np.float64],
    to_sums: NDArray[np.float64],
    to_errors: NDArray[np.float64],
) -> None: ...

class Solver:
    def __init__(
        self,
        problem: _Problem,
        options: dict[str, Any],
        restrictions: _Restrictions | None = None,
        factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None = None,
    ) -> None: ...
    def check_structure(self, problem: _Problem) -> None: ...
    def solve(
        self,
        problem: _Problem,
        options: dict[str, Any],
        progress: Callable[[dict[str, Any]], None] | None,
    ) -> dict[str, Any]: ...

# bind_covariance.cpp
def covariance(
    problem: _Problem,
    options: dict[str, Any],
    restrictions: _Restrictions | None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
    inner: bool,
    sandwich: bool,
    of_points: bool,
    relative: list[tuple[int, int]],
    long_sums: bool,
    of_images: bool = ...,
    functions: NDArray[np.float64] | None = ...,
    function_points: list[int] = ...,
    functions_of_points: NDArray[np.float64] | None = ...,
) -> dict[str, Any]: ...
def reliability(
    problem: _Problem,
    options: dict[str, Any],
    restrictions: _Restrictions | None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
    least: float,
    num_worst: int,
    long_sums: bool = ...,
) -> dict[str, Any]: ...
def influence(
    problem: _Problem,
    options: dict[str, Any],
    restrictions: _Restrictions | None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
    without: str,
    images: NDArray[np.float64],
    cameras: NDArray[np.float64],
    points: NDArray[np.float64],
) -> dict[str, Any]: ...

class Adjoint:
    def __init__(
        self,
        problem: _Problem,
        options: dict[str, Any],
        restrictions: _Restrictions | None,
        factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
        eliminated: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
        exact: bool,
    ) -> None: ...
    @property
    def is_exact(self) -> bool: ...
    @property
    def held(self) -> NDArray[np.uint8]: ...
    def directions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def solve(self, y: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def gather(
        self,
        images: NDArray[np.float64],
        cameras: NDArray[np.float64],
        points: NDArray[np.float64],
    ) -> NDArray[np.float64]: ...
    def gradient(self, step: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def product(self, a: NDArray[np.float64], e: float) -> dict[str, Any]: ...
    def moved(self, step: NDArray[np.float64]) -> dict[str, Any]: ...

# bind_rest.cpp
def marginalize_rest(
    problem: _Problem,
    options: dict[str, Any],
    restrictions: _Restrictions | None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
    images: list[int],
    frames: list[int],
    cameras: list[int],
) -> dict[str, Any]: ...
def free_similarities(
    problem: _Problem,
    options: dict[str, Any],
    restrictions: _Restrictions | None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None,
    images: list[int],
    frames: list[int],
    cameras: list[int],
) -> NDArray[np.float64]: ...

# bind_check.cpp
def richardson_jacobian(
    function: Callable[[list[NDArray[np.float64]], bool], Any],
    num_residuals: int,
    blocks: list[NDArray[np.float64]],
    manifolds: list[tuple[str, list[int]]],
    minuends: list[float] = ...,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def gradient_checker(
    function: Callable[[list[NDArray[np.float64]], bool], Any],
    num_residuals: int,
    blocks: list[NDArray[np.float64]],
    manifolds: list[tuple[str, list[int]]],
    relative_precision: float,
) -> tuple[bool, NDArray[np.float64] | None, NDArray[np.float64] | None, str]: ...
def manifold_tangent_size(manifold: tuple[str, list[int]], size: int) -> int: ...
def manifold_plus(
    manifold: tuple[str, list[int]], x: NDArray[np.float64], delta: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def spot_check(
    problem: _Problem,
    options: dict[str, Any],
    rotation_offsets: NDArray[np.float64],
    lie: Callable[[int, NDArray[np.float64]], NDArray[np.float64]] | None,
) -> str: ...
def check_reprojections(
    problem: _Problem,
    observations: NDArray[np.int64],
    offsets: NDArray[np.float64],
    cheirality: str,
    relative_precision: float,
    num_threads: int,
) -> tuple[
    NDArray[np.float64],  # analytic (num_checked, 2, 6 + width + 3)
    NDArray[np.float64],  # reference
    NDArray[np.float64],  # uncertainty of the reference
    NDArray[np.float64],  # ceres::GradientChecker's numeric Jacobian
    NDArray[np.float64],  # rounding (num_checked,): relative, of the derivatives by pose and point
    NDArray[np.bool_],  # counts (num_checked,)
    NDArray[np.bool_],  # agrees
    NDArray[np.bool_],  # stable
]: ...

# bind_symbolic.cpp
# A graph of blocks: sizes (num_blocks,), column_begin (num_blocks + 1,) and rows are the lower
# triangle by block columns, ascending, the diagonal first. An order holds blocks; counts go by
# position in the order. Options are those of solve.
def order_blocks(
    sizes: NDArray[np.int32], column_begin: NDArray[np.int64], rows: NDArray[np.int32], method: str
) -> NDArray[np.int32]: ...
def count_factor(
    sizes: NDArray[np.int32],
    column_begin: NDArray[np.int64],
    rows: NDArray[np.int32],
    order: NDArray[np.int32],
) -> dict[str, Any]: ...
def reduced_pattern(
    problem: _Problem, options: dict[str, Any]
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]: ...

MOST_ENTRIES_FOR_AMD: int

def ordered_full_pattern(
    problem: _Problem, options: dict[str, Any], most_entries: int
) -> tuple[
    tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]], NDArray[np.int32], bool
]: ...  # full_pattern, an order of its blocks, whether that has the points first
def full_pattern(
    problem: _Problem, options: dict[str, Any]
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]: ...

# bind_synthetic.cpp
class SyntheticImages:
    def __init__(
        self,
        centers: NDArray[np.float64],
        rotations: NDArray[np.float64],
        ball_centers: NDArray[np.float64],
        ball_radii: NDArray[np.float64],
        max_tangents: NDArray[np.float64],
        sizes: NDArray[np.float64],
        richness: NDArray[np.float64],
        cameras: NDArray[np.int32],
        params: NDArray[np.float64],
        model: str,
        min_cosine: float,
        pitch: float,
        clearance: float,
    ) -> None: ...
    def visible_pairs(
        self,
        positions: NDArray[np.float64],
        normals: NDArray[np.float64],
        reach: NDArray[np.float64],
        keys: NDArray[np.float64],
        cell_centers: NDArray[np.float64],
        half_diagonal: float,
        cell_starts: NDArray[np.int64],
        order: NDArray[np.int64],
        wanted: NDArray[np.float64],
        fewest: int,
        bit_generator: Any,
        num_threads: int,
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]: ...
    def exact_pixels(
        self,
        positions: NDArray[np.float64],
        observation_image: NDArray[np.int32],
        observation_point: NDArray[np.int32],
        num_threads: int,
    ) -> NDArray[np.float64]: ...

# bind_diagnosis.cpp
def reduced_spectrum(
    problem: _Problem,
    options: dict[str, Any],
    image_piece: NDArray[np.int32],
    restrictions: _Restrictions | None = None,
    factors: tuple[list[Any], list[Any], list[tuple[str, int]]] | None = None,
    num_modes: int = 8,
) -> dict[str, Any]: ...

# bind_inspection.cpp
MAX_TRACK_LENGTH: int

def sums_are_double_doubles(
    linear_solver_type: str, num_columns: int, num_blocks: int, num_entries: int
) -> bool: ...
def available_memory() -> float: ...

# size, image_block, sensor_block, camera_block: NDArray[np.int32]; point_is_free: bool
def parameter_blocks(problem: _Problem, options: dict[str, Any]) -> dict[str, Any]: ...
def elimination_plan(problem: _Problem, options: dict[str, Any]) -> dict[str, int]: ...
def auto_choice(
    sizes: NDArray[np.int32],
    column_begin: NDArray[np.int64],
    rows: NDArray[np.int32],
    num_threads: int,
    num_observations: int,
    num_pairs: int,
) -> tuple[str, bool]: ...
def panel_values(
    sizes: NDArray[np.int32],
    column_begin: NDArray[np.int64],
    rows: NDArray[np.int32],
    order: NDArray[np.int32],
) -> float: ...
def panel_work(
    sizes: NDArray[np.int32],
    column_begin: NDArray[np.int64],
    rows: NDArray[np.int32],
    order: NDArray[np.int32],
    near_cache: float,
    far_cache: float,
    num_threads: int,
) -> dict[str, float]: ...

# bind_graph.cpp
# A variable: (name, manifold, value, held, lower, upper), the last three empty for none. A factor:
# (kind, name, places of its variables, loss, scale, what the kind takes).
def solve_graph(
    variables: list[Any],
    factors: list[Any],
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
    square_root: bool,
) -> dict[str, Any]: ...
def graph_conditioning(
    variables: list[Any], factors: list[Any]
) -> tuple[float, float, int, list[int]]: ...
def graph_jacobian(
    variables: list[Any], factors: list[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def graph_cost(variables: list[Any], factors: list[Any]) -> float: ...
def marginal_information(
    variables: list[Any], factors: list[Any], kept: list[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def factor_function(
    variables: list[Any], factor: tuple[Any, ...]
) -> Callable[
    [list[NDArray[np.float64]]], tuple[NDArray[np.float64], list[NDArray[np.float64]]] | None
]: ...
def retract(
    manifold: str, x: NDArray[np.float64], delta: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def local_coordinates(
    manifold: str, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def right_jacobian(
    manifold: str, x: NDArray[np.float64], delta: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def check_value(
    name: str, manifold: str, value: NDArray[np.float64]
) -> tuple[NDArray[np.float64], list[str]]: ...
def check_variable(variable: tuple[Any, ...]) -> None: ...

# bind_inertial.cpp
class Preintegration:
    def __init__(
        self,
        noise: tuple[float, ...] | NDArray[np.float64],
        gyro_bias: NDArray[np.float64],
        accel_bias: NDArray[np.float64],
        rule: str,
    ) -> None: ...
    def integrate(
        self,
        gyro: NDArray[np.float64],
        accel: NDArray[np.float64],
        dt: NDArray[np.float64],
        /,
    ) -> None: ...
    def append(self, next: Preintegration, /) -> None: ...
    def append_samples(self, rows: NDArray[np.float64], /) -> None: ...
    def copy(self) -> Preintegration: ...
    def repropagated(
        self, gyro_bias: NDArray[np.float64], accel_bias: NDArray[np.float64], /
    ) -> Preintegration: ...
    def corrected(
        self, gyro_bias: NDArray[np.float64], accel_bias: NDArray[np.float64], /
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
    def predict(
        self, state: NDArray[np.float64], gravity: NDArray[np.float64], /
    ) -> NDArray[np.float64]: ...
    def combined_covariance(self) -> NDArray[np.float64]: ...
    @property
    def samples(self) -> NDArray[np.float64]: ...
    @property
    def duration(self) -> float: ...
    @property
    def turned(self) -> float: ...
    @property
    def covariance(self) -> NDArray[np.float64]: ...
    @property
    def sqrt_information(self) -> NDArray[np.float64]: ...
    @property
    def delta_rotation(self) -> NDArray[np.float64]: ...
    @property
    def delta_velocity(self) -> NDArray[np.float64]: ...
    @property
    def delta_position(self) -> NDArray[np.float64]: ...
    @property
    def d_rotation_d_gyro_bias(self) -> NDArray[np.float64]: ...
    @property
    def d_velocity_d_gyro_bias(self) -> NDArray[np.float64]: ...
    @property
    def d_velocity_d_accel_bias(self) -> NDArray[np.float64]: ...
    @property
    def d_position_d_gyro_bias(self) -> NDArray[np.float64]: ...
    @property
    def d_position_d_accel_bias(self) -> NDArray[np.float64]: ...

def propagate(
    state: NDArray[np.float64],
    gravity: NDArray[np.float64],
    rule: str,
    gyro: NDArray[np.float64],
    accel: NDArray[np.float64],
    dt: NDArray[np.float64],
) -> NDArray[np.float64]: ...

# bind_pose_graph.cpp
class PoseOrder:
    @property
    def name(self) -> str: ...
    @property
    def entries(self) -> float: ...
    @property
    def flops(self) -> float: ...

class PoseGraphEdges:
    @property
    def bad(self) -> list[int]: ...
    @property
    def has_information(self) -> bool: ...

def read_g2o(path: str | os.PathLike[str]) -> dict[str, Any]: ...
def write_g2o(path: str | os.PathLike[str], graph: _PoseGraph, compression: str) -> None: ...
def solve_pose_graph(
    graph: _PoseGraph,
    held: NDArray[np.bool_],
    robust: NDArray[np.bool_],
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
    order: PoseOrder | None = None,
    with_trials: bool = False,
    chi2: NDArray[np.float64] | None = None,
    poses: NDArray[np.float64] | None = None,
) -> dict[str, Any]: ...
def order_poses(graph: _PoseGraph, held: NDArray[np.bool_], ordering: str) -> PoseOrder: ...
def pose_components(num_poses: int, edges: NDArray[np.int32]) -> list[int]: ...
def graph_covariance(
    graph: _PoseGraph,
    error: str,
    inner: bool,
    of_edges: bool,
    relative: list[tuple[int, int]],
    num_threads: int,
) -> dict[str, Any]: ...
def factor_graph_certainty(
    variables: list[Any],
    factors: list[Any],
    held: NDArray[np.bool_],
    pairs: list[tuple[int, int]],
    null_seed: NDArray[np.float64],
    of_factors: bool,
    num_threads: int,
) -> dict[str, Any]: ...
def factor_graph_spectrum(
    variables: list[Any],
    factors: list[Any],
    held: NDArray[np.bool_],
    num_null: int,
    num_threads: int,
) -> dict[str, Any]: ...
def factor_costs(
    variables: list[Any], factors: list[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]: ...
def auto_ordering(graph: _PoseGraph, held: NDArray[np.bool_]) -> str: ...
def graph_spectrum(
    graph: _PoseGraph,
    held: NDArray[np.bool_],
    error: str,
    null_directions: NDArray[np.float64],
    num_threads: int,
) -> dict[str, Any]: ...
def hold_poses(graph: _PoseGraph) -> tuple[NDArray[np.bool_], int, list[int]]: ...
def prepare_edges(
    num_poses: int,
    edges: NDArray[np.int32],
    measurements: NDArray[np.float64],
    information: NDArray[np.float64],
) -> PoseGraphEdges: ...
def edge_chi2(
    graph: _PoseGraph, error: str, poses: NDArray[np.float64] | None = None
) -> NDArray[np.float64]: ...
def initial_poses(
    graph: _PoseGraph,
    held: NDArray[np.bool_],
    init: str,
    num_threads: int,
    order: PoseOrder | None = None,
) -> NDArray[np.float64]: ...

# bind_certificate.cpp
def certify_graph(
    graph: _PoseGraph,
    kappa: NDArray[np.float64],
    tau: NDArray[np.float64],
    *,
    max_rank: int,
    max_steps: int,
    num_eigenvalues: int,
    explicit_form: bool,
    num_threads: int,
    progress: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]: ...
def start_cost(
    graph: _PoseGraph, held: NDArray[np.bool_], init: str, error: str, limit: float
) -> float: ...
def find_closures(ids: NDArray[np.int64], edges: NDArray[np.int32]) -> NDArray[np.bool_]: ...
def odometry_gap(graph: _PoseGraph) -> tuple[int, int]: ...
def solve_edge_system(
    edges: NDArray[np.int32],
    diagonal: NDArray[np.float64],
    between: NDArray[np.float64],
    rhs: NDArray[np.float64],
) -> NDArray[np.float64] | None: ...
def edge_loss(loss: str, scale: float, chi2: float) -> list[float]: ...
def relative_pose_error(
    error: str, x_i: NDArray[np.float64], x_j: NDArray[np.float64], z: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...

# bind_window.cpp
def solve_window(
    window: dict[str, Any], options: dict[str, Any], progress: object
) -> dict[str, Any]: ...
def marginalize_window(window: dict[str, Any], request: dict[str, Any]) -> dict[str, Any]: ...
def state_coordinates(point: NDArray[np.float64], state: NDArray[np.float64]) -> list[float]: ...
def prior_spectrum(
    matrix: NDArray[np.float64], square_root: bool, scaled: bool
) -> NDArray[np.float64]: ...
