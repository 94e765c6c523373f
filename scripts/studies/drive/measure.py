"""Measurements of real-time loops on this computer."""

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import TEST_SEEDS, rollout
from flexman_gym.metrics import settling_time
from flexman_gym.metrics.statistics import median_interval, upper_median
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.deployment.machine.arm import STOPPING
from flexman_gym.toolbox.deployment.machine.clock import MonotonicClock
from flexman_gym.toolbox.deployment.machine.drive import WARM_UP, drive, wanted_quantities
from flexman_gym.toolbox.deployment.machine.machine import UdpMachine
from flexman_gym.toolbox.deployment.machine.rest import RestSpeeds
from flexman_gym.toolbox.deployment.machine.server import Disturbances
from flexman_gym.toolbox.deployment.machine.simulated import SimulatedMachine
from flexman_gym.toolbox.deployment.machine.virtual import VirtualMachine

FAULT_TIME = {"FlexRRR-v0": 1.0, "FlexRotary-v0": 0.3}  # s; in the middle of the slews
FAULT_LOOPS = {"pd": "FlexRRR-v0", "adaptive-lqr": "FlexRRR-v0", "lqg": "FlexRotary-v0"}  # agent -> environment
UNDISTURBED = ("pd", "adaptive-lqr")  # agents of the undisturbed runs
UNCERTAIN = "FlexRRR-v0/uncertain"  # environment of these runs
JITTER, LOST = 0.5, 0.1  # in these runs: mean delay of the readings, control periods; probability of a lost packet
LOOPS = {"adaptive-lqr": ("FlexRRR-v0", 7.0), "lqg": ("FlexRotary-v0", 3.0)}  # agent -> environment, duration (s)
PRIORITY = 50  # of SCHED_FIFO
WINDOW = 1.5  # s; end of an episode in which the vibration is measured
AFTER = 15.0  # s; time for which an arm is watched after a stop that no loop watches
NOISE = 1e-4  # fraction of the range of each sensor
LOSS = 0.01  # probability of a lost packet


@dataclass(frozen=True)
class LoopRow:
    """Row of a loop in one condition: medians over episodes, of simulations with a 95 % interval."""

    agent: str
    environment: str
    condition: str
    rate: float  # Hz
    load: float  # average number of running processes before the loop, on all cores
    episodes: float
    stopped: float  # episodes that the watchdog ended
    late_median: float  # s
    late_largest: float  # s
    delay: float  # s, from the deadline to the torques
    missed: float  # fraction of the periods
    silent: float  # fraction of the periods
    settled: float  # s
    settled_simulated: float
    settled_low: float
    settled_high: float
    vibration: float  # m, peak to peak
    vibration_simulated: float
    vibration_low: float
    vibration_high: float


@dataclass(frozen=True)
class FaultRow:
    """Row of a fault of a loop; nan for an arm that is gone with its process."""

    fault: str
    agent: str
    environment: str
    reported: str  # by the loop
    reason: str  # by the machine
    noticed: float  # control periods from the first wrong readings to the last deadline of the loop
    speed: float  # rad/s, largest motor rate at the stop
    rest: float  # s
    share: float  # largest quantity relative to its limit, from the fault on
    torque: float  # largest torque relative to its limit


@dataclass(frozen=True)
class UndisturbedRow:
    """Row of runs of an agent on arms with uncertain parameters, with lost and late packets but without a fault."""

    agent: str
    environment: str
    jitter: float  # control periods
    loss: float  # probability
    runs: float
    stopped: float
    periods: float  # of all runs
    test: float  # s, median computing time of the tests of the readings of a period


@dataclass(frozen=True)
class RoundTripRow:
    """Row of a fit from a log: stiffness of a joint relative to the data sheet, and its estimate."""

    environment: str
    agent: str
    joint: float
    true: float
    found: float
    deviation: float


