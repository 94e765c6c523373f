"""Faults of a machine in virtual time: each is noticed within five control periods, named, and ends at rest."""

import os
import signal

import numpy as np
import pytest

from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.toolbox.deployment.machine.drive import drive, wanted_quantities
from flexman_gym.toolbox.deployment.machine.faults import FAULTS, LATE
from flexman_gym.toolbox.deployment.machine.rest import RestSpeeds
from flexman_gym.toolbox.deployment.machine.server import Disturbances
from flexman_gym.toolbox.deployment.machine.virtual import VirtualMachine

pytestmark = pytest.mark.slow

NOTICE = 5  # control periods
FAULT_PERIOD = 20  # control period of the machine whose readings are the first with the fault
ONE, PLANAR = Configuration.find("FlexOne-v0").replace(horizon=2.0), Configuration.find("FlexPlanar-v0")
SILENT, STAMPS = "no new readings for 5 control periods", "the machine stamps a sample every"
REPORTED = {
    "silent": SILENT, "replay": SILENT, "clock stands": SILENT, "clock jumps": "the clock of the machine is wrong by",
    "clock drifts": STAMPS, "late": "readings are", "fast": STAMPS, "slow": STAMPS, "lossy": "packets are lost",
    "nan": "is nan", "frozen": "stands still", "frozen encoders": "stands still", "frozen joint": "stands still",
    "rates reversed": "by the model", "bias": "by the model", "degrees": "reading motor_",
    "joints swapped": "by the model", "torque": "reading torques[0] is",
}  # fmt: skip


def machine_with(environment, agent, fault="", fault_period=FAULT_PERIOD):
    """Return a virtual machine with a fault from a control period on."""
    disturbances = Disturbances(fault=fault, fault_time=fault_period * environment.control_period)
    return VirtualMachine(environment, 9000, disturbances, wanted_quantities(agent, environment))


