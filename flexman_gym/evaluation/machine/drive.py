"""Real-time loop of an agent and a machine: fixed control period, watchdog, stop, and a log as Episode."""

import gc
import time
from collections.abc import Callable, Mapping
from contextlib import closing, nullcontext
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import positive, value_error, whole_number
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import MAX_SEED
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.sensors import ModelState, find_sensors, measured_names
from flexman_gym.envs.sensors.sensor import measurement_ranges
from flexman_gym.envs.view import View
from flexman_gym.evaluation.agent import AgentSpec, find_agent, split_interface
from flexman_gym.evaluation.machine.machine import HELLO_SECONDS, UNITS, Machine, UdpMachine
from flexman_gym.evaluation.machine.simulated import ROUNDING, SILENT_PERIODS
from flexman_gym.evaluation.machine.state_estimate import StateEstimate
from flexman_gym.evaluation.rollout import TEST_SEEDS, RolloutLoop
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import LARGEST_STATE
from flexman_gym.model.linearization import LINEAR_SENSORS
from flexman_gym.scene.arm import Arm
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import BatchIntegrator
from flexman_gym.simulation.episode import Episode
from flexman_gym.simulation.external_simulator import ExternalIntegrator

MEASURED = tuple(name for names in LINEAR_SENSORS.values() for name in names)  # quantities of a real machine
LOGGED = ("motor_angles", "motor_rates", "torques")  # quantities that every log has, if the machine measures them
# time from the arrival of the first readings to the deadlines: fraction of the control period, at most, s
PHASE, LONGEST_PHASE = 0.1, 5e-4
SPIN = 1e-4  # s; end of a wait that is not slept, longer than a computer needs to wake up a process
READ_INTERVAL = 3e-4  # s; time between two attempts to read before the start and during the stop, more than SPIN
POLL_INTERVAL = 1e-5  # s; time between two attempts to read late readings
# number of readings before the start, whose median is the start, and of control periods in which deadlines are set
START_READINGS = 25
# control periods that the agent simulates before the start: to load kernels, to allocate the memory of its internal
# models, and to compute the gains and references of the move, of which each takes longer than some control periods
WARM_UP = 500
REST_RATE = 0.005  # fraction of Limits.rate; motors below this rate are at rest
REST_SECONDS, STOP_SECONDS = 0.2, 20.0  # s; shortest time at rest, and longest wait for it


