"""Sliders of the live view: positions that stand for parameters of the arm, noise, delay and gains."""

from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.checks import finite, mapping
from flexman_gym.common.errors import value_error
from flexman_gym.common.plot_style import round_up
from flexman_gym.envs.episodes import Episodes
from flexman_gym.simulation.physical_parameters import PARAMETERS


class Slider(NamedTuple):
    """Slider of a physical parameter, of noise or delay: a position x stands for the value offset + x scale.

    Attributes:
        label: name and unit.
        low, high: ends.
        step: step of x; 0 for a logarithmic slider.
        scale, offset: numbers, or arrays (n,).
    """

    label: str
    low: float
    high: float
    step: float
    scale: Any = 1.0
    offset: Any = 0.0

    def value(self, position: float) -> Any:
        """Return the number or list that a position stands for."""
        result = np.asarray(self.offset + position * self.scale).tolist()
        return round(result) if self.step == 1.0 else result

    def position(self, value: Any) -> float:
        """Return the position of a value; for values (n,) the mean of the positions."""
        scale = np.asarray(self.scale)
        return float(np.mean((np.asarray(value) - self.offset)[scale != 0.0] / scale[scale != 0.0]))


def _factor(label: str) -> Slider:
    return Slider(f"{label} (\N{MULTIPLICATION SIGN} nominal)", 0.1, 10.0, 0.0)


GAIN_SLIDERS = {"stiffness": _factor("stiffness"), "damping": _factor("damping")}


def arm_sliders(episodes: Episodes) -> dict[str, Slider]:
    """Return the sliders of the arm by the name of a parameter in PARAMETERS or an effect in SIGNALS."""
    model, nominal = episodes.batch.model, episodes.batch.nominal
    rate = 2.0 * np.pi * episodes.view.first_frequency  # rad/s
    stiffness = nominal["joint_stiffness"]
    damping = 2.0 * stiffness / rate if rate > 0.0 else 0.0 * stiffness  # of a damping ratio of 1
    heaviest = round_up(max(4.0 * float(nominal["payload_mass"]), 0.1 * sum(link.mass for link in model.arm.links)))
    rows = {
        "payload_mass": Slider("payload (kg)", 0.0, heaviest, heaviest / 100.0),
        "joint_stiffness": _factor("joint stiffness")._replace(scale=nominal["joint_stiffness"]),
        "link_stiffness_factor": _factor("link stiffness")._replace(scale=nominal["link_stiffness_factor"]),
        "joint_damping": Slider("joint damping, added (ratio)", 0.0, 0.3, 0.003, damping, nominal["joint_damping"]),
        "link_damping": Slider("link damping (ratio)", 0.0, 0.1, 0.001, 1.0 * (nominal["link_damping"] > 0.0)),
        "viscous_friction": Slider(
            "viscous friction, added (torque limit s/rad)", 0.0, 0.2, 0.002, np.array(episodes.motors.limits[0]),
            nominal["viscous_friction"],
        ),
        "coulomb_friction": Slider("Coulomb friction (\N{MULTIPLICATION SIGN} nominal)", 0.0, 3.0, 0.03,
                                    nominal["coulomb_friction"]),
        "sensor_noise": Slider("noise (% of range)", 0.0, 1.0, 0.01, 0.01),
        "delay": Slider("delay (control periods)", 0.0, 5.0, 1.0),
    }  # fmt: skip
    result = {}
    for name, row in rows.items():
        if name in PARAMETERS and np.ndim(nominal[name]):
            free = ~PARAMETERS[name].fixed(model)
            row = row._replace(scale=row.scale * free, offset=np.where(free, row.offset, nominal[name]))
        if np.any(row.scale):
            result[name] = row
    return result


def checked_positions(field: str, value: object, sliders: dict[str, Slider]) -> dict[str, float]:
    """Return checked positions of sliders by name."""
    result = {}
    for name, position in mapping(field, value, sliders).items():
        row, x = sliders[name], finite(f"{field}.{name}", position)
        if not row.low <= x <= row.high:
            raise value_error(f"{field}.{name}", x, f"a number from {row.low:g} to {row.high:g}")
        result[name] = x
    return result