@contextmanager
def scheduled(priority: int) -> Iterator[None]:
    """Run this process and its children by SCHED_FIFO with a priority; 0 for the usual scheduling."""
    kind = os.SCHED_FIFO if priority else os.SCHED_OTHER
    os.sched_setscheduler(0, kind, os.sched_param(priority))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class _Condition(NamedTuple):
    """Condition: number of episodes, priority, and disturbances."""

    episodes: int
    priority: int = PRIORITY
    disturbances: Disturbances = Disturbances()


def conditions(episodes: int) -> dict[str, _Condition]:
    """Return the conditions of a loop by name; those with disturbances have half of the episodes."""
    some = (episodes + 1) // 2
    return {
        "real-time priority": _Condition(episodes),
        "no priority": _Condition(1, 0),
        "1 % of the packets lost": _Condition(some, disturbances=Disturbances(loss=LOSS)),
        "torques from their arrival": _Condition(some, disturbances=Disturbances(asynchronous=True)),
    }


def measure_loop(agent: str, name: str, condition: _Condition) -> LoopRow:
    """Return the row of a loop of an agent in a condition."""
    environment, seconds = LOOPS[agent]
    configuration = Configuration.find(environment)
    logs, errors, tips, load = [], [], [], os.getloadavg()[0]
    with scheduled(condition.priority):
        for seed in TEST_SEEDS[: condition.episodes]:
            with SimulatedMachine(configuration, seed, condition.disturbances) as machine:
                logs.append(drive(agent, machine.address, configuration, seed, seconds))
                record = machine.close()
            tips.append(np.vstack([logs[-1].tips[:1], record["tips"][: round(seconds / configuration.control_period)]]))
            errors.append(np.linalg.norm(tips[-1] - logs[-1].targets[-1], axis=1))
    expected = rollout(agent, configuration.replace(horizon=seconds), TEST_SEEDS[: condition.episodes])
    period = expected.period
    settled, simulated = (
        [settling_time(each, expected.band, period) for each in some] for some in (errors, expected.errors)
    )
    vibration, quiet = ([_vibration(each, period) for each in some] for some in (tips, expected.tips))
    loop = [log.about["machine"] for log in logs]
    periods = sum(each["periods"] for each in loop)
    return LoopRow(
        agent, environment, name, 1.0 / period, load, condition.episodes,
        sum(bool(log.about["failure"]) for log in logs),
        float(np.median([each["lateness"][0] for each in loop])), max(each["lateness"][1] for each in loop),
        float(np.median([each["delay"] for each in loop])),
        sum(each["missed"] * each["periods"] for each in loop) / periods,
        sum(each["silent"] for each in loop) / periods,
        upper_median(np.array(settled)), *median_interval(np.array(simulated)),
        upper_median(np.array(vibration)), *median_interval(np.array(quiet)),
    )  # fmt: skip


def _vibration(tips: Array, period: float) -> float:
    """Return the largest peak-to-peak motion along a base axis at the end of an episode, m."""
    return float(np.ptp(tips[-round(WINDOW / period) :], axis=0).max())


class _Killer(MonotonicClock):
    """Clock that kills its process at a time after the first deadline, s."""

    def __init__(self, after: float) -> None:
        self._after, self._end = after, np.inf

    def wait(self, deadline: float) -> None:
        """Wait, or kill the process."""
        if deadline - self.now() > 1e-3:  # a deadline of the loop, not an attempt to read
            self._end = min(self._end, self.now() + self._after)
        if self.now() > self._end:
            os.kill(os.getpid(), signal.SIGKILL)
        super().wait(deadline)


def _drive_until_killed(agent: str, address: str, configuration: Configuration, after: float) -> None:
    machine = UdpMachine(address, wanted_quantities(agent, configuration))
    machine.clock = _Killer(after)
    drive(agent, machine, configuration)


class _FailingMode:
    """Action mode that raises an exception, or without a text commands NaN, after a number of control periods."""

    def __init__(self, mode: Any, periods: int, text: str) -> None:
        self._mode, self._left, self._text = mode, periods, text

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_mode"], name)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return type(self)(deepcopy(self._mode, memo), self._left, self._text)

    def act(self, *arguments: Any) -> Any:
        """Return the torques as fractions of their limits."""
        self._left -= 1
        if self._left < 0 and self._text:
            raise RuntimeError(self._text)
        return self._mode.act(*arguments) * (np.nan if self._left < 0 else 1.0)


