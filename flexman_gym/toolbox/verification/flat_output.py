"""Rest-to-rest motion of a flexible link on an elastic joint by the flat output of its linear model.

The coordinates are the angle of the rotor and the amplitudes of the modes with the rotor held. The flat output y is
the output without zeros: torque = J (1 + D^2 / w_1^2) (1 + D^2 / w_2^2) ... y'', with D = d/dt, the total inertia J,
and the frequencies w_i with a free rotor. All coordinates are sums of y and its derivatives, so that a motion of y
between rests is one of the whole model (De Luca and Di Giovanni, IEEE/ASME AIM 2001, 923).
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial import Polynomial

from flexman_gym.common.arrays import Array
from flexman_gym.model.dynamics import mass_matrix, stiffness_matrix
from flexman_gym.model.element import NODE_COORDINATES
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import natural_modes


class HeldModes(NamedTuple):
    """Linear model of a link on an elastic joint, in the modes of its plane with the rotor held.

    Attributes:
        inertia: inertia of rotor and link about the joint axis, kg m^2.
        squares: (k,) squared frequencies with the rotor held, rad^2/s^2.
        couplings: (k,) entries of the mass matrix between the angle of the rotor and the modes, kg^(1/2) m.
        tip: (k,) angle of the tip about the joint axis of each mode, rad; metres divided by the length of the link.
    """

    inertia: float
    squares: Array
    couplings: Array
    tip: Array

    @classmethod
    def of_model(cls, model: Model, count: int) -> Self:
        """Return the first modes in the plane of rotation of an arm with one flexible link on one elastic joint."""
        columns = np.arange(model.n_dof)[model.elastic_columns(0)].reshape(-1, NODE_COORDINATES)
        plane = np.append(0, columns[:, [1, 5]])  # joint angle, deflections and rotations
        motor = model.motor_columns[0]
        whole = mass_matrix(model, np.zeros(2 * model.n_dof))
        mass, stiffness = (each[np.ix_(plane, plane)] for each in (whole, stiffness_matrix(model)))
        squares, shapes = natural_modes(mass, stiffness)
        rigid, tip = np.eye(len(plane))[0], np.eye(len(plane))[0]
        tip[-2] = 1.0 / model.constants.length[0]
        inertia = mass[0, 0] + whole[motor, motor]
        shapes = shapes[:, :count]
        return cls(float(inertia), squares[:count], shapes.T @ mass @ rigid, shapes.T @ tip)

    @property
    def free_modes(self) -> tuple[Array, Array]:
        """Squared frequencies (k + 1,), the first 0, with a free rotor, and shapes (k + 1, k + 1), rotor first."""
        mass = np.eye(len(self.squares) + 1)
        mass[0, 0] = self.inertia
        mass[0, 1:] = mass[1:, 0] = self.couplings
        squares, shapes = natural_modes(mass, np.diag(np.append(0.0, self.squares)))
        squares[0] = 0.0
        return squares, shapes

    def torque(self, times: Array, angle: float, duration: float) -> Array:
        """Return the torques (t,) on the rotor, N m, of a motion of the flat output from rest to rest.

        Args:
            times: (t,) times, s; the torque is 0 before 0 and after the duration.
            angle: change of the flat output, rad.
            duration: duration of the motion, s.
        """
        squares, _ = self.free_modes
        operator = np.poly(-squares[1:]) / np.prod(squares[1:])  # in powers of D^2, the highest first
        path = self._path(angle, duration)
        terms = [each * path.deriv(2 * power + 2) for power, each in enumerate(operator[::-1])]
        moving = (times >= 0.0) & (times <= duration)
        return np.where(moving, self.inertia * sum(term(times / duration) / duration ** (2 * power + 2)
                                                   for power, term in enumerate(terms)), 0.0)  # fmt: skip

    def deviation(self, times: Array, angle: float, duration: float) -> Array:
        """Return the differences (t,) between the angle of the tip and the flat output, rad; arguments as `torque`."""
        squares, shapes = self.free_modes
        path, seen = self._path(angle, duration), np.append(1.0, self.tip) @ shapes
        result = -path(times / duration)
        for i, (rotor, tip) in enumerate(zip(shapes[0], seen, strict=True)):
            others = np.delete(squares, i)
            operator = self.inertia * rotor * tip / np.prod(squares[1:]) * np.poly(-others)
            for power, each in enumerate(operator[::-1]):
                result = result + each * path.deriv(2 * power)(times / duration) / duration ** (2 * power)
        return np.asarray(result)

    def _path(self, angle: float, duration: float) -> Polynomial:
        """Return the polynomial over [0, 1] whose derivatives up to order 2 k + 1 vanish at both ends."""
        order = 2 * len(self.squares) + 1  # 7 for three modes: degree 15
        bell = Polynomial([0.0, 1.0, -1.0]) ** order
        path = bell.integ()
        return angle * path / path(1.0)
