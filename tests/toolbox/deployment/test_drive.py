"""Real-time loop: the torques of a simulation on a machine that is one, and an arm at rest after each fault."""

import signal
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import RolloutLoop, rollout
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.toolbox.deployment.machine.drive import MEASURED, WARM_UP, drive
from flexman_gym.toolbox.deployment.machine.rest import RestSpeeds
from flexman_gym.toolbox.deployment.machine.server import Disturbances
from flexman_gym.toolbox.deployment.machine.simulated import SILENT_PERIODS, SimulatedMachine
from flexman_gym.toolbox.deployment.machine.state_estimate import StateEstimate
from flexman_gym.toolbox.diagnosis.diagnosis import diagnose, diagnose_log

from oracles.assertions import refusal
from oracles.machines import FakeMachine

pytestmark = pytest.mark.slow

ENVIRONMENT = Configuration.find("FlexOne-v0").replace(
    horizon=1.0
)  # its torque limit, 0.5 N m, scales torques without rounding
WARMED = min(WARM_UP, ENVIRONMENT.max_periods)  # control periods that an agent acts before the start
ENCODERS = ("motor_angles", "motor_rates", "torques")
LAB = (*MEASURED, "torques")
REST = RestSpeeds(fm.build_model(ENVIRONMENT.arm), np.array(ENVIRONMENT.torque_limit)).motors  # rad/s


def run(agent, machine, **more):
    return drive(agent, machine, ENVIRONMENT, 9000, **more)


@pytest.mark.parametrize(
    ("agent", "names"),
    [("pd", ENCODERS), ("lqg", LAB), ("lqr-tracking", (*ENCODERS, "state")), ("random", ENCODERS), ("zero", ENCODERS)],
)
def test_torques_and_targets_are_those_of_a_simulation(agent, names):
    log = run(agent, FakeMachine(ENVIRONMENT, 9000, names))
    expected = rollout(agent, ENVIRONMENT, [9000]).episode(0)
    assert log.about["failure"] == ""
    np.testing.assert_allclose(log.torques, expected.torques, rtol=0, atol=0 if agent != "lqg" else 1e-6)
    assert log.actions.shape == expected.actions.shape and np.array_equal(log.targets, expected.targets)
    if "state" in names:
        assert np.array_equal(log.states, expected.states)


def test_a_policy_reads_history_and_repeats_actions_as_in_a_simulation():
    class Law:
        def predict(self, observations):
            return np.sin(10.0 * observations[:, :1])

    environment = ENVIRONMENT.replace(
        sensors=["motor_encoders", "strain", "command"], history=3, action_repeat=4, base="pd"
    )
    agent = find_agent(Law()).from_predictor(Law(), environment)
    log = run(agent, FakeMachine(ENVIRONMENT, 9000, LAB))
    expected = rollout(agent, ENVIRONMENT, [9000]).episode(0)
    np.testing.assert_allclose(log.torques, expected.torques, atol=1e-6)  # float32


def test_a_preparation_does_not_change_the_actions():
    plain, prepared = (RolloutLoop("lqg", ENVIRONMENT, [9000]) for _ in range(2))
    for _ in range(20):
        plain.step()
        prepared.step()
        episodes = prepared.episodes
        states = episodes.base.observer.states
        before = states.copy()
        for _ in range(2):
            episodes.agent.prepare(episodes.view.action.copy(), ~episodes.over)
        assert not np.array_equal(states, before)
        assert np.array_equal(episodes.view.action, plain.episodes.view.action)


class LateMachine(FakeMachine):
    """Machine whose readings arrive a fraction of a period after a deadline, from the first command on."""

    late, due = 0.2, 0.0

    def write(self, commands):
        self.due = (self.due or self.clock.now() + self.late * self.period) + self.period
        super().write(commands)

    def read(self):
        return None if self.commands and not self.arm.reason and self.clock.now() < self.due else super().read()