KINDS = {  # row of the page -> names of its faults -> fault of the machine, or text of the exception of the agent
    "agent killed, raises an exception, or commands NaN": {
        "agent killed": "", "agent raises an exception": "no solution", "agent commands NaN": "",
    },
    "machine killed or silent, packets replayed": {
        "machine killed": "kill", "machine silent": "silent", "replayed packets": "replay",
    },
    "clock stands, jumps, or runs twice as fast": {
        "clock stands": "clock stands", "clock jumps": "clock jumps", "clock runs twice as fast": "clock drifts",
    },
    "readings 2.5 periods late": {"readings 2.5 periods late": "late"},
    "readings every half or every second period": {
        "readings every half period": "fast", "readings every second period": "slow",
    },
    "four of five packets lost": {"four of five packets lost": "lossy"},
    "readings frozen: all, encoders, or one joint": {
        "all readings frozen": "frozen", "encoders frozen": "frozen encoders", "one joint frozen": "frozen joint",
    },
    "NaN, reversed rates, shifted angles, degrees, joints swapped, torque": {
        "NaN reading": "nan", "rates reversed": "rates reversed", "angles shifted": "bias",
        "angles in degrees": "degrees", "joints swapped": "joints swapped", "torque reading of 2000 limits": "torque",
    },
}  # fmt: skip
FAULTS = {name: fault for kind in KINDS.values() for name, fault in kind.items()}
OF_AGENT = tuple(FAULTS)[:3]
REAL = (*OF_AGENT, "machine killed")  # faults of processes, measured in real time, the others in virtual time
NOT_OF_ONE_JOINT = ("joints swapped",)  # faults that an arm of one joint cannot have


def measure_faults(agent: str) -> list[FaultRow]:
    """Return the rows of all faults in the loop of an agent."""
    joints = Configuration.find(FAULT_LOOPS[agent]).arm.n_joints
    return [measure_fault(fault, agent) for fault in FAULTS if joints > 1 or fault not in NOT_OF_ONE_JOINT]


def measure_fault(fault: str, agent: str) -> FaultRow:
    """Return the row of a fault in the loop of an agent."""
    environment = FAULT_LOOPS[agent]
    configuration, after = Configuration.find(environment), FAULT_TIME[environment]
    measure = _in_real_time if fault in REAL else _in_virtual_time
    log, record = measure(fault, agent, configuration, after)
    reported = "the process of the agent is gone" if log is None else str(log.about["failure"])
    if not len(record.get("time", ())):
        return FaultRow(fault, agent, environment, reported, "", *[np.nan] * 5)
    noticed = np.nan if log is None else log.about["machine"]["periods"] - round(after / configuration.control_period)
    return FaultRow(fault, agent, environment, reported, record["reason"], noticed, *_after_stop(record, configuration))


def _in_virtual_time(
    fault: str, agent: str, configuration: Configuration, after: float
) -> tuple[Episode | None, dict[str, Any]]:
    """Return the log of the loop and the record of the machine for a fault of the machine."""
    disturbances = Disturbances(fault=FAULTS[fault], fault_time=after)
    wanted = wanted_quantities(agent, configuration)
    machine = VirtualMachine(configuration, TEST_SEEDS[0], disturbances, wanted)
    log = drive(agent, machine, configuration)
    machine.wait(machine.now() + AFTER)
    return log, machine.record()


