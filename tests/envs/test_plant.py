"""Plant: what a controller is told of an environment is what the environment does, and no draw."""

from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.simulation.integrator import find_method
from flexman_gym.simulation.physical_parameters import UNCERTAIN, UNMODELLED

SMALL = {"elements": 1, "modes": 1}
RANDOM = {
    "payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3), "delay": (1, 3), "tip_load": (0.5, 2.0),
    "sensor_noise": (0.0, 0.003), "torque_limit_factor": (0.9, 1.1),
}  # fmt: skip


def plant_of(name="FlexPlanar-v0", **settings):
    setup = Configuration.from_keywords({"name": name, **SMALL, **settings})
    model = resolve_fidelity(setup).model
    return make_plant(setup, model), setup, model


def test_it_tells_ranges_and_no_more():
    plant, setup, model = plant_of(randomisation=RANDOM)
    assert plant.model is model and plant.torque_limit == setup.torque_limit
    assert plant.period == setup.control_period and plant.gains() == setup.pd_gains
    assert plant.unknown == {"payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3)}
    assert plant.delay == (1, 3) and plant.tip_force == 2.0


def test_neither_ranges_nor_draws_of_what_is_not_modelled_are_given():
    """A privileged controller is given the torque limits, as in every environment, and the delay."""

    class Listening:
        sensors, drawn = (), None

        def reset(self, arms, episode, count):
            self.drawn = episode.drawn

        def act(self, readings, applied, active):
            return np.zeros_like(applied)

    plant, *_ = plant_of(condition="unmodelled")
    assert not {UNCERTAIN.get(name, name) for name in plant.unknown} & UNMODELLED
    base = Listening()
    env = FlexManVectorEnv(2, name="FlexPlanar-v0", base=base, condition="unmodelled", **SMALL)
    drawn = env.reset(seed=0)[1]["drawn"]
    assert drawn.keys() >= UNMODELLED and base.drawn.keys() == {"torque_limit", "delay", "sensor_noise"}


def test_of_an_environment_that_draws_nothing_all_is_known():
    plant, *_ = plant_of()
    assert (plant.unknown, plant.delay, plant.tip_force) == ({}, (0, 0), 0.0)
    assert not any(values[1].any() for values in plant.measured().values())


def test_what_a_task_disturbs_is_told_too():
    plant, *_ = plant_of("FlexPlanar-Hold-v0")
    assert plant.tip_force == 0.5


@pytest.mark.parametrize("settings", [{}, {"step": 0.0025}, {"method": "ros2"}])
def test_it_moves_arms_as_the_environment_does(settings):
    plant, *_ = plant_of(**settings)
    batch = FlexManEnv(name="FlexPlanar-v0", **SMALL, **settings).episodes.batch
    assert find_method(plant.integration[0]) == batch.method
    assert round(plant.period / plant.integration[1]) == batch.substeps


def deviations(settings, names, arms=400):
    """Standard deviation of what a base reads at the start, over many arms that start alike."""

    class Reading:
        sensors, heard = ("motor_encoders", "joint_encoders", "strain"), None

        def reset(self, arms, episode, count):
            pass

        def act(self, readings, applied, playing):
            self.heard = {name: np.array(values) for name, values in readings.items()}
            return np.zeros_like(applied)

    base = Reading()
    env = FlexManVectorEnv(arms, name="FlexPlanar-v0", base=base, **SMALL, **settings)
    env.reset(seed=0, options={"start": [0.1, 0.2], "goal_angles": [0.3, 0.4]})
    env.step(np.zeros((arms, 2), dtype=np.float32))
    return {name: base.heard[name].std(axis=0) for name in names}


def test_deviations_are_those_of_what_a_base_reads():
    """Of the largest noise that may be drawn; ranges are what the noise is a part of."""
    noise = {"randomisation": {"sensor_noise": (0.002, 0.002)}}
    plant, *_ = plant_of(**noise)
    names = ("motor_angles", "motor_rates", "joint_twists", "joint_twist_rates", "root_strains")
    measured = plant.measured()
    for name, seen in deviations(noise, names).items():
        assert measured[name][1] == pytest.approx(0.002 * measured[name][0])
        assert seen == pytest.approx(measured[name][1], rel=0.15), name
    limits = Configuration.from_keywords({"name": "FlexPlanar-v0"}).limits
    assert measured["motor_angles"][0].tolist() == [limits.angle] * 2
    assert measured["motor_rates"][0].tolist() == [limits.rate] * 2


def test_biases_and_gain_errors_are_told():
    """The largest magnitude of a bias, of the randomisation and of an instrument, and of the gauges' gain errors."""
    biased = {"kind": "motor_encoders", "bias": 0.001}
    ranges = {"sensor_bias": (-0.003, 0.002), "gauge_gain_factor": (0.97, 1.02)}
    measured = plant_of(sensors=[biased, "strain"], randomisation=ranges)[0].measured()
    assert measured["motor_angles"][2] == pytest.approx(0.004 * measured["motor_angles"][0])
    assert measured["root_strains"][2] == pytest.approx(0.003 * measured["root_strains"][0])
    assert measured["root_strains"][3] == pytest.approx(0.03) and not measured["motor_angles"][3].any()


def test_the_flaws_of_an_instrument_add_to_the_noise():
    """Noise by squares, and rounding by a step over the square root of 12."""
    flawed = {"kind": "motor_encoders", "noise": 0.003, "quantisation": 0.01}
    plant, *_ = plant_of(sensors=[flawed, "joint_encoders"], randomisation={"sensor_noise": (0.0, 0.001)})
    measured = plant.measured()
    parts = {name: (values[1] / values[0]).max() for name, values in measured.items()}
    assert parts["motor_angles"] == pytest.approx(np.sqrt(0.003**2 + 0.001**2 + 0.01**2 / 12.0))
    assert parts["joint_twists"] == pytest.approx(0.001)


@pytest.mark.parametrize("name", ["FlexPlanar-v0", "FlexPlanar-v0/friction", "FlexRRR-v0/unmodelled", "FlexRotary-v0"])
def test_the_arm_of_a_named_environment_has_its_period_in_every_condition(name):
    """Controllers tuned for this arm count their times in periods of that length, whatever the period is here."""
    id, _, condition = name.partition("/")
    for period in (None, 0.005):
        settings = {} if period is None else {"control_period": period}
        plant, *_ = plant_of(id, **settings, **({"condition": condition} if condition else {}))
        assert plant.named_period == NAMED_ENVIRONMENTS[id].control_period


def test_an_arm_with_other_links_or_motors_has_the_period_of_no_named_environment():
    arm = Configuration("FlexPlanar-v0").arm
    stiffer = [replace(arm.joints[0], stiffness=2.0 * arm.joints[0].stiffness), *arm.joints[1:]]
    for other in (
        replace(arm, joints=stiffer),
        replace(arm, links=[*arm.links[:1], replace(arm.links[1], length=0.6)]),
    ):
        gains = {"stiffness": [1.0, 1.0], "damping": [0.1, 0.1]}
        assert plant_of(arm=other, gains=gains)[0].named_period is None
    assert plant_of(arm=replace(arm, payload=None))[0].named_period is not None, "the payload may differ"
