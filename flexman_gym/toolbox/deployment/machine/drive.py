"""Real-time loop of an agent and a machine: fixed control period, watchdog, stop, and a log as Episode."""

import gc
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import positive, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import MAX_SEED
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.sensors import ModelState, find_sensors
from flexman_gym.envs.sensors.sensor import measurement_ranges
from flexman_gym.envs.sensors.sensor_array import measured_names
from flexman_gym.envs.view import View
from flexman_gym.evaluation.agent_spec import AgentSpec, split_interface
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import TEST_SEEDS, RolloutLoop
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import LARGEST_STATE
from flexman_gym.model.linearization import LINEAR_SENSORS, measurement_rows
from flexman_gym.scene.arm import Arm
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import BatchIntegrator
from flexman_gym.simulation.episode import Episode
from flexman_gym.simulation.external_simulator import ExternalIntegrator
from flexman_gym.toolbox.deployment.machine.arm import ROUNDING, check_torques
from flexman_gym.toolbox.deployment.machine.clock import MonotonicClock
from flexman_gym.toolbox.deployment.machine.machine import (
    HELLO_SECONDS,
    READ_INTERVAL,
    UNITS,
    Machine,
    Receipt,
    UdpMachine,
)
from flexman_gym.toolbox.deployment.machine.plausibility import TORQUE_ERROR, InnovationTest, with_disturbances
from flexman_gym.toolbox.deployment.machine.rest import REST, RestSpeeds, RestWait, noise_level
from flexman_gym.toolbox.deployment.machine.simulated import SILENT_PERIODS
from flexman_gym.toolbox.deployment.machine.state_estimate import StateEstimate
from flexman_gym.toolbox.deployment.machine.timing import TimingTest