class MonotonicClock:
    """Monotonic clock of the computer; `wait` sleeps until shortly before the deadline, and then spins."""

    def now(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def wait(self, deadline: float) -> None:
        """Return at a time, s."""
        if (rest := deadline - time.monotonic() - SPIN) > 0.0:
            time.sleep(rest)
        while time.monotonic() < deadline:
            pass


def drive(
    agent: object,
    machine: "str | Machine",
    environment: "str | Configuration | None" = None,
    seed: int = TEST_SEEDS[0],
    seconds: float | None = None,
    options: Mapping[str, Any] | None = None,
    silence: int = SILENT_PERIODS,
) -> Episode:
    """Drive a machine by an agent in real time, bring the arm to rest at the end, and return the log.

    The agent acts as in `rollout`, at first for up to `WARM_UP` control periods in a simulation without the machine. In
    each control period it reads the newest readings, and its torques are limited by the torque limits. The arm is
    brought to rest after the last period, and as soon as there are no new readings for `silence` control periods, a
    reading is NaN or out of its range, the arm exceeds its `Limits` or their margins, or the agent raises an exception
    or commands NaN. The cause is the failure of the log.

    The states of the log follow from the readings, see `StateEstimate`. Readings that were not received are NaN, and
    the agent then reads the last ones.

    Args:
        agent: as in `rollout`.
        machine: "udp:HOST:PORT", the address of a `SimulatedMachine`, or a Machine.
        environment: environment of the design, with goals, limits and model; None for that of the agent.
        seed: seed of the goal.
        seconds: duration, s; None for the horizon of the environment.
        options: options of the reset, such as goal_angles.
        silence: control periods without new readings after which the arm is stopped.

    Returns:
        Log, with statistics at `about["machine"]`: number of "periods", "lateness" at their deadlines, median and
        maximum (s), median "delay" of the torques after the deadlines (s), share "missed" of the torques that were sent
        when the next readings had arrived, "silent" periods without new readings, "received" packets (`packets.Counts`)
        and "rest_seconds" from the stop to rest, None for a machine that does not answer.

    Raises:
        OSError: for a machine that does not answer.
        ValueError: for an invalid argument, and for an agent that needs quantities which the machine does not measure.
    """
    spec = find_agent(agent)
    design = Configuration.find(environment or spec.environment or Configuration())
    whole_number("seed", seed, 0, MAX_SEED)
    whole_number("silence", silence, 1, 10**6)
    spec, needed = _prepared(spec, split_interface(design)[0])
    horizon = design.horizon if seconds is None else positive("seconds", seconds, "s")
    quiet = design.replace(randomisation=None, drive_bandwidth=None, horizon=horizon)
    names = list(dict.fromkeys([*needed, *LOGGED]))
    opened: Any = closing(UdpMachine(machine, names)) if isinstance(machine, str) else nullcontext(machine)
    with opened as robot:
        return _Loop(robot, quiet, needed, silence).run(spec, seed, dict(options or {}))


def _prepared(spec: AgentSpec, environment: Configuration) -> tuple[AgentSpec, list[str]]:
    """Return the agent designed for an environment with ideal sensors, and the quantities that it needs."""
    spec = spec.designed(environment)
    interface = dict(spec.interface or {})
    mode = interface.get("actions")
    sensors = find_sensors(interface.get("sensors", environment.sensors)) if spec.law else find_sensors("command")
    sensors = tuple(getattr(each, "sensor", each) for each in sensors)  # the flaws are those of the machine
    used = [*sensors, *(find_sensors(mode.sensors) if mode is not None else ())]
    names = list(dict.fromkeys(measured_names(used)))
    whole = any(isinstance(each, ModelState) for each in used) or not set(names) <= {*MEASURED}
    return replace(spec, interface=interface | {"sensors": sensors}), ["state"] if whole else names


class _Loop:
    """Control periods of an agent and a machine.

    Args:
        machine: the machine.
        environment: environment of the agent, without disturbances.
        needed: quantities that the agent needs.
        silence: control periods without new readings after which the arm is stopped.
    """

    def __init__(self, machine: Machine, environment: Configuration, needed: list[str], silence: int) -> None:
        self.fault = ""
        self._machine, self._environment, self._period, self._silence = machine, environment, machine.period, silence
        self._clock = getattr(machine, "clock", MonotonicClock())
        if missing := sorted({"motor_angles", *needed} - machine.quantities.keys()):
            own = f"one that measures {', '.join(machine.quantities)}"
            raise value_error("machine", own, f"one that measures {', '.join(missing)}, too, or another agent")
        if not np.isclose(self._period, environment.control_period, rtol=1e-6):
            raise value_error("machine", f"a control period of {self._period:g} s", f"{environment.control_period:g} s")
        self._phase = min(PHASE * self._period, LONGEST_PHASE)
        self._scale = _command_scale(environment.arm, machine.unit)
        self._deadline, self._lateness, self._delays, self._silent = 0.0, list[float](), list[float](), 0
        self._rows: list[Mapping[str, Array]] = []
        self._no_readings = {name: np.full(size, np.nan) for name, size in machine.quantities.items()}
        first = [self._new_readings() for _ in range(START_READINGS)]
        self._now = {name: np.median([readings[name] for readings in first], axis=0) for name in machine.quantities}

    def _new_readings(self) -> dict[str, Array]:
        """Return new readings of the machine."""
        end = self._clock.now() + HELLO_SECONDS
        while (readings := self._machine.read()) is None:
            if self._clock.now() > end:
                raise OSError("machine: it sends no readings")
            self._clock.wait(self._clock.now() + READ_INTERVAL)
        return {name: np.array(values, dtype=float) for name, values in readings.items()}

    def run(self, spec: AgentSpec, seed: int, options: dict[str, Any]) -> Episode:
        """Return the log of the control periods; the arm is at rest, or the machine does not answer."""
        options |= {"start": self._now["motor_angles"]}
        loop = RolloutLoop(spec, self._environment, [seed], options=options)
        agent, left = loop.episodes.agent, WARM_UP
        while left > 0 and not loop.over:
            loop.step()
            left -= agent.action_repeat
        if loop.law is not None:
            loop.law = self._guarded(loop.law, len(agent.mode.names))
        agent.act = self._guarded(agent.act, agent.mode.joints)
        self._prepare = self._guarded(partial(_prepare, loop.episodes), 1)
        gc.collect()
        gc.freeze()
        gc.disable()  # a collection takes longer than some control periods
        try:
            loop.begin(None, self._set_plant, options)
            while not loop.over:
                loop.step()
        finally:
            gc.enable()
            gc.unfreeze()
            self._machine.stop()
        return self._log(loop.result().episode(0), self._wait_for_rest())

    def _guarded(self, function: Callable[..., Any], size: int) -> Callable[..., Any]:
        """Return a function of the agent whose exceptions, and values that are not within -1 to 1, are faults."""

        def call(*arguments: Any) -> Any:
            try:
                result = np.asarray(function(*arguments))
                if (np.abs(result) <= 1.0 + 1e-6).all():
                    return result
                self.fault = self.fault or f"the agent commands {result.ravel().tolist()}, not within -1 to 1"
            except KeyboardInterrupt:
                self.fault = "interrupted"
            except Exception as error:
                self.fault = self.fault or f"the agent raised {type(error).__name__}: {' '.join(str(error).split())}"
            return np.zeros((1, size))

        return call

    def _set_plant(self, batch: Batch) -> None:
        """Replace the simulation of an arm by the machine."""
        limits = measurement_ranges(View(batch), self._environment.limits)
        self._bounds = {name: limits.get(name, LARGEST_STATE) * (1.0 + ROUNDING) for name in self._machine.quantities}
        self._estimate = StateEstimate(batch.model, self._machine.quantities, self._period)
        self._rows = [self._now]
        self._state = self._estimate.state(self._now)
        batch.replace_integrator(lambda inner: _MachineIntegrator(inner, self.exchange))

    def exchange(self, torques: Array | None) -> Array | None:
        """Send torques (n,), N m, wait for the end of the control period and return the state (2 d,); None for a fault.

        At the reset there are no torques, and the state is that of the first readings.
        """
        if torques is None:
            return self._state
        try:
            readings = None if self.fault else self._next_readings(torques / self._scale)
        except KeyboardInterrupt:
            readings, self.fault = None, "interrupted"
        self._rows.append(self._no_readings if readings is None else readings)
        if self.fault:
            return None
        if readings is not None:
            self._now, self._state = self._now | readings, self._estimate.state(self._now | readings)
        return self._state

    def _next_readings(self, commands: Array) -> dict[str, Array] | None:
        """Send commands, wait until the deadline, and return the newest readings; None without new readings."""
        if not self._lateness:  # the deadlines follow the packets of the machine, which then have arrived
            self._machine.read()
            self._new_readings()
            self._deadline = self._clock.now() + self._phase
            self._clock.wait(self._deadline)
        self._machine.write(commands)
        self._delays.append(self._clock.now() - self._deadline)
        self._prepare()
        self._deadline += self._period
        self._clock.wait(self._deadline)
        self._lateness.append(self._clock.now() - self._deadline)
        given = self._machine.read()
        if given is None and len(self._lateness) <= START_READINGS:
            given = self._late_readings()
        self._silent = self._silent + 1 if given is None else 0
        if given is None:
            if self._silent >= self._silence:
                self.fault = f"no new readings for {self._silence} control periods"
            return None
        readings = {name: np.array(values, dtype=float) for name, values in given.items()}
        for name, values in readings.items():
            beyond = ~(np.abs(values) <= self._bounds[name])
            if beyond.any():
                self.fault = self.fault or f"reading {name}[{int(np.argmax(beyond))}] is {values[beyond][0]:.4g}"
        return readings

    def _late_readings(self) -> Mapping[str, Any] | None:
        """Return readings that arrive up to half a period late, and let the deadlines follow them; None without any.

        A machine whose brakes are released may send its readings later in its period than at rest.
        """
        end, given = self._deadline + 0.5 * self._period, None
        while given is None and self._clock.now() < end:
            self._clock.wait(self._clock.now() + POLL_INTERVAL)
            given = self._machine.read()
        if given is not None:
            self._deadline = self._clock.now() + self._phase
        return given

    def _wait_for_rest(self) -> float | None:
        """Return the time until the motors are at rest after the stop, s; None without readings of their rates."""
        clock, limit = self._clock, REST_RATE * self._environment.limits.rate
        begin = resting = heard = clock.now()
        while clock.now() < begin + STOP_SECONDS and clock.now() < heard + 1.0:
            clock.wait(clock.now() + READ_INTERVAL)
            readings = self._machine.read()
            if readings is None or "motor_rates" not in readings:
                continue
            heard = clock.now()
            if not (np.abs(readings["motor_rates"]) <= limit).all():
                resting = heard
            if heard - resting >= REST_SECONDS:
                return resting - begin
        return None

    def _log(self, episode: Episode, rest_seconds: float | None) -> Episode:
        """Return the episode with all readings of the machine, the torques that it measured, and statistics."""
        names = [name for name in self._machine.quantities if name != "state"]
        raw = {name: np.array([row[name] for row in self._rows]) for name in names}
        torques = raw.get("torques", np.full((1, 1), np.nan))[-len(episode.torques) :]
        late, delays = np.array(self._lateness or [np.nan]), np.array(self._delays or [np.nan])
        receiver = getattr(self._machine, "receiver", None)
        statistics = {
            "periods": len(self._lateness), "lateness": [float(np.median(late)), float(late.max())],
            "delay": float(np.median(delays)), "missed": float(np.mean(delays > self._period - self._phase)),
            "silent": int(np.isnan(raw["motor_angles"]).all(axis=1).sum()), "rest_seconds": rest_seconds,
            "received": asdict(receiver.counts) if receiver else {},
        }  # fmt: skip
        about = {"units": episode.about["units"] | {name: UNITS[name] for name in raw}, "machine": statistics}
        return replace(
            episode, torques=np.where(np.isfinite(torques), torques, episode.torques), readings=episode.readings | raw,
            about=episode.about | about | {"failure": self.fault or episode.about["failure"]},
        )  # fmt: skip


def _prepare(episodes: Episodes) -> float:
    """Let the agent compute what its next action needs besides the readings, while the arm moves; return 0."""
    episodes.agent.prepare(episodes.view.action.copy(), ~episodes.over)
    return 0.0


class _MachineIntegrator(ExternalIntegrator):
    """Batch integrator of one arm whose states are those of a machine; outputs are computed by the model of the batch.

    Args:
        integrator: previous batch integrator.
        exchange: see `_Loop.exchange`.
    """

    def __init__(self, integrator: BatchIntegrator, exchange: Callable[[Array | None], Array | None]) -> None:
        self._integrator, self._exchange = integrator, exchange

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Set the state of the first readings, and compute the outputs."""
        state = self._exchange(None)
        assert state is not None
        rows[0, : len(state)] = state
        self._integrator.compute_outputs(arms, rows, outputs)

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Let the machine move for a control period."""
        state = self._exchange(drives[0, : drives.shape[1] - 6].copy())
        if state is None:
            status[0] = layout.DIVERGED
            return
        rows[0, : len(state)] = state
        self._integrator.compute_outputs(np.zeros(1, dtype=np.int64), rows, outputs)


def _command_scale(arm: Arm, unit: str) -> Array:
    """Return the joint torque (n,), N m, per unit of the commands of each motor."""
    if unit == "N m":
        return np.ones(arm.n_joints)
    motors = [joint.motor for joint in arm.joints]
    if None in motors:
        raise value_error("machine", f"commands in {unit}", "an arm with a Motor at each joint, or commands in N m")
    return np.array([motor.torque_per_ampere for motor in motors if motor])
