"""Random arms of two to four links, described by data sheets, and environments with uncertain parameters for them."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration

Vector3 = tuple[float, float, float]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
MIN_REACH, MAX_REACH = 0.5, 10.0  # m
TAPER = 0.8  # dimensionless; diameter of a link relative to that of the link before it
MAX_SAG = 0.05  # rad; largest twist of a joint under the weight of the outstretched arm with twice its payload
DAMPING_RATIO = 0.01  # dimensionless; of a joint with the arm outstretched
# Fractions of the measurement range: noise of 0.3 to 1 mrad and biases up to 0.3 mrad of the motor angles
SENSOR_ERRORS = {"sensor_noise": [1e-4, 3e-4], "sensor_bias": [-1e-4, 1e-4]}


class _DriveSizes(NamedTuple):
    """Sizes of the drive of a joint, at the output of its gear.

    Attributes:
        inertia: moment of inertia of the outstretched links and the payload about the joint, kg m^2.
        weight: torque that holds the outstretched links and twice the payload under gravity, N m.
        torque: torque limit, N m.
    """

    inertia: float
    weight: float
    torque: float


def random_arm(seed: int) -> fm.Arm:
    """Return a random arm with two to four aluminium tubes, geared motors and a payload.

    The reach is log-uniform between 0.5 and 10 m, and half of the arms are under gravity. Motors are sized for a slew
    of 90 degrees of the outstretched arm in 1.5 s to 4 s, beside twice the weight of the payload.

    Args:
        seed: seed of the random numbers.

    Returns:
        The arm.
    """
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 5))
    reach = math.exp(random.uniform(math.log(MIN_REACH), math.log(MAX_REACH)))
    lengths = reach * random.dirichlet(np.full(count, 8.0))
    diameter = float(lengths.mean()) / random.uniform(15.0, 30.0)
    links = [
        fm.Link.tube(float(length), diameter * TAPER**row, diameter * TAPER**row / 20.0, material="aluminium")
        for row, length in enumerate(lengths)
    ]
    masses = np.array([link.mass for link in links])
    payload = float(random.uniform(0.1, 0.4) * masses.sum())
    gravity: Vector3 = (0.0, 0.0, -9.81) if random.random() < 0.5 else (0.0, 0.0, 0.0)
    axes = _random_axes(random, count)
    joints = [
        _random_joint(random, axis, _size_drive(lengths[row:], masses[row:], payload, axis, gravity))
        for row, axis in enumerate(axes)
    ]
    return fm.Arm(links, joints, fm.Payload(payload), gravity=gravity, modal_damping_ratio=0.005)


def uncertain_environment(arm: fm.Arm) -> dict[str, Any]:
    """Return the settings of FlexRRR-v0 for an arm in the condition uncertain, with the sensor errors of data sheets.

    Control period, horizon, limits and payloads follow from the arm.
    """
    settings = Configuration("FlexRRR-v0", {"arm": arm, "condition": "uncertain"}).given
    return {**settings, "randomisation": {**settings["randomisation"], **SENSOR_ERRORS}}


def _random_axes(random: Generator, count: int) -> list[Vector3]:
    """Return the axes of the joints: the first about Z, the second about Y, further ones about Y, Z or X."""
    further = [(Y, Z, X)[int(random.choice(3, p=[0.6, 0.3, 0.1]))] for _ in range(count - 2)]
    return [Z, Y, *further]


def _size_drive(lengths: Array, masses: Array, payload: float, axis: Vector3, gravity: Vector3) -> _DriveSizes:
    """Return inertia and torque limit for the links (k,) from a joint outward, outstretched."""
    ends = np.cumsum(lengths)
    centres = ends - lengths / 2.0
    inertia = float(masses @ (centres**2 + lengths**2 / 12.0) + payload * ends[-1] ** 2)
    duration = 1.5 + 0.25 * float(ends[-1])  # s
    slew = 5.77 * (math.pi / 2.0) / duration**2  # rad/s^2; peak acceleration of a minimum-jerk slew
    loaded = inertia + payload * float(ends[-1]) ** 2
    weight = 0.0 if axis == Z else abs(gravity[2]) * float(masses @ centres + 2.0 * payload * ends[-1])
    return _DriveSizes(inertia, weight, 2.0 * loaded * slew + 1.5 * weight)


def _random_joint(random: Generator, axis: Vector3, sizes: _DriveSizes) -> fm.Joint:
    """Return an elastic joint with a geared motor and friction."""
    gear = float(random.uniform(50.0, 160.0))
    current = 10.0  # A
    motor = fm.Motor(
        gear_ratio=gear, torque_constant=sizes.torque / (gear * current),
        rotor_inertia=float(random.uniform(0.1, 0.5)) * sizes.inertia / gear**2, current_limit=current,
    )  # fmt: skip
    frequency = float(random.uniform(2.0, 6.0)) * 2.0 * math.pi / (1.0 + math.sqrt(sizes.inertia) / 10.0)  # rad/s
    stiffness = max(sizes.inertia * frequency**2, sizes.weight / MAX_SAG)
    coulomb = float(random.uniform(0.02, 0.06)) * sizes.torque
    return fm.Joint(
        axis, stiffness=stiffness, damping=2.0 * DAMPING_RATIO * math.sqrt(sizes.inertia * stiffness), motor=motor,
        viscous_friction=coulomb / 1.5, coulomb_friction=coulomb, coulomb_rate=0.03,
    )  # fmt: skip
