"""Robust control of the arm of Gu, Petkov and Konstantinov (2005): bounds, random plants and a simulated move."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import flexman_gym as fm
from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.common.arrays import Array
from flexman_gym.kernels.layout import TIP
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.model.state_space import LinearModel
from flexman_gym.model.statics import rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.hinf import (
    GeneralisedPlant,
    HInfinity,
    Synthesis,
    centred_model,
    linear_parameters,
)
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel

PERIOD = 0.002  # s
TORQUE_LIMIT = 5.0  # N m; not printed in the book; the move needs 1 N m
RANGES = {"motor_angles": 0.5, "motor_rates": 5.0, "root_strains": 1e-3}  # rad, rad/s, dimensionless
RELATIVE_NOISE = 1e-4  # fraction of the range; standard deviation of the noise
UNKNOWN = {"payload_mass": (0.15, 0.35), "viscous_friction_factor": (0.8, 1.2)}  # kg, factor; printed in the book
SENSORS = ("motor_encoders", "strain")
LOSS = 2.0  # dimensionless; allowed loss of performance, see `GeneralisedPlant.synthesise`
PLANTS, MOVED = 1000, 30  # numbers of random plants of the linear analysis and of simulated moves
GAINS = 358.0, 28.5  # N m/rad, N m s/rad; PD controller of the book
ANGLE, DURATION, HORIZON = np.pi / 12.0, 1.0, 3.0  # rad, s, s; move of the book, and simulated time
BAND = 0.02  # fraction of the move; settled within this band about the goal
GAIN_RATIO = 1.02  # relative accuracy of the bound of the worst gain


@dataclass(frozen=True)
class RobustRow:
    """Result of one controller.

    Attributes:
        controller: "ranges ignored", "channels", "scaled channels" or "PD of the book".
        norm: least H-infinity norm without channels.
        share: share of the channels in the design.
        robustness: upper bound of the structured singular value, of robust stability.
        bound: upper bound of the gain from disturbances to performance outputs for all values in the ranges.
        largest: largest of the peak gains of the random plants.
        nominal: peak gain at the centres of the ranges.
        stable: share of the random plants with a stable loop.
        settling: longest settling time of the tip in the simulated moves, s.
        remaining: largest deviation of the tip half a second after the end of the move, mm.
    """

    controller: str
    norm: float | None
    share: float | None
    robustness: float | None
    bound: float | None
    largest: float | None
    nominal: float | None
    stable: float | None
    settling: float
    remaining: float


def gu_plant(elements: int = 2) -> Plant:
    """Return the plant of the study."""

    def measured() -> dict[str, Array]:
        sizes = LinearMeasurements(model).measure(np.eye(2 * model.n_dof))
        unit = np.array([1.0, RELATIVE_NOISE, 0.0, 0.0])[:, None]
        return {name: np.tile(value * unit, sizes[name].shape[1]) for name, value in RANGES.items()}

    model = fm.build_model(fm.catalog.gu_2005(), elements)
    return Plant(model, (TORQUE_LIMIT,), PERIOD, dict, UNKNOWN, measured=measured)


def random_values(plant: Plant, seed: int) -> Array:
    """Return the uncertain parameters (p,) of a random plant, uniform in their ranges."""
    low, high = linear_parameters(plant).ranges.T
    return np.random.default_rng(seed).uniform(low, high)


def exact_plant(plant: Plant, theta: Array) -> GeneralisedPlant:
    """Return the generalised plant for given parameters (p,), sampled without approximation, with all excited modes."""
    known = plant._replace(model=linear_parameters(plant).varied_model(plant.model, theta), unknown={})
    return GeneralisedPlant.linearised(known, MeasurementModel(known, SENSORS), np.zeros(1), np.inf)


def peak_gain(plant: GeneralisedPlant, loop: LinearModel) -> float:
    """Return the peak gain from disturbances to performance outputs; infinite for an unstable loop."""
    closed, n = plant.closed_loop(loop), plant.motors
    if np.abs(np.linalg.eigvals(closed.A)).max() >= 1.0:
        return np.inf
    gains = closed.frequency_response(plant.grid(loop))[:, n:, n:]
    return float(np.linalg.norm(gains, 2, axis=(1, 2)).max())


def worst_gain(plant: GeneralisedPlant, loop: LinearModel) -> float:
    """Return an upper bound of the gain for all values in the ranges, by bisection; infinite without robust stability.

    The bound is the least gain for which the structured singular value with the performance block is below 1.
    """
    if plant.robustness(loop).max() >= 1.0:
        return np.inf
    low, high = 1e-3, 1e-3
    while plant.robustness(loop, high).max() >= 1.0:
        low, high = high, 4.0 * high
    while high / low > GAIN_RATIO:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if plant.robustness(loop, middle).max() < 1.0 else (middle, high)
    return high


def book_move(plant: Plant, count: int) -> Array:
    """Return the motor angles (T + 1, 1) of the move of the book, rad, one per control period."""
    times = np.minimum(np.arange(count + 1) * plant.period, DURATION)[:, None]
    result: Array = ANGLE * times / DURATION - np.sin(2.0 * np.pi * times / DURATION) / 24.0
    return result


class _Designed(HInfinity):
    """H-infinity controller with a given design."""

    def __init__(self, plant: Plant, design: Synthesis) -> None:
        super().__init__(plant, SENSORS)
        self._design = design

    def design(self, goal: Array) -> Synthesis:
        """Return the given design."""
        return self._design


def simulate_move(plant: Plant, design: Synthesis | None, count: int) -> tuple[float, float]:
    """Simulate the move of the book for random plants; return settling time (s) and remaining deviation (mm).

    Args:
        plant: plant of the study.
        design: controller; None for the PD of the book.
        count: number of plants.
    """
    periods = round(HORIZON / plant.period)
    path = book_move(plant, periods)
    batch = Batch(plant.model, step=plant.period, control_period=plant.period, arms=count)
    drawn = np.array([random_values(plant, seed) for seed in range(count)])
    arms = np.arange(count)
    batch.vary(arms, **linear_parameters(plant).values(plant.model, drawn))
    batch.reset(arms, np.tile(rest_state(plant.model, np.zeros(1)), (count, 1)))
    paths, controller = np.tile(path, (count, 1, 1)), None if design is None else _Designed(plant, design)
    if controller:
        controller.reset(arms, EpisodeInfo(paths[:, 0], paths[:, 0], plant.period, lambda: paths), count)
    instruments, noise = MeasurementModel(plant, SENSORS), np.random.default_rng(0)
    motor, tips, drive = plant.model.motor_columns[0], [], np.zeros((count, 7))
    rate = np.gradient(path[:, 0], plant.period)
    for period in range(periods):
        state = batch.state
        if controller is None:
            wanted = GAINS[0] * (path[period, 0] - state[:, motor])
            wanted += GAINS[1] * (rate[period] - state[:, plant.model.n_dof + motor])
            drive[:, 0] = np.clip(wanted, -TORQUE_LIMIT, TORQUE_LIMIT)
        else:
            read = state @ instruments.matrix.T
            read += instruments.deviations * noise.standard_normal(read.shape)
            readings = {name: read[:, place] for name, place in instruments.places.items()}
            drive[:, :1] = TORQUE_LIMIT * controller.act(readings, drive[:, :1], np.ones(count, dtype=bool))
        batch.step(drive)
        tips.append(np.arctan2(batch.outputs[:, TIP.start + 1], batch.outputs[:, TIP.start]))
    return _settling(np.abs(np.array(tips) - ANGLE), plant)


def _settling(deviations: Array, plant: Plant) -> tuple[float, float]:
    """Return settling time (s) and remaining deviation (mm) of tip angles (T, b) rad about the goal."""
    outside = np.flatnonzero((deviations > BAND * ANGLE).any(axis=1))
    reach = float(plant.model.constants.length.sum())
    late = deviations[round((DURATION + 0.5) / plant.period) :]
    return float(outside[-1] + 2) * plant.period if len(outside) else 0.0, float(1e3 * reach * late.max())


def designs(plant: Plant) -> Iterator[tuple[str, Synthesis]]:
    """Yield the controllers: designed without, with, and with scaled channels of the parameters."""
    centre = plant._replace(model=centred_model(plant), unknown={})
    for name, each, scaled in (("ranges ignored", centre, True), ("channels", plant, False),
                               ("scaled channels", plant, True)):  # fmt: skip
        sampled = GeneralisedPlant.linearised(each, MeasurementModel(each, SENSORS), np.zeros(1))
        yield name, sampled.synthesise(LOSS, scaled)


def rows(plants: int = PLANTS, moved: int = MOVED) -> Iterator[RobustRow]:
    """Yield the rows of the study."""
    plant = gu_plant()
    full = GeneralisedPlant.linearised(plant, MeasurementModel(plant, SENSORS), np.zeros(1), np.inf)
    exact = [exact_plant(plant, random_values(plant, seed)) for seed in range(plants)]
    for name, design in designs(plant):
        peaks = np.array([peak_gain(each, design.loop) for each in exact])
        nominal = peak_gain(exact_plant(plant, linear_parameters(plant).mean), design.loop)
        yield RobustRow(
            name, design.norm, design.share, float(full.robustness(design.loop).max()), worst_gain(full, design.loop),
            float(peaks.max()), nominal, float(np.isfinite(peaks).mean()),
            *simulate_move(plant, design, moved),
        )  # fmt: skip
    yield RobustRow("PD of the book", *(None,) * 7, *simulate_move(plant, None, moved))
