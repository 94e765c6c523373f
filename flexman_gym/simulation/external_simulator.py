"""External simulators: arms of a batch integrated by another simulation, with states in the coordinates of the batch.

Sensors and controllers read states, outputs and parameters of the model of the batch. The two simulations exchange
configurations, called shapes: joint and motor angles, and for each link the translations (m) and rotation vectors (rad)
of sections at given positions along the link, in its beam frame. Shapes are projected onto the coordinates of the model
by least squares, weighted by the mass at the sections and, at the tip, by the rigid inertia outboard of the link.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.kernels import layout
from flexman_gym.model.beam import build_beam
from flexman_gym.model.element import NODE_COORDINATES, Element
from flexman_gym.model.model import Model, build_model
from flexman_gym.model.outboard_inertia import outboard_inertias
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import BatchIntegrator
from flexman_gym.simulation.physical_parameters import LINK, PARAMETERS

Stations = Sequence[Array]  # m; positions (s_i,) of the sections along link i, the last at its tip
ROTATION_WEIGHT = 1e-4  # weight of rotations: squared radius of gyration relative to the squared section spacing


class ArmShapes(NamedTuple):
    """Configurations (shapes) of r arms with n joints and s sections, and their rates.

    Attributes:
        shapes: (r, 2 n + 6 s) joint angles, motor angles (rad), and translation (m) and rotation vector (rad) of each
            section, link by link.
        rates: (r, 2 n + 6 s) time derivatives of the shapes.
        tips: (r, 6) position (m) and velocity (m/s) of the tip in the base frame.
    """

    shapes: Array
    rates: Array
    tips: Array


class ExternalSimulator(Protocol):
    """Simulator that integrates the arms of a batch in place of its own integrator."""

    @property
    def stations(self) -> Stations:
        """Positions along the links of the sections of a shape, m."""

    def start(self, arm: int, shape: Array, rate: Array, parameters: Mapping[str, Array]) -> None:
        """Start an arm from a shape (2 n + 6 s,) and its rate; `parameters` are values by their name in PARAMETERS."""

    def integrate(self, drives: Array, moving: BoolArray) -> BoolArray:
        """Integrate the flagged arms over a control period; return flags (b,) of success.

        Rows of `drives` (b, n + 6) are n motor torques (N m), tip force (3, N) and base acceleration (3, m/s^2).
        """

    def read(self, arms: IntArray) -> ArmShapes:
        """Return the configurations of the arms with the indices (r,)."""


class ExternalIntegrator(BatchIntegrator):
    """Batch integrator that delegates the integration to an external simulator; see `Batch.replace_integrator`.

    The previous batch integrator still holds the constants of the arms and computes outputs and tip accelerations.
    """

    state_fields = ()

    def __init__(self, model: Model, integrator: BatchIntegrator, simulator: ExternalSimulator) -> None:
        self._model, self._integrator, self._simulator = model, integrator, simulator
        self._to_shapes, self._to_coordinates = _shape_matrices(model, simulator.stations)

    def set_constants(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants of some arms; the external simulator uses them from the next start of these arms on."""
        self._integrator.set_constants(arms, constants)

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm."""
        return self._integrator.constants(arm)

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array, foundation: Array | None = None) -> None:
        """Start some arms in the external simulator from their rows, and compute their outputs."""
        d = self._model.n_dof
        for arm in arms.tolist():
            own = _parameters_from_constants(self._model, self._integrator.constants(arm))
            shape, rate = (rows[arm, part] @ self._to_shapes for part in (slice(d), slice(d, 2 * d)))
            self._simulator.start(arm, shape, rate, own)
        self._read(arms, rows, outputs)

    def forget(self, arms: IntArray) -> None:
        """Do nothing: data of the external simulator are reset by `compute_outputs`."""

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        moving = status == layout.OK
        ok = self._simulator.integrate(drives, moving)
        status[moving & ~ok] = layout.DIVERGED
        self._read(np.flatnonzero(moving & ok), rows, outputs)

    def _read(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Project the shapes of some arms onto the coordinates of the model, and compute their outputs."""
        d, now = self._model.n_dof, self._simulator.read(arms)
        rows[arms, :d], rows[arms, d : 2 * d] = now.shapes @ self._to_coordinates, now.rates @ self._to_coordinates
        self._integrator.compute_outputs(arms, rows, outputs)
        correction = now.tips - outputs[arms, : layout.DEFLECTION_COLUMN]  # the projected tip is only an approximation
        outputs[arms, : layout.DEFLECTION_COLUMN] += correction
        outputs[arms, layout.DEFLECTION_COLUMN : layout.KINETIC] += correction

    def compute_tip_accelerations(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms, by the model of the batch."""
        self._integrator.compute_tip_accelerations(drives, rows, result)


class RefinedSimulator:
    """External simulator with `elements` finite elements in each section of a link, foreshortening, and shorter steps.

    `step_divisor` is the ratio of the step of the batch to the step of the external simulator.
    """

    def __init__(self, batch: Batch, elements: int, step_divisor: int) -> None:
        choice, steps = batch.model.choice, step_divisor * batch.substeps
        switches = {"spinning_rotors": choice.spinning_rotors, "rotary_inertia": choice.rotary_inertia}
        model = build_model(batch.model.arm, elements, stiffening=True, **switches)
        period = batch.control_period
        self._batch = Batch(model, batch.method, period / steps, period, arms=len(batch.rows))
        self.stations: Stations = [
            np.array([each.start + each.length for each in model.elements(i)]) for i in range(model.n_joints)
        ]
        self._to_shapes, self._to_coordinates = _shape_matrices(model, self.stations)

    def start(self, arm: int, shape: Array, rate: Array, parameters: Mapping[str, Array]) -> None:
        """Start an arm from a shape."""
        one = np.array([arm])
        self._batch.vary(one, **{name: np.asarray(values)[None] for name, values in parameters.items()})
        self._batch.reset(one, np.concatenate([shape @ self._to_coordinates, rate @ self._to_coordinates])[None])

    def integrate(self, drives: Array, moving: BoolArray) -> BoolArray:
        """Integrate the flagged arms over a control period."""
        self._batch.step(drives, moving)
        return self._batch.status == layout.OK

    def read(self, arms: IntArray) -> ArmShapes:
        """Return the configurations of some arms."""
        positions, speeds = np.split(self._batch.state[arms], 2, axis=1)
        return ArmShapes(
            positions @ self._to_shapes, speeds @ self._to_shapes, self._batch.outputs[arms, : layout.DEFLECTION_COLUMN]
        )


def _shape_matrices(model: Model, stations: Stations) -> tuple[Array, Array]:
    """Return matrices (d, p) and (p, d): row vectors of coordinates times the first are shapes, and vice versa."""
    n, d = model.n_joints, model.n_dof
    to_shapes = np.zeros((d, 2 * n + NODE_COORDINATES * sum(map(len, stations))))
    to_coordinates = np.zeros(to_shapes.T.shape)
    to_shapes[np.arange(n), np.arange(n)] = to_shapes[model.motor_columns, np.arange(n, 2 * n)] = 1.0
    to_coordinates[np.arange(n), np.arange(n)] = 1.0
    to_coordinates[np.arange(n, 2 * n), model.motor_columns] = 1.0  # in a rigid joint the column of the joint angle
    to_coordinates[np.flatnonzero(model.constants.motor < 0)] = 0.0
    beams = tuple(build_beam(link, 1, flexible=False) for link in model.arm.links)
    first = 2 * n
    for i, (positions, outboard) in enumerate(zip(stations, outboard_inertias(model.arm, beams), strict=True)):
        columns, rows = model.elastic_columns(i), slice(first, first + NODE_COORDINATES * len(positions))
        first = rows.stop
        if model.bases[i].shape[1]:
            shapes = _station_shapes(model, i, positions)
            to_shapes[columns, rows] = shapes.T
            mass = model.arm.links[i].mass
            to_coordinates[rows, columns] = _least_squares_matrix(shapes, positions, outboard, mass).T
    return to_shapes, to_coordinates


def _station_shapes(model: Model, link: int, positions: Array) -> Array:
    """Return translations and rotations (6 s, k) of sections at positions (s,), m, per unit elastic coordinate."""
    elements, nodes, result = model.elements(link), model.node_basis(link), []
    for position in positions:
        element, xi = Element.find(elements, position)
        slopes, twist = element.slopes(xi), np.zeros(2 * NODE_COORDINATES)
        twist[[3, 3 + NODE_COORDINATES]] = 1.0 - xi, xi
        rows = np.vstack([element.shapes(xi), twist, -slopes[1], slopes[0]])
        result.append(rows @ nodes[element.nodes])
    return np.vstack(result)


def _least_squares_matrix(shapes: Array, positions: Array, outboard: Array, mass: float) -> Array:
    """Return the matrix (k, 6 s) from displacements of sections to elastic coordinates of a link, by least squares.

    `shapes` (6 s, k) are displacements per unit elastic coordinate of the sections at positions (s,), m; `outboard` (6,
    6) is the rigid inertia (kg, kg m, kg m^2) outboard of the link about its tip, linear part first, `mass` is the mass
    of the link, kg.
    """
    masses = np.repeat(mass / len(positions), len(positions))
    masses[-1] /= 2.0  # trapezoidal rule; the root is fixed
    gyration = ROTATION_WEIGHT * (positions[-1] / len(positions)) ** 2
    weights = np.diag(np.repeat(masses, NODE_COORDINATES) * np.tile([1.0] * 3 + [gyration] * 3, len(positions)))
    weights[-NODE_COORDINATES:, -NODE_COORDINATES:] += outboard
    weighted = shapes.T @ weights
    return np.asarray(np.linalg.lstsq(weighted @ shapes, weighted, rcond=1e-12)[0])


def _parameters_from_constants(model: Model, constants: Mapping[str, Any]) -> dict[str, Array]:
    """Return the physical parameters, by name, that correspond to the constants PER_ARM of an arm."""
    nominal = model.constants
    changed = replace(model, constants=nominal._replace(**constants))
    result = {name: np.array(row.nominal(changed)) for name, row in PARAMETERS.items() if row.of != LINK}
    first = nominal.square_start[:-1]
    flexible = np.diff(nominal.elastic_start) > 0
    factors = np.ones(model.n_joints)
    factors[flexible] = constants["stiffness"][first[flexible]] / nominal.stiffness[first[flexible]]
    return result | {"link_stiffness_factor": factors}