def at_rest(machine, environment):
    """Return True if the motors of a machine that was stopped come to rest."""
    model, limits = resolve_fidelity(environment).model, np.array(environment.torque_limit)
    speeds = RestSpeeds(model, limits)
    machine.wait(machine.now() + 10.0 * speeds.slew)
    record = machine.record()
    rates = LinearMeasurements(model).measure(record["states"][-1:])["motor_rates"]
    return np.abs(rates).max() <= speeds.motors and (np.abs(record["torques"]) <= limits * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("fault", sorted({*FAULTS} - {"kill"}))
@pytest.mark.parametrize(
    ("environment", "agent"), [(ONE, "pd"), (PLANAR, "pd"), (ONE, "lqg")], ids=["one-pd", "planar-pd", "one-lqg"]
)
def test_a_fault_is_noticed_within_five_periods_and_ends_at_rest(fault, environment, agent):
    if fault == "joints swapped" and environment is ONE:
        environment = PLANAR  # an arm of one joint has no order
    machine = machine_with(environment, agent, fault=fault)
    log = drive(agent, machine, environment, 9000)
    assert REPORTED[fault] in log.about["failure"]
    assert 0 <= log.about["machine"]["periods"] - FAULT_PERIOD <= NOTICE
    assert at_rest(machine, environment)


@pytest.mark.parametrize("fault", ["frozen", "frozen encoders", "rates reversed", "joints swapped"])
def test_wrong_values_from_the_start_are_noticed_when_the_motion_exceeds_their_deviation(fault):
    machine = machine_with(PLANAR, "pd", fault=fault, fault_period=0)
    log = drive("pd", machine, PLANAR, 9000)
    assert log.about["failure"] and "beyond" not in log.about["failure"]
    true = LinearMeasurements(resolve_fidelity(PLANAR).model).measure(machine.record()["states"])["motor_angles"]
    visible = 1e-4 * PLANAR.limits.angle  # smallest deviation of an angle for the observers
    moment = np.argmax(np.abs(true - log.readings["motor_angles"][0]).max(axis=1) > visible)
    assert log.about["machine"]["periods"] - (moment + 1) <= NOTICE
    assert at_rest(machine, PLANAR)


@pytest.mark.parametrize(
    ("fault", "text"),
    [("late", f"readings that are {20 * LATE:g}"), ("slow", "readings every 40 ms"), ("fast", "readings every 10 ms")],
)
def test_late_readings_and_another_period_are_refused_before_the_arm_moves(fault, text):
    machine = machine_with(ONE, "pd", fault=fault, fault_period=0)
    with pytest.raises(ValueError, match=text):
        drive("pd", machine, ONE, 9000)
    assert len(machine.record()["time"]) == 0


@pytest.mark.parametrize(("name", "agent", "seed"), [
    ("FlexRRR-v0/uncertain", "pd", 9000), ("FlexRRR-v0/uncertain", "adaptive-lqr", 9001), ("FlexPlanar-v0", "pd", 9002),
    ("FlexRRR-Gravity-v0/uncertain", "pd", 9003), ("FlexRotary-v0", "lqg", 9004), ("FlexOne-v0", "random", 9005),
])  # fmt: skip
def test_an_undisturbed_arm_of_other_parameters_is_not_stopped_by_lost_and_late_packets(name, agent, seed):
    environment = Configuration.find(name)
    packets = Disturbances(jitter=environment.control_period / 2, loss=0.1)
    machine = VirtualMachine(environment, seed, packets, wanted_quantities(agent, environment))
    log = drive(agent, machine, environment, seed, 100 * environment.control_period)
    assert log.about["failure"] == "" and log.about["machine"]["received"]["repeated"] > 100
    assert log.about["machine"]["periods"] == 100


def test_time_that_passes_before_the_first_command_is_no_fault():
    class Slow(PD):
        def reset(self, arms, episode, count):
            machine.wait(machine.now() + 3.0)
            super().reset(arms, episode, count)

    gains = ONE.pd_gains
    machine = machine_with(ONE, "pd")
    log = drive(Slow(gains["stiffness"], gains["damping"], ONE.torque_limit), machine, ONE, 9000, 0.4)
    assert log.about["failure"] == ""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_the_arm_and_leaves_a_log(number):
    class Interrupted(PD):
        def act(self, readings, applied=None, active=None):
            if machine.record()["time"].size == 10:
                os.kill(os.getpid(), number)
            return super().act(readings, applied, active)

    gains, before = ONE.pd_gains, signal.getsignal(number)
    machine = machine_with(ONE, "pd")
    log = drive(Interrupted(gains["stiffness"], gains["damping"], ONE.torque_limit), machine, ONE, 9000)
    assert log.about["failure"] == f"interrupted by {number.name}" and 10 <= log.about["machine"]["periods"] <= 12
    assert signal.getsignal(number) is before and at_rest(machine, ONE)


def test_a_machine_that_loses_all_orders_to_stop_but_one_in_five_stops():
    machine = machine_with(ONE, "pd", fault="lossy")
    drive("pd", machine, ONE, 9000)
    assert machine.arm.reason == "ordered by the controller"


def test_torques_that_differ_from_the_commands_are_noticed():
    machine = machine_with(ONE, "pd")
    inner = machine.arm.readings
    machine.arm.readings = lambda names: inner(names) | {"torques": 0.3 * inner(["torques"])["torques"]}
    log = drive("pd", machine, ONE, 9000)
    assert "but the commands are" in log.about["failure"] and log.about["machine"]["periods"] <= NOTICE


def test_the_tip_of_an_arm_rests_later_than_its_motor_and_its_speed_is_that_of_the_arm():
    machine = machine_with(ONE, "lqg")
    log = drive("lqg", machine, ONE, 9000, 0.5)
    loop, record = log.about["machine"], machine.record()
    assert loop["rest_seconds"] is not None and loop["motor_rate"] < 0.05
    speed = np.linalg.norm(record["tip_velocities"], axis=1)
    limit = RestSpeeds(resolve_fidelity(ONE).model, np.array(ONE.torque_limit)).tip
    assert loop["tip_speed"] == pytest.approx(speed[-1], abs=0.2 * limit)
    after = record["time"] - record["time"][np.argmax(record["mode"] == 2)]
    moving = after[speed > 1.5 * limit]
    assert moving[-1] > 0.0
    assert loop["tip_rest_seconds"] is None or loop["tip_rest_seconds"] >= moving[-1] - 2 * ONE.control_period


def test_an_arm_without_readings_of_its_links_has_no_known_tip_speed():
    log = drive("pd", machine_with(ONE, "pd"), ONE, 9000, 0.2)
    assert log.about["machine"]["tip_speed"] is None and log.about["machine"]["tip_rest_seconds"] is None


def test_the_fault_of_a_whole_process_is_not_virtual():
    with pytest.raises(ValueError, match="fault: 'kill' is not allowed"):
        VirtualMachine(ONE, 9000, Disturbances(fault="kill"))


def test_the_rest_of_an_arm_with_wrong_readings_is_not_known():
    log = drive("pd", machine_with(ONE, "pd", fault="frozen"), ONE, 9000)
    assert log.about["machine"]["rest_seconds"] is None and log.about["machine"]["motor_rate"] is None


def test_the_quantities_asked_for_are_those_of_the_agent_and_of_the_log():
    assert wanted_quantities("pd", ONE) == ["motor_angles", "motor_rates", "torques"]
    assert {"root_strains", "torques"} < set(wanted_quantities("lqg", ONE))
