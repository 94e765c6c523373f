"""Machine, made up: how often fits to noisy records of random arms have the truth within two stated deviations."""

from dataclasses import replace
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.fit.free import Free
from flexman_gym.fit.response import Response
from flexman_gym.model.model import build_model

PERIOD, SAMPLES, NOISE, FINER = 0.005, 241, 0.005, 4
CHOICE: dict[str, Any] = {"elements": 1, "modes": 3}
FREE = ("joint_stiffness", "joint_damping", "link_stiffness", "link_damping", "payload_mass")
FAR = 0.3  # of the logarithms of a start
AXES = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))


def random_arm(rng: np.random.Generator) -> fm.Arm:
    """One to three strips on elastic joints, in a plane or in space."""
    count, spatial = int(rng.integers(1, 4)), bool(rng.integers(2))
    links, joints = [], []
    for i in range(count):
        thin = str(rng.choice(["y", "z"])) if spatial else "y"
        links.append(fm.Link.strip(rng.uniform(0.3, 0.6), rng.uniform(0.03, 0.05), rng.uniform(0.002, 0.005), thin))
        axis = AXES[rng.integers(3)] if spatial and i else AXES[0]
        size = 0.5 ** (2 * i)
        joints.append(fm.Joint(axis, 0.05 * size, rng.uniform(20.0, 80.0) * size, rng.uniform(0.02, 0.1) * size))
    ratios = rng.uniform(0.005, 0.03, count).tolist()
    return fm.Arm(links, joints, fm.Payload(rng.uniform(0.05, 0.2)), modal_damping_ratio=ratios)


def truth(arm: fm.Arm, rng: np.random.Generator) -> fm.Measurement:
    """What the arm does under torques that jump, at a quarter of the step of the fit."""
    count, times = arm.n_joints, PERIOD * np.arange(SAMPLES)
    inputs = {}
    for i in range(count):
        levels = np.repeat(rng.uniform(-1.0, 1.0, -(-SAMPLES // 20)), 20)[:SAMPLES]
        inputs[f"torque_{i + 1}"] = 0.5 ** (2 * i) * levels
    names = [
        f"{kind}_{i + 1}{end}"
        for i in range(count)
        for kind, end in (("motor_angle", ""), ("root_strain", "_y"), ("root_strain", "_z"))
    ]
    record = fm.Measurement(times, inputs, {name: times for name in names}, start=np.zeros(count))
    response = Response(arm, record, PERIOD / FINER)
    signals = response.signals(build_model(arm, **CHOICE), {"payload_mass": np.array([arm.payload.mass])})[0]  # type: ignore[union-attr]
    kept = {name: values for name, values in zip(names, signals, strict=True) if np.std(values) > 1e-9}
    return replace(record, outputs=kept)


def draws(seed: int, count: int) -> list[tuple[str, float, bool]]:
    """Fits of one arm to draws of noise: name of each number, its error in deviations, and whether it was told."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng)
    record, free = truth(arm, rng), Free(arm, FREE)
    result = []
    for _ in range(count):
        start = free.changed(free.start * np.exp(rng.uniform(-FAR, FAR, len(free.start))))
        noisy = {
            name: values + NOISE * np.std(values) * rng.standard_normal(SAMPLES)
            for name, values in record.outputs.items()
        }
        found = fm.fit(start, FREE, records=[replace(record, outputs=noisy)], **CHOICE)
        scale = np.where([number.parameter == "link_stiffness" for number in free.numbers], 1.0, free.start)
        moduli = [
            a.sections[0].youngs_modulus / b.sections[0].youngs_modulus
            for a, b in zip(arm.links, start.links, strict=True)
        ]
        for number, true in zip(free.numbers, scale, strict=True):
            place = number.place or 0
            value, deviation = (np.ravel(each[number.parameter])[place] for each in (found.values, found.deviations))
            right = moduli[place] if number.parameter == "link_stiffness" else true
            result.append((str(number), float((value - right) / deviation), str(number) not in found.undetermined))
    return result


def coverage(arms: int, count: int, first: int = 0) -> tuple[float, int, int]:
    """Gives the part of told numbers whose truth is within two deviations, how many these are, and the others."""
    found = [each for seed in range(first, first + arms) for each in draws(seed, count)]
    told = [abs(error) <= 2.0 for _, error, told in found if told]
    return float(np.mean(told)), len(told), len(found) - len(told)
