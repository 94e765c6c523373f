"""External simulators: arms of a batch integrated by a second model, with states in the coordinates of the first."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.kernels import layout
from flexman_gym.model.beam import build_beam
from flexman_gym.model.component_modes import outboard_inertias
from flexman_gym.model.element import NODE_COORDINATES, beam_shapes, beam_slopes, find_element
from flexman_gym.model.model import Model, build_model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import BatchIntegrator
from flexman_gym.simulation.parameters import parameters_from_constants

Stations = Sequence[Array]  # places (s_i,) along each link, m, the last at its tip
ROTATION_WEIGHT = 1e-4  # m^2, of the length of a station squared, as radius of gyration where rotations are weighted


class ArmShapes(NamedTuple):
    """Where r arms are.

    Attributes:
        shapes, rates: (r, 2 n + 6 s) angles of joints and motors, and the stations of each link, and how fast they
            change.
        tips: (r, 6) place and velocity of the tip in the base frame, m and m/s.
    """

    shapes: Array
    rates: Array
    tips: Array


class ExternalSimulator(Protocol):
    """Simulator that integrates the arms of a batch in another way."""

    @property
    def stations(self) -> Stations:
        """Places along the links at which its shapes are given, m."""

    def start(self, arm: int, shape: Array, rate: Array, parameters: Mapping[str, Array]) -> None:
        """Start an arm with these physical parameters, by their name in PARAMETERS, at a shape."""

    def move(self, drives: Array, moving: BoolArray) -> BoolArray:
        """Integrate the flagged arms over a control period under drives (b, n + 6); return flags of success."""

    def read(self, arms: IntArray) -> ArmShapes:
        """Return the shapes of some arms."""


class ExternalIntegrator(BatchIntegrator):
    """Batch integrator that has an external simulator integrate the arms; see `Batch.replace_integrator`.

    The integrator that it replaces keeps the constants of the arms and computes outputs and tip accelerations.
    """

    state_fields = ()

    def __init__(self, model: Model, integrator: BatchIntegrator, double: ExternalSimulator) -> None:
        self._model, self._integrator, self._double = model, integrator, double
        self.into, self.back = shape_matrices(model, double.stations)

    def vary(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants of some arms; the external simulator uses them from their next start on."""
        self._integrator.vary(arms, constants)

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm."""
        return self._integrator.constants(arm)

    def observe(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Start the external simulator at the rows of some arms, and compute their outputs."""
        d = self._model.n_dof
        for arm in arms.tolist():
            own = parameters_from_constants(self._model, self._integrator.constants(arm))
            shape, rate = (rows[arm, part] @ self.into for part in (slice(d), slice(d, 2 * d)))
            self._double.start(arm, shape, rate, own)
        self._read(arms, rows, outputs)

    def forget(self, arms: IntArray) -> None:
        """Do nothing: an external simulator starts from the state that it is given."""

    def move(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        moving = status == layout.OK
        well = self._double.move(drives, moving)
        status[moving & ~well] = layout.DIVERGED
        self._read(np.flatnonzero(moving & well), rows, outputs)

    def _read(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        d, now = self._model.n_dof, self._double.read(arms)
        rows[arms, :d], rows[arms, d : 2 * d] = now.shapes @ self.back, now.rates @ self.back
        self._integrator.observe(arms, rows, outputs)
        tips = now.tips - outputs[arms, : layout.DEFLECTION_COLUMN]  # the model's tip is no more than near the true one
        outputs[arms, : layout.DEFLECTION_COLUMN] += tips
        outputs[arms, layout.DEFLECTION_COLUMN : layout.KINETIC] += tips

    def sense(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms with the model of the batch in this state."""
        self._integrator.sense(drives, rows, result)


class RefinedSimulator:
    """External simulator with all coordinates of finer elements, foreshortening, and shorter steps than the batch."""

    def __init__(self, batch: Batch, elements: int, parts: int) -> None:
        choice, steps = batch.model.choice, parts * batch.substeps
        switches = {"spinning_rotors": choice.spinning_rotors, "rotary_inertia": choice.rotary_inertia}
        model = build_model(batch.model.arm, elements, stiffening=True, **switches)
        period = batch.control_period
        self._batch = Batch(model, batch.method, period / steps, period, arms=len(batch.rows))
        self.stations: Stations = [
            np.array([each.start + each.length for each in model.elements(i)]) for i in range(model.n_joints)
        ]
        self._into, self._back = shape_matrices(model, self.stations)

    def start(self, arm: int, shape: Array, rate: Array, parameters: Mapping[str, Array]) -> None:
        """Start an arm at a shape."""
        one = np.array([arm])
        self._batch.vary(one, **{name: np.asarray(values)[None] for name, values in parameters.items()})
        self._batch.reset(one, np.concatenate([shape @ self._back, rate @ self._back])[None])

    def move(self, drives: Array, moving: BoolArray) -> BoolArray:
        """Integrate the flagged arms over a control period."""
        self._batch.step(drives, moving)
        return self._batch.status == layout.OK

    def read(self, arms: IntArray) -> ArmShapes:
        """Return the shapes of some arms."""
        places, speeds = np.split(self._batch.state[arms], 2, axis=1)
        return ArmShapes(
            places @ self._into, speeds @ self._into, self._batch.outputs[arms, : layout.DEFLECTION_COLUMN]
        )


def shape_matrices(model: Model, stations: Stations) -> tuple[Array, Array]:
    """Gives what turns coordinates of a model into shapes, (d, p), and what turns shapes into coordinates, (p, d)."""
    n, d = model.n_joints, model.n_dof
    into = np.zeros((d, 2 * n + NODE_COORDINATES * sum(map(len, stations))))
    back = np.zeros(into.T.shape)
    into[np.arange(n), np.arange(n)] = into[model.motor_columns, np.arange(n, 2 * n)] = 1.0
    back[np.arange(n), np.arange(n)] = 1.0
    back[np.arange(n, 2 * n), model.motor_columns] = 1.0  # of a rigid joint it is the joint angle again
    back[np.flatnonzero(model.constants.motor < 0)] = 0.0
    beams = tuple(build_beam(link, 1, flexible=False) for link in model.arm.links)
    first = 2 * n
    for i, (places, carried) in enumerate(zip(stations, outboard_inertias(model.arm, beams), strict=True)):
        columns, rows = model.elastic_columns(i), slice(first, first + NODE_COORDINATES * len(places))
        first = rows.stop
        if model.bases[i].shape[1]:
            shapes = _station_shapes(model, i, places)
            into[columns, rows] = shapes.T
            back[rows, columns] = _least_squares_matrix(shapes, places, carried, model.arm.links[i].mass).T
    return into, back


def _station_shapes(model: Model, link: int, places: Array) -> Array:
    """Translations and rotations (6 s, k) of the sections of a link at places per unit of its coordinates."""
    elements, basis = model.elements(link), model.bases[link]
    nodes = np.vstack([np.zeros((NODE_COORDINATES, basis.shape[1])), basis])
    result = []
    for place in places:
        element, xi = find_element(elements, place)
        slopes, twist = beam_slopes(xi, element.length), np.zeros(2 * NODE_COORDINATES)
        twist[[3, 3 + NODE_COORDINATES]] = 1.0 - xi, xi
        rows = np.vstack([beam_shapes(xi, element.length, 0.0, 0.0), twist, -slopes[1], slopes[0]])
        result.append(rows @ nodes[element.nodes])
    return np.vstack(result)


def _least_squares_matrix(shapes: Array, places: Array, carried: Array, mass: float) -> Array:
    """The coordinates (k, 6 s) of a link that come nearest to what its stations do."""
    shares = np.repeat(mass / len(places), len(places))
    shares[-1] /= 2.0  # the trapezoidal rule; the root does not move
    gyration = ROTATION_WEIGHT * (places[-1] / len(places)) ** 2
    weights = np.diag(np.repeat(shares, NODE_COORDINATES) * np.tile([1.0] * 3 + [gyration] * 3, len(places)))
    weights[-NODE_COORDINATES:, -NODE_COORDINATES:] += carried
    weighted = shapes.T @ weights
    return np.asarray(np.linalg.lstsq(weighted @ shapes, weighted, rcond=1e-12)[0])
