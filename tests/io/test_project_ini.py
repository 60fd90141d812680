"""COLMAP's project.ini: what is read, and what is refused with its line."""

import pytest

import bundle
from bundle.interface.colmap_options import ROUNDING
from bundle.io.database_images import read_project_ini

WRITTEN = """log_to_stderr=false
database_path=a.db
[Mapper]
refine_focal_length=whatever
[BundleAdjustment]
refine_focal_length=false
refine_principal_point=true
refine_extra_params=true
refine_rig_from_world=true
refine_sensor_from_rig=false
refine_points3D=true
constant_rig_from_world_rotation=false
min_track_length=0
[BundleAdjustmentCeres]
max_num_iterations=37
max_linear_solver_iterations=200
function_tolerance=1e-7
gradient_tolerance=0.001
parameter_tolerance=0
use_gpu=0
gpu_index=-1
min_num_images_gpu_solver=50
min_num_residuals_for_cpu_multi_threading=50000
max_num_images_direct_dense_cpu_solver=50
max_num_images_direct_sparse_cpu_solver=1000
max_num_images_direct_dense_gpu_solver=200
max_num_images_direct_sparse_gpu_solver=4000
"""


def read(tmp_path, text):
    path = tmp_path / "project.ini"
    path.write_text(text)
    return read_project_ini(path)


def test_a_file_as_colmap_writes_it(tmp_path):
    asked = read(tmp_path, WRITTEN)
    options = asked.options
    assert options.refine == ("poses", "points", "principal_point", "extra")
    assert not options.refine_sensor_from_rig
    assert options.max_num_iterations == 37
    assert (options.function_tolerance, options.gradient_tolerance) == (1e-7, 1e-3)
    assert options.parameter_tolerance == 0
    assert not asked.asks_for_gpu
    assert not asked.constant_rotations


def test_names_before_colmap_3_13_and_names_with_their_section(tmp_path):
    old = "[BundleAdjustment]\nrefine_extrinsics=0\nmax_num_iterations=7 # few\nuse_gpu=1\n"
    asked = read(tmp_path, old)
    assert "poses" not in asked.options.refine
    assert asked.options.max_num_iterations == 7
    assert asked.asks_for_gpu
    asked = read(tmp_path, "BundleAdjustment.refine_points3D = False\r\n")
    assert "points" not in asked.options.refine


def test_colmap_defaults_where_the_file_has_nothing(tmp_path):
    options = read(tmp_path, "[BundleAdjustment]\nrefine_principal_point=1\n").options
    assert (options.function_tolerance, options.gradient_tolerance) == (ROUNDING, 1e-4)
    assert options.max_num_iterations == 100
    assert options.refine_sensor_from_rig


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"project\.ini: expected options .* found 0"),
        ("[Mapper]\na=b\n", "expected options"),
        ("[BundleAdjustment]\nrefine_points3D\n", r"project\.ini:2: expected NAME=VALUE"),
        ("[BundleAdjustment]\nrefine_points3D=maybe\n", r":2: .*refine_points3D.*true or false"),
        ("[BundleAdjustmentCeres]\nmax_num_iterations=1.5\n", ":2: .*a whole number"),
        ("[BundleAdjustmentCeres]\nfunction_tolerance=nan\n", ":2: .*a number"),
        ("[BundleAdjustmentCeres]\nfunction_tolerance=-1\n", ":2: .*at least 0"),
        ("[BundleAdjustmentCeres]\nmax_num_iterations=-1\n", ":2: .*at least 0"),
        ("[BundleAdjustment]\nmin_track_length=-3\n", ":2: .*at least 0"),
        ("[BundleAdjustment]\nuse_gpu=0\nuse_gpu=1\n", ":3: use_gpu: .*second"),
        ("[BundleAdjustment]\nbackend=CASPAR\n", ":2: .*backend: expected CERES"),
        (
            "[BundleAdjustment]\nrefine_magic=1\n",
            ":2: .*refine_magic: expected an option that bundle knows",
        ),
        ("[BundleAdjustmentCeres]\nloss_function_type=arctan2\n", "loss_function_type: expected"),
    ],
)
def test_one_line_names_what_is_wrong(tmp_path, text, message):
    with pytest.raises(bundle.InputError, match=message) as raised:
        read(tmp_path, text)
    assert "\n" not in str(raised.value)


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "project.ini"
    path.write_bytes(b"[BundleAdjustment]\n\xff\xfe\x00")
    with pytest.raises(bundle.InputError, match="expected text"):
        read_project_ini(path)
