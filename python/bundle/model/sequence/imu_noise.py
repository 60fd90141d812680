"""Noise densities of an IMU."""

from __future__ import annotations

from dataclasses import fields, replace

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.interface.option_fields import number


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