def test_deadlines_follow_a_machine_that_sends_later_when_it_moves():
    log = run("pd", LateMachine(ENVIRONMENT, 9000, ENCODERS))
    assert (log.about["failure"], log.about["machine"]["silent"]) == ("", 0)
    assert np.array_equal(log.torques, rollout("pd", ENVIRONMENT, [9000]).episode(0).torques)


def test_currents_are_torques_per_torque_of_an_ampere():
    motor = fm.Motor(gear_ratio=50.0, torque_constant=0.02, rotor_inertia=4e-6, efficiency=0.5)
    arm = ENVIRONMENT.arm
    arm = replace(arm, joints=(replace(arm.joints[0], rotor_inertia=0.0, motor=motor),))
    environment = ENVIRONMENT.replace(arm=arm, gains=ENVIRONMENT.pd_gains)
    machines = [FakeMachine(environment, 9000, ENCODERS, unit=unit) for unit in ("N m", "A")]
    for machine in machines:
        drive("pd", machine, environment, 9000)
    torques, currents = (np.array(machine.commands) for machine in machines)
    np.testing.assert_allclose(currents * 0.5, torques, atol=1e-7)
    with pytest.raises(ValueError, match="Motor at each joint"):
        run(
            "pd",
            type("Bench", (), {"period": 0.02, "unit": "A", "quantities": {"motor_angles": 1, "motor_rates": 1}})(),
        )


def silent(machine, readings):
    return None if len(machine.commands) >= 10 and not machine.arm.reason else readings


def not_a_number(machine, readings):
    return readings | {"motor_angles": [np.nan]} if len(machine.commands) == 10 else readings


def out_of_range(machine, readings):
    return readings | {"motor_angles": [100.0]} if len(machine.commands) == 10 else readings


class Faulty(PD):
    """PD that fails in the act of a given number."""

    def __init__(self, fail, at=10):
        super().__init__(*(ENVIRONMENT.pd_gains[name] for name in ("stiffness", "damping")), 0.5)
        self.count, self.fail, self.at = 0, fail, at

    def act(self, readings, applied=None, active=None):
        self.count += 1
        return self.fail() if self.count > self.at else super().act(readings, applied, active)


def lawless():
    """Return an agent whose law leaves its range after the warm-up."""
    commands = iter([np.zeros((1, 1))] * WARMED + [np.full((1, 1), 0.5)] * 16 + [np.full((1, 1), 3.0)])
    return AgentSpec("lawless", lambda observations: next(commands), {"sensors": "motor_encoders"})


def raising():
    raise RuntimeError("no\nsolution")


def test_the_arm_has_not_stopped_by_itself_at_the_time_of_the_faults():
    machine = FakeMachine(ENVIRONMENT, 9000, ENCODERS)
    run("pd", machine, seconds=0.2)
    assert np.abs(machine.path[9][1]).max() > 4 * REST


@pytest.mark.parametrize(
    ("fault", "agent", "text"),
    [
        (silent, "pd", f"no new readings for {SILENT_PERIODS} control periods"),
        (not_a_number, "pd", "reading motor_angles[0] is nan"),
        (out_of_range, "pd", "reading motor_angles[0] is 100"),
        (None, Faulty(raising, WARMED + 12), "the agent raised RuntimeError: no solution"),
        (None, Faulty(lambda: np.array([[np.nan]]), WARMED + 12), "the agent commands [nan], not within -1 to 1"),
        (None, lawless(), "the agent commands [3.0], not within -1 to 1"),
    ],
)
def test_each_fault_is_reported_and_ends_at_rest_within_the_limits(fault, agent, text):
    machine = FakeMachine(ENVIRONMENT, 9000, ENCODERS, fault)
    log = run(agent, machine)
    assert log.about["failure"] == text
    assert len(log.time) < 20 and log.about["machine"]["rest_seconds"] is not None
    _assert_rest(machine)


