"""Strain: bending, twist and stretch of a link at a place along it."""

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import finite, refusal, vector, whole_number
from flexman_gym.model.element import NODE_COORDINATES, find_element
from flexman_gym.model.model import Model, checked_model


def curvature(model: Model, state: Vector, link: int, position: float) -> Array:
    """Gives twist rate phi', curvature about y, -w'', and about z, v'', of a link, (3,) rad/m, in its beam frame.

    They are derivatives of the finite elements, linear along each element and exact under forces and moments at nodes.
    A rigid link has none.

    Args:
        model: the model.
        state: (2 d,).
        link: counted from 0.
        position: along the link, from 0 at its joint to its length at its tip, m. At a node between two elements, and
            so between two sections, the outboard element is taken.

    Raises:
        ValueError: for wrong shapes, values that are not finite, and a link or position that does not exist.
    """
    return _deformation(model, state, link, position)[1:]


def strain(model: Model, state: Vector, link: int, position: float, y: float = 0.0, z: float = 0.0) -> float:
    """Gives the axial strain u' - y v'' - z w'' at a point of a link's section, as a strain gauge there measures it.

    Foreshortening is no strain: the centreline keeps its length.

    Args:
        model: as in `curvature`.
        state: as in `curvature`.
        link: as in `curvature`.
        position: as in `curvature`.
        y: place in the section along y, m.
        z: place in the section along z, m.

    Raises:
        ValueError: as in `curvature`.
    """
    stretch, _, about_y, about_z = _deformation(model, state, link, position)
    return float(stretch - finite("y", y, "m") * about_z + finite("z", z, "m") * about_y)


def gauge_radii(model: Model) -> Array:
    """Gives how far from the axis the gauges at the root of each link are, (n, 3) m, along y, along z and around.

    They are radii of gyration of the section there: sqrt(I_z / A), sqrt(I_y / A) and sqrt((I_y + I_z) / A).

    Args:
        model: the model.
    """
    roots = [link.sections[0] for link in model.arm.links]
    along = np.array([[root.second_moment_z / root.area, root.second_moment_y / root.area] for root in roots])
    return np.sqrt(np.column_stack([along, along.sum(axis=1)]))


def root_gauges(model: Model) -> Array:
    """Gives what strain gauges at the roots of all links read, (2 d, 3 n) per unit of a state.

    Three numbers of each link, at distances r of `gauge_radii`: half the difference of the axial strains at y = +-r,
    then at z = +-r, as a bridge of two gauges on opposite sides gives it; then the shear strain r phi' of the torsion.
    Rigid links read zero.

    Args:
        model: the model.
    """
    result = np.zeros((2 * model.n_dof, 3 * model.n_joints))
    for i, radii in enumerate(gauge_radii(model)):
        basis = model.bases[i]
        if basis.shape[1] == 0:
            continue
        root = model.elements(i)[0]
        nodes = np.vstack([np.zeros((NODE_COORDINATES, basis.shape[1])), basis])[root.nodes]
        _, twist, about_y, about_z = element_strains(0.0, root.length) @ nodes
        rows = radii[:, None] * np.array([-about_z, about_y, twist])
        result[model.elastic_columns(i), 3 * i : 3 * i + 3] = rows.T
    return result


def _deformation(model: Model, state: Vector, link: int, position: float) -> Array:
    """Gives u', phi', -w'' and v'' (4,) at a position of a link."""
    x = np.array(vector("state", state, 2 * checked_model(model).n_dof))
    i = whole_number("link", link, 0, model.n_joints - 1)
    length, basis = model.arm.links[i].length, model.bases[i]
    place = finite("position", position, "m")
    if not 0.0 <= place <= length:
        raise refusal("position", position, f"a number from 0 to {length} (m), the length of link {i}")
    if basis.shape[1] == 0:
        return np.zeros(4)
    nodes = np.append(np.zeros(NODE_COORDINATES), basis @ x[model.elastic_columns(i)])
    element, xi = find_element(model.elements(i), place)
    return element_strains(xi, element.length) @ nodes[element.nodes]


def element_strains(xi: float, length: float) -> Array:
    """Gives u', phi', theta_y' = -w'' and theta_z' = v'' (4, 12) of an element per unit of its node coordinates."""
    u, v, w, phi, theta_y, theta_z = range(NODE_COORDINATES)
    rows = np.zeros((4, 2, NODE_COORDINATES))
    rows[0, :, u] = rows[1, :, phi] = np.array([-1.0, 1.0]) / length
    deflection = np.array([12 * xi - 6, 6 - 12 * xi]) / length**2
    slope = np.array([6 * xi - 4, 6 * xi - 2]) / length
    rows[3, :, v], rows[3, :, theta_z] = deflection, slope
    rows[2, :, w], rows[2, :, theta_y] = -deflection, slope  # theta_y = -w'
    return rows.reshape(4, -1)
