"""Strain: how far a link is bent, twisted and stretched at a place along it."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import finite, refusal, vector, whole_number
from flexman_gym.model.element import NODE_COORDINATES, find_element
from flexman_gym.model.model import Model


def curvature(model: Model, state: Sequence[float] | Array, link: int, position: float) -> Array:
    """(3,) twist rate phi', curvature about y, -w'', and about z, v'', of a link, rad/m, in its beam frame.

    Args:
        model: the model.
        state: (2 d,).
        link: counted from 0.
        position: along the link, 0 at its joint to its length at its tip, m.

    They are the derivatives of the finite elements, linear along each element and exact under forces and moments at
    nodes; at a node between two elements, so between two sections, that of the outboard one is taken. A rigid link has
    none.

    Raises ValueError for wrong shapes, values that are not finite, and a link or position that is not there.
    """
    return _deformation(model, state, link, position)[1:]


def strain(
    model: Model, state: Sequence[float] | Array, link: int, position: float, y: float = 0.0, z: float = 0.0
) -> float:
    """Axial strain u' - y v'' - z w'' at the point y, z (m) of a link's section: what a strain gauge there measures.

    Arguments and errors as in `curvature`. Foreshortening is no strain: the centreline keeps its length.
    """
    stretch, _, about_y, about_z = _deformation(model, state, link, position)
    return float(stretch - finite("y", y, "m") * about_z + finite("z", z, "m") * about_y)


def _deformation(model: Model, state: Sequence[float] | Array, link: int, position: float) -> Array:
    """(4,) u', phi', -w'', v'' at a position of a link."""
    x = np.array(vector("state", state, 2 * model.n_dof))
    i = whole_number("link", link, 0, model.n_joints - 1)
    length, basis = model.arm.links[i].length, model.bases[i]
    place = finite("position", position, "m")
    if not 0.0 <= place <= length:
        raise refusal("position", position, f"a number from 0 to {length} (m), the length of link {i}")
    if basis.shape[1] == 0:
        return np.zeros(4)
    nodes = np.append(np.zeros(NODE_COORDINATES), basis @ x[model.elastic_columns(i)])
    element, xi = find_element(model.elements(i), place)
    return _derivatives(xi, element.length) @ nodes[element.nodes]


def _derivatives(xi: float, length: float) -> Array:
    """(4, 12) u', phi', theta_y' = -w'' and theta_z' = v'' per unit of the node coordinates of one element."""
    u, v, w, phi, theta_y, theta_z = range(NODE_COORDINATES)
    rows = np.zeros((4, 2, NODE_COORDINATES))
    rows[0, :, u] = rows[1, :, phi] = np.array([-1.0, 1.0]) / length
    deflection = np.array([12 * xi - 6, 6 - 12 * xi]) / length**2
    slope = np.array([6 * xi - 4, 6 * xi - 2]) / length
    rows[3, :, v], rows[3, :, theta_z] = deflection, slope
    rows[2, :, w], rows[2, :, theta_y] = -deflection, slope  # theta_y = -w'
    return rows.reshape(4, -1)
