"""Calibration of the sensors of a visual-inertial sequence, and its file in YAML.

``calibration.yaml`` is flat; every key is a field of :class:`Calibration` or of its noise::

    camera_model: PINHOLE            # COLMAP's name; null: x and y are normalised
    camera_params: [458.6, 457.3, 367.2, 248.4]
    camera_from_imu: [0, 0, 0, 1, 0, 0, 0]     # qx qy qz qw tx ty tz, or the rows of a 4x4 matrix
    camera_rate: 20.0                # Hz
    imu_rate: 200.0                  # Hz
    time_offset: 0.0                 # s, added to the stamps of images
    pixel_sigma: 1.0                 # pixels
    focal: 458.0                     # pixels per unit of normalised coordinates
    gyro_noise_density: 1.7e-4       # rad/s/sqrt(Hz)
    accel_noise_density: 2.0e-3      # m/s^2/sqrt(Hz)
    gyro_bias_random_walk: 1.9e-5    # rad/s^2/sqrt(Hz)
    accel_bias_random_walk: 3.0e-3   # m/s^3/sqrt(Hz)

YAML reads ``1e-4``, without a decimal point, as a string, which is converted to a number.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import at, check_type
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, first_line, nearest, shown
from bundle.interface.option_fields import number
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.rigid_motions import quaternion_from_matrix

Array = NDArray[np.float64]

_NOISE = (
    "gyro_noise_density",
    "accel_noise_density",
    "gyro_bias_random_walk",
    "accel_bias_random_walk",
)
_POSITIVE = ("imu_rate", "camera_rate", "pixel_sigma", "focal")
_NEEDED = ("camera_from_imu", *_NOISE)


@dataclass(frozen=True)
class Calibration:
    """Sensors of a sequence.

    Attributes:
        camera_from_imu: (7,) qx qy qz qw tx ty tz [m], with a unit quaternion.
        noise: noise densities and random walks of the IMU.
        camera_model: COLMAP's name, or None if observations are normalised image coordinates.
        camera_params: parameters of the camera model, in COLMAP's order.
        imu_rate: samples per second [Hz].
        camera_rate: images per second [Hz].
        time_offset: seconds that are added to the stamps of images.
        pixel_sigma: standard deviation of x and of y of an observation [pixels].
        focal: pixels per unit of normalised coordinates; taken from the camera model if given.

    Raises:
        InputError: a value has another shape or range, or the model does not exist.
    """

    camera_from_imu: tuple[float, ...]
    noise: ImuNoise
    camera_model: str | None = None
    camera_params: tuple[float, ...] = ()
    imu_rate: float = 200.0
    camera_rate: float = 20.0
    time_offset: float = 0.0
    pixel_sigma: float = 1.0
    focal: float = 1.0

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "camera_from_imu", pose_numbers("camera_from_imu", self.camera_from_imu))
        params = finite_numbers("camera_params", self.camera_params)
        set_field(self, "camera_params", tuple(params.ravel().tolist()))
        for name in (*_POSITIVE, "time_offset"):
            value = one_number(name, getattr(self, name))
            if name in _POSITIVE and value <= 0:
                raise InputError(f"{name}: expected a number above 0, found {value:g}")
            set_field(self, name, value)
        if self.camera_model is None:
            return
        expected = camera_models().get(self.camera_model)
        if expected is None:
            hint = nearest(str(self.camera_model), tuple(camera_models()))
            raise InputError(
                f"camera_model: expected a model of COLMAP or null, found "
                f"{brief(self.camera_model)}{hint}"
            )
        if len(self.camera_params) != len(expected):
            raise InputError(
                f"camera_params: expected {len(expected)} numbers for {self.camera_model} "
                f"({', '.join(expected)}), found {len(self.camera_params)}"
            )
        focal = np.array(param_kinds(self.camera_model)) == "focal"
        if focal.any():
            set_field(self, "focal", float(np.mean(np.array(self.camera_params)[focal])))


def load_calibration(path: Path) -> Calibration:
    """Read ``calibration.yaml``."""
    content = read_yaml(path)
    known = [field.name for field in fields(Calibration) if field.name != "noise"] + list(_NOISE)
    for key in content:
        if key not in known:
            raise InputError(
                f"{shown(path)}: there is no key {brief(key)}"
                f"{nearest(str(key), known) or '; expected one of ' + ', '.join(known)}"
            )
    missing = [name for name in _NEEDED if name not in content]
    model = content.get("camera_model")
    missing += ["camera_params"] * (model is not None and "camera_params" not in content)
    missing += ["focal"] * (model is None and "focal" not in content)
    if missing:
        raise InputError(f"{shown(path)}: expected the key {missing[0]}; it is missing")
    with at(shown(path)):
        noise = {name: one_number(name, content.pop(name)) for name in _NOISE}
        return Calibration(noise=ImuNoise(**noise), **content)


def calibration_text(calibration: Calibration) -> str:
    """Return the text of ``calibration.yaml``; its numbers read back unchanged."""
    import yaml

    content: dict[str, Any] = {}
    for field in fields(calibration):
        value = getattr(calibration, field.name)
        if field.name == "noise":
            content |= {name: float(getattr(value, name)) for name in _NOISE}
        else:
            content[field.name] = list(value) if isinstance(value, tuple) else value
    text: str = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    return text


def pose_numbers(name: str, value: Any) -> tuple[float, ...]:
    """Convert qx qy qz qw tx ty tz, or the rows of a 4x4 matrix, to a pose (7,)."""
    found = finite_numbers(name, value)
    if found.shape == (4, 4):
        rotation = found[:3, :3]
        if (
            np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(rotation) < 0
            or np.abs(found[3] - [0, 0, 0, 1]).max() > 1e-9
        ):
            raise InputError(f"{name}: expected a rigid motion, found a 4x4 matrix of another kind")
        found = np.r_[quaternion_from_matrix(rotation[None])[0], found[:3, 3]]
    if found.shape != (7,):
        raise InputError(
            f"{name}: expected qx qy qz qw tx ty tz or a 4x4 matrix, found {brief(value)}"
        )
    norm = math.sqrt(float(found[:4] @ found[:4]))
    if not 0.99 < norm < 1.01:
        raise InputError(f"{name}: expected a quaternion of norm 1, found norm {norm:g}")
    if abs(norm - 1) > 1e-15:  # otherwise keep the quaternion's digits
        found[:4] /= norm
    return tuple(found.tolist())


@dataclass(frozen=True, repr=False)
class ImuNoise(Displayed):
    """Noise densities of an IMU in continuous time, as in data sheets and Allan deviation plots.

    Attributes:
        gyro_noise_density: rad/s/sqrt(Hz), above 0.
        accel_noise_density: m/s^2/sqrt(Hz), above 0.
        gyro_bias_random_walk: rad/s^2/sqrt(Hz).
        accel_bias_random_walk: m/s^3/sqrt(Hz).
        integration_covariance: m^2/s per axis, for the error of integrating velocity to position.

    Raises:
        InputError: a value is not a finite number, or is out of its range.
    """

    gyro_noise_density: float
    accel_noise_density: float
    gyro_bias_random_walk: float
    accel_bias_random_walk: float
    integration_covariance: float = 1e-8

    def __post_init__(self) -> None:
        for entry in fields(self):
            name, value = f"ImuNoise: {entry.name}", getattr(self, entry.name)
            if entry.name.endswith("noise_density"):
                value = number(name, value, above=0)
            else:
                value = number(name, value, minimum=0)
            object.__setattr__(self, entry.name, value)

    def scaled(self, scale: float, *, walks: bool = True) -> ImuNoise:
        """Return a copy with its four densities multiplied by ``scale``.

        Data sheets are optimistic: estimators use 3 to 10 times their values.

        Args:
            scale: factor, above 0.
            walks: also scale the random walks. Use False for vibration, which increases only the
                white noises.

        Raises:
            InputError: the scale is not a number above 0.
        """
        scale = number("ImuNoise.scaled: scale", scale, above=0)
        walk = scale if walks else 1.0
        return replace(
            self,
            gyro_noise_density=scale * self.gyro_noise_density,
            accel_noise_density=scale * self.accel_noise_density,
            gyro_bias_random_walk=walk * self.gyro_bias_random_walk,
            accel_bias_random_walk=walk * self.accel_bias_random_walk,
        )

    def astuple(self) -> tuple[float, float, float, float, float]:
        """Return the five numbers in the order of the attributes."""
        return (
            self.gyro_noise_density,
            self.accel_noise_density,
            self.gyro_bias_random_walk,
            self.accel_bias_random_walk,
            self.integration_covariance,
        )

    def _display(self) -> Display:
        return Display(
            title="ImuNoise",
            facts=(
                ("gyroscope", f"{self.gyro_noise_density:g} rad/s/sqrt(Hz)"),
                ("accelerometer", f"{self.accel_noise_density:g} m/s^2/sqrt(Hz)"),
                ("gyroscope's bias", f"{self.gyro_bias_random_walk:g} rad/s^2/sqrt(Hz)"),
                ("accelerometer's bias", f"{self.accel_bias_random_walk:g} m/s^3/sqrt(Hz)"),
                ("integration", f"{self.integration_covariance:g} m^2/s"),
            ),
        )


# Reading of YAML files as tables of keys: calibrations of this package, of EuRoC and of Kalibr.
#
# OpenCV writes a first line ``%YAML:1.0`` and tags ``!!opencv-matrix``, which YAML does not allow;
# both are ignored.


def read_yaml(path: Path) -> dict[Any, Any]:
    """Read a file of keys with values."""
    import yaml

    content = path.read_bytes()
    if content.startswith(b"%YAML:"):
        content = content[content.find(b"\n") + 1 :] if b"\n" in content else b""
    content = content.replace(b"!!opencv-matrix", b"")
    try:
        found = yaml.safe_load(content)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f": line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or first_line(error)
        raise InputError(f"{shown(path)}{place}: expected YAML, found {problem}") from None
    check_type(shown(path), found, dict, "keys with values")
    return dict(found)


def finite_numbers(name: str, value: Any) -> NDArray[np.float64]:
    """Convert a value to an array of finite numbers; strings such as "1e-4" are numbers."""
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected numbers, found {brief(value)}") from None
    if not np.isfinite(found).all():
        raise InputError(f"{name}: expected finite numbers, found {brief(value)}")
    return found


def one_number(name: str, value: Any) -> float:
    """Convert a value to a finite number."""
    found = finite_numbers(name, value)
    if found.ndim or isinstance(value, bool):
        raise InputError(f"{name}: expected a number, found {brief(value)}")
    return float(found)