def _in_real_time(
    fault: str, agent: str, configuration: Configuration, after: float
) -> tuple[Episode | None, dict[str, Any]]:
    """Return the log of the loop, None for a killed agent, and the record of the machine; {} for a killed machine."""
    disturbances = Disturbances() if fault in OF_AGENT else Disturbances(fault=FAULTS[fault], fault_time=after)
    spec = find_agent(agent)
    if "raises" in fault or "commands" in fault:
        spec = spec.designed(configuration)
        assert spec.interface is not None
        begin = min(WARM_UP, configuration.max_periods)
        periods = begin + round(after / configuration.control_period)
        mode = _FailingMode(spec.interface["actions"], periods, FAULTS[fault])
        spec = replace(spec, interface=spec.interface | {"base": None, "actions": mode})
    log: Episode | None = None
    with scheduled(PRIORITY), SimulatedMachine(configuration, TEST_SEEDS[0], disturbances) as machine:
        if fault == "agent killed":
            context = multiprocessing.get_context("spawn")
            arguments = agent, machine.address, configuration, after
            process = context.Process(target=_drive_until_killed, args=arguments)
            process.start()
            process.join()
            time.sleep(AFTER)
        else:
            log = drive(spec, machine.address, configuration)
        return log, machine.close()


def _after_stop(record: dict[str, Any], configuration: Configuration) -> tuple[float, float, float, float]:
    """Return largest motor rate at the stop, time until the motors stay at rest (s), and shares of the limits."""
    model = resolve_fidelity(configuration).model
    measured, limits = LinearMeasurements(model).measure(record["states"]), configuration.limits
    stopped = int(np.argmax(record["mode"] == STOPPING))
    rates = np.abs(measured["motor_rates"]).max(axis=1)
    moving = np.flatnonzero(rates > RestSpeeds(model, np.array(configuration.torque_limit)).motors)
    lengths = np.repeat(model.constants.length, 2)
    scales = {
        "motor_angles": limits.angle, "motor_rates": limits.rate, "joint_twists": limits.twist,
        "joint_twist_rates": limits.rate, "link_deflections": limits.deflection * lengths,
        "link_deflection_rates": limits.deflection_rate,
    }  # fmt: skip
    share = max(float(np.max(np.abs(measured[name][stopped:]) / scale)) for name, scale in scales.items())
    torque = float(np.max(np.abs(record["torques"]) / np.array(configuration.torque_limit)))
    rest = (moving[-1] + 1 - stopped) * configuration.control_period if len(moving) else 0.0
    return float(rates[stopped]), max(float(rest), 0.0), share, torque


def measure_undisturbed(agent: str, runs: int) -> UndisturbedRow:
    """Return the row of runs of an agent on uncertain arms in virtual time, from the first test seed on."""
    configuration, stopped, periods, times = Configuration.find(UNCERTAIN), 0, 0, list[float]()
    wanted = wanted_quantities(agent, configuration)
    disturbances = Disturbances(jitter=JITTER * configuration.control_period, loss=LOST)
    for seed in range(TEST_SEEDS[0], TEST_SEEDS[0] + runs):
        machine = VirtualMachine(configuration, seed, disturbances, wanted)
        loop = drive(agent, machine, configuration, seed).about
        stopped, periods = stopped + bool(loop["failure"]), periods + loop["machine"]["periods"]
        times.append(loop["machine"]["test"])
    return UndisturbedRow(agent, UNCERTAIN, JITTER, LOST, runs, stopped, periods, float(np.median(times)))


def measure_round_trip(joint: int, factor: float) -> RoundTripRow:
    """Return the row of a fit from the log of a machine with a changed joint, sensor noise and lost packets."""
    environment, agent = Configuration.find("FlexRRR-v0"), "pd-torque"
    joints = list(environment.arm.joints)
    true = factor * float(joints[joint].stiffness or 0.0)
    joints[joint] = replace(joints[joint], stiffness=true)
    noise = {"sensor_noise": [NOISE, NOISE]}
    plant = environment.replace(
        arm=replace(environment.arm, joints=tuple(joints)), gains=environment.pd_gains, randomisation=noise
    )
    with scheduled(PRIORITY), SimulatedMachine(plant, TEST_SEEDS[0], Disturbances(loss=LOSS)) as machine:
        log = drive(find_agent(agent), machine.address, environment, seconds=6.0)
    name = f"joint_stiffness[{joint}]"
    found = fm.fit(environment.arm, name, records=[log])
    scale = factor / true
    values = factor, scale * found.values[name], scale * found.deviations[name]
    return RoundTripRow(environment.id, agent, joint + 1, *values)
