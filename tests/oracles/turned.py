"""Noise-free records of a one-joint arm with a moving hub, as simulated by a fit."""

from dataclasses import replace
from functools import cache

import numpy as np

import flexman_gym as fm
from flexman_gym.toolbox.identification.measurement import SimulatedResponse

PERIOD = 0.01
BENT, STRAIN = "link_deflection_1_y", "root_strain_1_y"
CHOICE = {"elements": 1, "modes": 1}
STIFFNESS = fm.catalog.one_joint().joints[0].stiffness


@cache
def turned(names=(BENT,), samples=121, **more):
    """Return a record of outputs of an arm whose hub moves to and fro."""
    times, arm = PERIOD * np.arange(samples), fm.catalog.one_joint()
    hub = 0.3 * np.sin(2.0 * np.pi * 0.9 * times) ** 3
    record = fm.Measurement(times, {"motor_angle_1": hub}, dict.fromkeys(names, times), **more)
    model = fm.build_model(arm, **CHOICE)
    signals = SimulatedResponse(arm, record, None).signals(model, {"payload_mass": model.constants.payload_mass[:1]})[0]
    return replace(record, outputs=dict(zip(names, signals, strict=True)))


def sprung(factor):
    """Return the arm with a different joint stiffness."""
    arm = fm.catalog.one_joint()
    return replace(arm, joints=[replace(arm.joints[0], stiffness=factor * STIFFNESS)])