MEASURED = tuple(name for names in LINEAR_SENSORS.values() for name in names)  # quantities of a real machine
LOGGED = ("motor_angles", "motor_rates", "torques")  # quantities that every log has, if the machine measures them
# time from the arrival of the first readings to the deadlines: fraction of the control period, at most, s
PHASE, LONGEST_PHASE = 0.1, 5e-4
POLL_INTERVAL = 1e-5  # s; time between two attempts to read late readings
# number of readings before the start, whose median is the start, and of control periods in which deadlines are set
START_READINGS = 25
# control periods that the agent simulates before the start: to load kernels, to allocate the memory of its internal
# models, and to compute the gains and references of the move, of which each takes longer than some control periods
WARM_UP = 500


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
    brought to rest after the last period, at SIGINT and SIGTERM, and as soon as there are no new readings for `silence`
    control periods, readings are late, at another rate than the period, or too few (`timing.TimingTest`), a reading is
    NaN or out of its range, stands still or contradicts the commands (`plausibility.InnovationTest`), the arm exceeds
    its `Limits` or their margins, or the agent raises an exception or commands NaN. The cause is the failure of the
    log.

    The states of the log follow from the readings, see `StateEstimate`. Readings that were not received are NaN, and
    the agent then reads the last ones.

    Args:
        agent: as in `rollout`.
        machine: "udp:HOST:PORT", the address of a `SimulatedMachine`, or a Machine.
        environment: environment of the design, with goals, limits, model, and ranges of the uncertain parameters and
            the noise, from which the bounds of plausible readings follow; None for that of the agent.
        seed: seed of the goal.
        seconds: duration, s; None for the horizon of the environment.
        options: options of the reset, such as goal_angles.
        silence: control periods without new readings after which the arm is stopped.

    Returns:
        Log, with statistics at `about["machine"]`: number of "periods", "lateness" at their deadlines, median and
        maximum (s), median "delay" of the torques after the deadlines (s), share "missed" of the torques that were sent
        when the next readings had arrived, "silent" periods without new readings, median computing time of a "test" of
        the values of readings (s), which begins when the torques are sent, "received" packets (`packets.Counts`) and
        what `rest.RestWait` returns: the times from the stop to the rest of motors and tip, and their last speeds.

    Raises:
        OSError: for a machine that does not answer.
        ValueError: for an invalid argument, for an agent that needs quantities which the machine does not measure, and
            for a machine with another number of values, with another period or with late readings before the start.
    """
    spec = find_agent(agent)
    design = Configuration.find(environment or spec.environment or Configuration())
    whole_number("seed", seed, 0, MAX_SEED)
    whole_number("silence", silence, 1, 10**6)
    spec, needed = _prepared(spec, split_interface(design)[0])
    horizon = design.horizon if seconds is None else positive("seconds", seconds, "s")
    design = design.replace(horizon=horizon)
    names = list(dict.fromkeys([*needed, *LOGGED]))
    opened: Any = closing(UdpMachine(machine, names)) if isinstance(machine, str) else nullcontext(machine)
    with opened as robot:
        return _Loop(robot, design, needed, silence).run(spec, seed, dict(options or {}))


def wanted_quantities(agent: object, environment: "str | Configuration") -> list[str]:
    """Return the names of the quantities that `drive` asks a machine for; arguments as in `drive`."""
    needed = _prepared(find_agent(agent), split_interface(Configuration.find(environment))[0])[1]
    return list(dict.fromkeys([*needed, *LOGGED]))


def _prepared(spec: AgentSpec, environment: Configuration) -> tuple[AgentSpec, list[str]]:
    """Return the agent designed for an environment with ideal sensors, and the quantities that it needs."""
    check_torques(environment)
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
        design: environment of the design.
        needed: quantities that the agent needs.
        silence: control periods without new readings after which the arm is stopped.
    """

    def __init__(self, machine: Machine, design: Configuration, needed: list[str], silence: int) -> None:
        self.fault = self._doubt = ""
        self._machine, self._period, self._silence = machine, machine.period, silence
        self._environment = design.replace(randomisation=None, drive_bandwidth=None)
        self._plant = with_disturbances(make_plant(design, resolve_fidelity(design).model), design)
        self._clock = getattr(machine, "clock", MonotonicClock())
        self._check(needed)
        self._phase = min(PHASE * self._period, LONGEST_PHASE)
        self._scale = _command_scale(design.arm, machine.unit)
        self._deadline, self._lateness, self._delays, self._silent = 0.0, list[float](), list[float](), 0
        self._rows: list[Mapping[str, Array]] = []
        self._no_readings = {name: np.full(size, np.nan) for name, size in machine.quantities.items()}
        self._commands: list[Array] = []  # N m
        self._timing, self._test_times = TimingTest(self._period, silence), list[float]()
        self._first = self._first_readings()
        self._now = {name: np.median([each[name] for each in self._first], axis=0) for name in machine.quantities}

    def _check(self, needed: list[str]) -> None:
        """Raise ValueError for a machine that does not fit the agent and the arm."""
        quantities = self._machine.quantities
        if missing := sorted({"motor_angles", *needed} - quantities.keys()):
            own = f"one that measures {', '.join(quantities)}"
            raise value_error("machine", own, f"one that measures {', '.join(missing)}, too, or another agent")
        model = self._plant.model
        sizes = {name: len(rows) for name, rows in measurement_rows(model).items()}
        sizes |= {"torques": model.n_joints, "state": 2 * model.n_dof}
        for name, size in quantities.items():
            if size != sizes.get(name, size):
                raise value_error("machine", f"{size} values of {name}", f"{sizes[name]}, the number of this arm")
        if not np.isclose(self._period, self._environment.control_period, rtol=1e-6):
            allowed = f"{self._environment.control_period:g} s"
            raise value_error("machine", f"a control period of {self._period:g} s", allowed)

    def _first_readings(self) -> list[dict[str, Array]]:
        """Return the readings of the braked arm; ValueError for readings that are late or of another period."""
        readings, receipts = [], list[tuple[Receipt, float]]()
        for _ in range(START_READINGS):
            readings.append(self._new_readings())
            if (receipt := getattr(self._machine, "receipt", None)) is not None:
                receipts.append((receipt, self._clock.now()))
        if wrong := self._timing.start(receipts):
            raise value_error("machine", wrong, f"new ones every {1e3 * self._period:g} ms")
        for name, values in readings[-1].items():
            if values.shape != (self._machine.quantities[name],) or not np.isfinite(values).all():
                raise value_error("machine", f"{name} = {values.tolist()}", "finite readings of the braked arm")
        return readings

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
        if agent.law is not None:
            agent.law = self._guarded(agent.law, len(agent.mode.names))
        agent.torques = self._guarded(agent.torques, agent.mode.joints)
        self._prepare = self._guarded(partial(_prepare, loop.episodes), 1)
        self._innovations = self._innovation_test()
        gc.collect()
        gc.freeze()
        gc.disable()  # a collection takes longer than some control periods
        try:
            with self._signals():
                loop.begin(None, self._set_plant, options)
                while not loop.over:
                    loop.step()
        finally:
            gc.enable()
            gc.unfreeze()
            self._machine.stop()
        return self._log(loop.result().episode(0), self._wait_for_rest())

    def _innovation_test(self) -> InnovationTest:
        """Return the test of the values of readings, after a trial that loads its kernels."""
        test = InnovationTest(self._plant, self._first)
        test.advance(np.zeros(self._plant.model.n_joints))
        return InnovationTest(self._plant, self._first)

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Make a first SIGINT or SIGTERM a fault; a second one acts as before."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}

        def note(number: int, _: object) -> None:
            self.fault = self.fault or f"interrupted by {signal.Signals(number).name}"
            signal.signal(number, before[signal.Signals(number)])

        for each in before:
            signal.signal(each, note)
        try:
            yield
        finally:
            for each, handler in before.items():
                signal.signal(each, handler)

    def _guarded(self, function: Callable[..., Any], size: int) -> Callable[..., Any]:
        """Return a function of the agent whose exceptions, and values that are not within -1 to 1, are faults."""

        def call(*arguments: Any) -> Any:
            try:
                result = np.asarray(function(*arguments))
                if (np.abs(result) <= 1.0 + 1e-6).all():
                    return result
                self.fault = self.fault or f"the agent commands {result.ravel().tolist()}, not within -1 to 1"
            except Exception as error:
                self.fault = self.fault or f"the agent raised {type(error).__name__}: {' '.join(str(error).split())}"
            return np.zeros((1, size))

        return call

    def _set_plant(self, batch: Batch) -> None:
        """Replace the simulation of an arm by the machine."""
        limits = measurement_ranges(View(batch), self._environment.limits)
        limits["torques"] = (1.0 + TORQUE_ERROR) * np.array(self._plant.torque_limit)
        self._bounds = {name: limits.get(name, LARGEST_STATE) * (1.0 + ROUNDING) for name in self._machine.quantities}
        self._estimate = StateEstimate(batch.model, self._machine.quantities, self._period)
        self._rows = [self._now]
        self._state = self._estimate.state(self._now)

        def replaced(inner: BatchIntegrator) -> BatchIntegrator:
            self._outputs = inner.compute_outputs
            return _MachineIntegrator(inner, self.exchange)

        batch.replace_integrator(replaced)

    def exchange(self, torques: Array | None) -> Array | None:
        """Send torques (n,), N m, wait for the end of the control period and return the state (2 d,); None for a fault.

        At the reset there are no torques, and the state is that of the first readings.
        """
        if torques is None:
            return self._state
        readings = None if self.fault else self._next_readings(torques)
        self._rows.append(self._no_readings if readings is None else readings)
        if self.fault:
            return None
        if readings is not None:
            self._now, self._state = self._now | readings, self._estimate.state(self._now | readings)
        return self._state

    def _next_readings(self, torques: Array) -> dict[str, Array] | None:
        """Send torques, wait until the deadline, and return the newest readings; None without new readings."""
        if not self._lateness:  # the deadlines follow the packets of the machine, which then have arrived
            self._machine.read()
            self._new_readings()
            receipt = getattr(self._machine, "receipt", None)
            self._timing.begin(receipt)
            self._tested = _Tested(receipt)
            self._deadline = self._clock.now() + self._phase
            self._clock.wait(self._deadline)
        self._machine.write(torques / self._scale)
        self._delays.append(self._clock.now() - self._deadline)
        self._commands.append(torques)
        self._prepare()
        self._test_readings()  # of the last deadline; the arm moves meanwhile
        if self.fault:
            return None
        self._deadline += self._period
        self._clock.wait(self._deadline)
        self._lateness.append(self._clock.now() - self._deadline)
        given = self._machine.read()
        if given is None and len(self._lateness) <= START_READINGS:
            given = self._late_readings()
        self._silent = self._silent + 1 if given is None else 0
        receipt = getattr(self._machine, "receipt", None)
        self.fault = self.fault or self._timing.check(receipt, given is not None, self._clock.now())
        if given is None:
            if self._silent >= self._silence:
                self.fault = self.fault or f"no new readings for {self._silence} control periods"
            return None
        readings = {name: np.array(values, dtype=float) for name, values in given.items()}
        for name, values in readings.items():
            beyond = ~(np.abs(values) <= self._bounds[name])
            if beyond.any():
                self.fault = self.fault or f"reading {name}[{int(np.argmax(beyond))}] is {values[beyond][0]:.4g}"
        self._tested.add(readings, receipt, len(self._commands))
        return readings

    def _test_readings(self) -> None:
        """Test the values of the readings of the last deadline, if there were new ones."""
        if (readings := self._tested.readings) is None:
            return
        begin = time.perf_counter()
        for torques in self._tested.periods(self._commands):
            self._innovations.advance(torques)
        self._tested.readings = None
        self._doubt = self._innovations.check(readings)
        self.fault = self.fault or self._doubt
        self._test_times.append(time.perf_counter() - begin)

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

    def _wait_for_rest(self) -> dict[str, float | None]:
        """Return the result of `RestWait` for the stop that was ordered now; None for each without true readings."""
        if self._doubt:
            return dict.fromkeys(REST)
        speeds = RestSpeeds(self._plant.model, np.array(self._plant.torque_limit))
        first = np.array([self._speeds(each) for each in self._first])
        wait = RestWait(speeds, (noise_level(first[:, 0]), noise_level(first[1:, 1])), self._silence)
        return wait(self._machine, self._clock, self._speeds)

    def _speeds(self, readings: Mapping[str, Any]) -> tuple[float, float]:
        """Return the largest rate of a motor, rad/s, and the speed of the tip, m/s; nan for those not measured."""
        given = {name: np.array(values, dtype=float) for name, values in readings.items()}
        rate = float(np.abs(given["motor_rates"]).max()) if "motor_rates" in given else np.nan
        if not self._estimate.complete:
            return rate, np.nan
        state = self._estimate.state(given)
        rows, outputs = np.zeros((1, len(state) + 2)), np.zeros((1, layout.OUTPUTS))
        rows[0, : len(state)] = state
        self._outputs(np.zeros(1, dtype=np.int64), rows, outputs)
        return rate, float(np.linalg.norm(outputs[0, layout.TIP_VELOCITY]))

    def _log(self, episode: Episode, rest: dict[str, float | None]) -> Episode:
        """Return the episode with all readings of the machine, the torques that it measured, and statistics."""
        names = [name for name in self._machine.quantities if name != "state"]
        raw = {name: np.array([row[name] for row in self._rows]) for name in names}
        torques = raw.get("torques", np.full((1, 1), np.nan))[-len(episode.torques) :]
        late, delays = np.array(self._lateness or [np.nan]), np.array(self._delays or [np.nan])
        receiver = getattr(self._machine, "receiver", None)
        statistics = {
            "periods": len(self._lateness), "lateness": [float(np.median(late)), float(late.max())],
            "delay": float(np.median(delays)), "missed": float(np.mean(delays > self._period - self._phase)),
            "silent": int(np.isnan(raw["motor_angles"]).all(axis=1).sum()),
            "test": float(np.median(self._test_times or [np.nan])),
            "received": asdict(receiver.counts) if receiver else {}, **rest,
        }  # fmt: skip
        about = {"units": episode.about["units"] | {name: UNITS[name] for name in raw}, "machine": statistics}
        return replace(
            episode, torques=np.where(np.isfinite(torques), torques, episode.torques), readings=episode.readings | raw,
            about=episode.about | about | {"failure": self.fault or episode.about["failure"]},
        )  # fmt: skip


class _Tested:
    """Readings whose values are to be tested, and the control periods of the machine between them.

    Args:
        receipt: transport of the readings of the braked arm; None for a machine that does not tell it.

    Attributes:
        readings: readings to be tested; None without new ones.
    """

    def __init__(self, receipt: Receipt | None) -> None:
        self.readings: Mapping[str, Array] | None = None
        self._last, self._elapsed, self._effective, self._period = receipt, 0, 0, 0

    def add(self, readings: Mapping[str, Array], receipt: Receipt | None, commands: int) -> None:
        """Add the readings of a deadline, after a number of commands."""
        if receipt is None or self._last is None:
            elapsed, self._effective = commands - self._period, commands
        else:
            elapsed, self._effective = receipt.number - self._last.number, commands - receipt.behind
        self._last, self._period = receipt, commands
        self._elapsed = min(elapsed, self._effective)
        self.readings = readings if self._effective > 0 else None

    def periods(self, commands: list[Array]) -> list[Array]:
        """Return the torques (n,), N m, of each control period until the readings, by the commands (n,) so far."""
        if self.readings is None:
            return []
        first = self._effective - self._elapsed
        return commands[max(first, 0) : self._effective]


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

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array, foundation: Array | None = None) -> None:
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