def test_a_signal_is_a_fault_and_ends_at_rest():
    def interrupt(machine, readings):
        if len(machine.commands) == 10 and not machine.arm.reason:
            signal.raise_signal(signal.SIGTERM)
        return readings

    handler = signal.getsignal(signal.SIGTERM)
    machine = FakeMachine(ENVIRONMENT, 9000, ENCODERS, interrupt)
    log = run("pd", machine)
    assert log.about["failure"] == "interrupted by SIGTERM" and len(log.time) < 20
    assert signal.getsignal(signal.SIGTERM) == handler
    _assert_rest(machine)


def test_readings_that_contradict_the_commands_are_a_fault():
    """An angle shifted by 0.2 rad; the arm is then not known to be at rest."""

    def shift(machine, readings):
        shifted = readings["motor_angles"] + 0.2 * (len(machine.commands) >= 10)
        return readings | {"motor_angles": shifted}

    log = run("pd", FakeMachine(ENVIRONMENT, 9000, ENCODERS, shift))
    failure = log.about["failure"]
    assert failure.startswith("reading motor_angles[0] is ") and failure.endswith("by the model")
    assert len(log.time) < 20 and log.about["machine"]["rest_seconds"] is None


def test_a_machine_with_another_number_of_motors_is_refused():
    machine = FakeMachine(ENVIRONMENT, 9000, ENCODERS)
    machine.quantities["motor_rates"] = 2
    line = refusal(run, "pd", machine)
    assert line == "machine: '2 values of motor_rates' is not allowed; give 1, the number of this arm"


def _assert_rest(machine):
    angles, rates, torques = (np.array(each) for each in zip(*machine.path, strict=True))
    assert machine.arm.reason and np.abs(rates[-1]).max() <= REST
    assert np.abs(torques).max() <= 0.5 and np.abs(angles).max() <= ENVIRONMENT.limits.angle


@pytest.mark.parametrize(("name", "value"), [("rate", 0.5), ("strain", 1e-5)])
def test_an_arm_beyond_its_limits_is_stopped(name, value):
    environment = ENVIRONMENT.replace(limits={name: value})
    machine = FakeMachine(ENVIRONMENT, 9000, LAB)
    log = drive("lqg", machine, environment, 9000)
    assert ("motor_rates" if name == "rate" else "strain beyond its limit") in log.about["failure"]
    assert len(machine.commands) < 50
    _assert_rest(machine)


@pytest.mark.parametrize("torques", [[np.nan], [0.51], [-np.inf]])
def test_the_machine_stops_at_torques_that_are_not_allowed(torques):
    machine = FakeMachine(ENVIRONMENT, 9000, ENCODERS)
    for _ in range(10):
        machine.write(np.array([0.5]))
    machine.write(np.array(torques))
    assert "not within the limits" in machine.arm.reason
    for _ in range(500):
        machine.clock.wait(machine.clock.now() + machine.period)
        machine.read()
    _assert_rest(machine)


def test_a_machine_without_the_quantities_of_the_agent_is_refused():
    with pytest.raises(ValueError, match=r"one that measures joint_twist_rates, joint_twists, root_strains, too"):
        run("lqg", FakeMachine(ENVIRONMENT, 9000, ENCODERS))
    with pytest.raises(ValueError, match="state"):
        run("lqr", FakeMachine(ENVIRONMENT, 9000, LAB))
    with pytest.raises(ValueError, match="control period"):
        drive("pd", FakeMachine(ENVIRONMENT, 9000, ENCODERS), ENVIRONMENT.replace(control_period=0.01))


@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexRRR-v0", "FlexPlanar-v0"])
def test_the_estimated_state_has_the_readings_and_the_least_energy(name):
    model = Configuration.find(name)
    model = fm.build_model(model.arm, 2)
    readings = LinearMeasurements(model).measure(np.random.default_rng(0).normal(size=(1, 2 * model.n_dof)))
    known = {each: readings[each][0] for each in MEASURED}
    state = StateEstimate(model, known, 0.01).state(known)
    again = {each: values[0] for each, values in LinearMeasurements(model).measure(state[None]).items()}
    for each in ("motor_angles", "joint_twists", "root_strains", "motor_rates", "joint_twist_rates"):
        np.testing.assert_allclose(again[each], known[each], atol=1e-9)
    stiffness, d = fm.stiffness_matrix(model), model.n_dof
    rows = np.vstack([LinearMeasurements(model).measure(np.eye(2 * d)[:d])[each].T for each in MEASURED[::2]])
    free = np.linalg.svd(rows)[2][np.linalg.matrix_rank(rows) :]  # motions that no sensor measures
    assert len(free) > 0
    force = stiffness @ state[:d]
    np.testing.assert_allclose(free @ force, 0.0, atol=1e-6 * np.abs(force).max())


