"""Rest after a stop: speeds that follow from the arm, and the wait for them."""

from types import SimpleNamespace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.commands.drive import rest_text
from flexman_gym.metrics import BAND
from flexman_gym.toolbox.deployment.machine.rest import (
    MAX_SLEWS,
    REST_SLEWS,
    RestSpeeds,
    RestWait,
    noise_level,
    slew_seconds,
)

from oracles.machines import FakeClock


def arm(payload):
    base = fm.catalog.one_joint()
    return fm.build_model(fm.Arm(base.links, base.joints, payload=fm.Payload(payload)))


def test_a_slew_of_a_heavy_payload_takes_the_time_of_bang_bang_torques():
    model, length, torque = arm(12.0), 0.8, 7.0
    exact = 2.0 * np.sqrt(
        12.0 * length**2 / torque
    )  # half of the angle under the whole torque, half under its opposite
    assert slew_seconds(model, np.array([torque])) == pytest.approx(exact, rel=5e-3)


def test_the_speeds_at_rest_move_the_tip_by_its_band_in_the_time_at_rest():
    model = arm(0.05)
    speeds = RestSpeeds(model, np.array([0.5]))
    assert speeds.tip * REST_SLEWS * speeds.slew == pytest.approx(BAND * 0.8)
    assert speeds.motors * 0.8 == pytest.approx(speeds.tip)
    assert RestSpeeds(model, np.array([2.0])).tip == pytest.approx(2.0 * speeds.tip)  # four times the torque


class Decay:
    """Machine whose motor rate and tip speed decay; its readings are the time."""

    period = 0.01

    def __init__(self):
        self.clock, self.until = FakeClock(), np.inf

    def read(self):
        return None if self.clock.time > self.until else {"time": self.clock.now()}


def waited(machine, measure, noise=(0.0, 0.0)):
    speeds = SimpleNamespace(slew=1.0, motors=1e-2, tip=1e-2)
    return RestWait(speeds, noise, 5)(machine, machine.clock, lambda readings: measure(readings["time"]))


def test_motors_and_tip_have_their_own_times_of_rest():
    loop = waited(Decay(), lambda time: (np.exp(-10.0 * time), np.exp(-2.0 * time)))
    assert loop["rest_seconds"] == pytest.approx(np.log(100.0) / 10.0, abs=2e-3)
    assert loop["tip_rest_seconds"] == pytest.approx(np.log(100.0) / 2.0, abs=2e-3)
    assert rest_text(loop) == "motors at rest 0.46 s and tip at rest 2.30 s after the stop"


def test_an_oscillation_is_not_at_rest_at_its_turning_points():
    loop = waited(Decay(), lambda time: (abs(np.exp(-time) * np.cos(50.0 * time)), np.nan), (0.0, np.nan))
    assert loop["rest_seconds"] == pytest.approx(np.log(100.0), abs=0.07)
    assert rest_text(loop).endswith("after the stop; the speed of the tip is not measured")


def test_a_tip_that_rings_is_waited_for_at_most_some_slews_and_its_speed_is_told():
    machine = Decay()
    loop = waited(machine, lambda time: (0.0, 0.3))
    assert loop["tip_rest_seconds"] is None and loop["tip_speed"] == 0.3
    assert machine.clock.time == pytest.approx(MAX_SLEWS + REST_SLEWS, abs=0.01)
    assert rest_text(loop) == "motors at rest 0.00 s and tip still at 0.3 m/s after the stop"


def test_a_machine_that_falls_silent_is_not_waited_for():
    machine = Decay()
    machine.until = 0.1
    loop = waited(machine, lambda time: (0.2, np.nan), (0.0, np.nan))
    assert machine.clock.time == pytest.approx(0.1 + 10 * 5 * machine.period, abs=0.01)
    assert loop["rest_seconds"] is None and rest_text(loop).startswith("motors still at 0.2 rad/s after the stop")
    machine.until = 0.0
    assert "is not known" in rest_text(waited(machine, lambda time: (0.2, np.nan)))


def test_the_noise_of_braked_readings_is_part_of_the_speed_at_rest():
    noise = noise_level(np.abs(np.random.default_rng(0).normal(size=25)))
    random = np.random.default_rng(1)
    assert waited(Decay(), lambda time: (abs(random.normal()), np.nan), (noise, np.nan))["rest_seconds"] < 2.0
    assert waited(Decay(), lambda time: (abs(random.normal()), np.nan), (0.0, np.nan))["rest_seconds"] is None