def test_readings_that_were_not_received_are_nan_in_the_log_and_interpolated_for_a_fit():
    machine = FakeMachine(
        ENVIRONMENT, 9000, LAB, lambda machine, readings: None if len(machine.commands) == 7 else readings
    )
    log = run("lqg", machine)
    assert np.flatnonzero(np.isnan(log.readings["motor_angles"][:, 0])).tolist() == [7]
    assert log.about["machine"]["silent"] == 1
    record = fm.Measurement.from_episode(log)
    angles = log.readings["motor_angles"][:, 0]
    assert record.outputs["motor_angle_1"][7] == pytest.approx((angles[6] + angles[8]) / 2)
    assert np.array_equal(record.inputs["torque_1"][:-1], log.torques[:, 0])


def test_the_torques_of_the_log_are_those_that_the_machine_measured():
    late = ENVIRONMENT.replace(randomisation={"delay": [1, 1]})
    machine = FakeMachine(late, 9000, ENCODERS)
    log = run("pd", machine)
    assert np.array_equal(log.torques[1:, 0], np.array(machine.commands)[:-1, 0]) and log.torques[0, 0] == 0.0


def test_a_fit_finds_the_stiffness_of_the_machine_from_the_log(tmp_path):
    arm = ENVIRONMENT.arm
    softer = replace(arm, joints=(replace(arm.joints[0], stiffness=0.8 * arm.joints[0].stiffness),))
    plant = ENVIRONMENT.replace(arm=softer, gains=ENVIRONMENT.pd_gains, settings="named")
    log = fm.Episode.load(run("pd-torque", FakeMachine(plant, 9000, LAB), seconds=2.0).save(tmp_path / "log.npz"))
    found = fm.fit(arm, "joint_stiffness", records=[log])
    assert found.values["joint_stiffness"][0] == pytest.approx(softer.joints[0].stiffness, rel=0.02)


def test_the_diagnosis_of_a_log_is_that_of_the_episode():
    environment = Configuration.find("FlexOne-v0")
    expected = diagnose("pd", environment, [9000])[0]
    found = diagnose_log(rollout("pd", environment, [9000]).episode(0))
    assert found.rms == pytest.approx(expected.rms) and found.cause == expected.cause
    for cause, share in expected.shares.items():
        assert found.shares[cause] == pytest.approx(share, abs=1e-9)


def test_a_simulated_machine_behind_udp_is_driven_stopped_and_recorded():
    environment = ENVIRONMENT.replace(control_period=0.05, gains={"stiffness": [0.1], "damping": [0.1]})
    with SimulatedMachine(environment, 9000, Disturbances(loss=0.02)) as machine:
        log = drive("pd", machine.address, environment, 9000, seconds=1.0)
        record = machine.close()
    assert log.about["machine"]["received"]["accepted"] > 0 and record["packets"]["accepted"] > 0
    assert np.isfinite(record["states"]).all() and record["reason"]
    known = np.isfinite(log.readings["torques"][:, 0])
    assert np.isin(log.readings["torques"][known, 0], [0.0, *record["torques"][:, 0]]).all()


def test_a_machine_that_was_killed_is_reported():
    environment = ENVIRONMENT.replace(control_period=0.05, gains={"stiffness": [0.1], "damping": [0.1]})
    with SimulatedMachine(environment, 9000, Disturbances(fault="kill", fault_time=0.3)) as machine:
        log = drive("pd", machine.address, environment, 9000, seconds=2.0)
    assert "no new readings" in log.about["failure"] and log.about["machine"]["rest_seconds"] is None
