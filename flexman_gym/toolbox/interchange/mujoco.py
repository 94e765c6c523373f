"""MuJoCo as external simulator: arms as chains of rigid pieces, see `mjcf` and `simulation.external_simulator`."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco  # type: ignore[import-not-found, import-untyped, unused-ignore]
import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model
from flexman_gym.simulation.external_simulator import ArmShapes, Stations
from flexman_gym.simulation.physical_parameters import varied_arm
from flexman_gym.toolbox.interchange.mjcf import rigid_pieces, to_mjcf

PIECES_PER_SECTION = 3  # rigid pieces; errors of the natural frequencies 1 to 6 of the catalog's arms are below 3 %
DIFFERENCE_STEP = 1e-5  # s; half the interval of central differences for velocities


class _LinkBodies(NamedTuple):
    """Bodies and hinges, in MuJoCo's model, of a link with m + 1 rigid pieces.

    Attributes:
        root: index of the body of the first piece, at the joint; the bodies of the other pieces follow.
        rotation: (3, 3) rotation from the beam frame to the frame of this body.
        angles: (m, 3) indices of the hinge angles between a piece and the previous one.
        offsets: (m,) distances from the hinges of a piece to the end of its segment of the link, m.
        stations: (m,) positions of these ends along the link, m.
    """

    root: int
    rotation: Array
    angles: IntArray
    offsets: Array
    stations: Array


class MuJoCoSimulator:
    """External simulator with a MuJoCo model for each arm.

    Shapes are computed from positions and rotations of MuJoCo's bodies, without approximations for small angles.
    `period` is the control period, s. A ValueError is raised for an arm with Coulomb friction.
    """

    def __init__(self, model: Model, period: float, arms: int) -> None:
        if any(joint.coulomb_friction for joint in model.arm.joints):
            raise value_error("plant", "mujoco", "arms without Coulomb friction: MuJoCo models it differently")
        self._arm, self._period = model.arm, period
        self._models: list[Any] = [mujoco.MjModel.from_xml_string(to_mjcf(model.arm, PIECES_PER_SECTION))] * arms
        self._datas = [mujoco.MjData(each) for each in self._models]
        one, numbers = self._models[0], np.arange(model.n_joints)
        self._motors: IntArray = np.array([one.joint(f"motor {i}").qposadr[0] for i in numbers])
        self._springs = self._motors + np.array(
            [joint.stiffness is not None and not joint.passive for joint in model.arm.joints]
        )
        self._links = [_link_bodies(one, i, link) for i, link in enumerate(model.arm.links)]
        self.stations: Stations = [link.stations for link in self._links]
        mujoco.set_mju_user_warning(lambda message: None)  # else MuJoCo writes a log file at each divergence

    def start(self, arm: int, shape: Array, rate: Array, parameters: Mapping[str, Array]) -> None:
        """Start an arm from a shape and its rate."""
        model = mujoco.MjModel.from_xml_string(to_mjcf(varied_arm(self._arm, parameters), PIECES_PER_SECTION))
        self._models[arm], data = model, mujoco.MjData(model)
        self._datas[arm] = data
        model.opt.timestep = self._period / np.ceil(self._period / model.opt.timestep)
        n = len(self._motors)
        for values, result in ((shape, data.qpos), (rate, data.qvel)):
            result[self._springs] = values[:n]  # in a rigid joint the coordinate of the motor
            flexible = self._springs != self._motors
            result[self._motors[flexible]] = values[n : 2 * n][flexible]
            result[self._springs[flexible]] -= values[n : 2 * n][flexible]
            first = 2 * n
            for link in self._links:
                turns = values[first : first + 6 * len(link.stations)].reshape(-1, 6)[:, 3:]
                result[link.angles] = np.diff(turns, axis=0, prepend=0.0)
                first += 6 * len(link.stations)

    def integrate(self, drives: Array, moving: BoolArray) -> BoolArray:
        """Integrate the flagged arms over a control period; return flags of success."""
        n, ok = len(self._motors), np.ones(len(moving), dtype=bool)
        for arm in np.flatnonzero(moving).tolist():
            model, data = self._models[arm], self._datas[arm]
            data.qfrc_applied[self._motors] = drives[arm, :n]
            model.opt.gravity[:] = np.array(self._arm.gravity) - drives[arm, n + 3 :]
            force = data.xfrc_applied[-1, :3] = drives[arm, n : n + 3]
            data.xfrc_applied[-1, 3:] = np.cross(data.site_xpos[0] - data.xipos[-1], force)
            mujoco.mj_step(model, data, round(self._period / model.opt.timestep))
            failed = data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all()
            ok[arm] = not failed
        return ok

    def read(self, arms: IntArray) -> ArmShapes:
        """Return the configurations of some arms, with rates by central differences."""
        result = []
        for arm in arms.tolist():
            model, data = self._models[arm], self._datas[arm]
            positions, speeds = data.qpos.copy(), data.qvel.copy()
            read = []
            for offset in (-DIFFERENCE_STEP, DIFFERENCE_STEP, 0.0):
                data.qpos[:] = positions + offset * speeds
                mujoco.mj_kinematics(model, data)
                read.append(np.concatenate([self._shape(data), data.site_xpos[0]]))
            shape, rate = read[2], (read[1] - read[0]) / (2.0 * DIFFERENCE_STEP)
            result.append([shape[:-3], rate[:-3], np.concatenate([shape[-3:], rate[-3:]])])
        columns = zip(*result, strict=True) if result else ([], [], [])
        width = 2 * len(self._motors) + 6 * sum(map(len, self.stations))
        return ArmShapes(
            *(np.reshape(list(each), (-1, size)) for each, size in zip(columns, (width, width, 6), strict=True))
        )

    def _shape(self, data: Any) -> Array:
        """Return the shape of an arm, see `ArmShapes`."""
        motors = data.qpos[self._motors]
        springs = np.where(self._springs != self._motors, data.qpos[self._springs], 0.0)
        parts = [motors + springs, motors]
        for link in self._links:
            bodies = slice(link.root + 1, link.root + 1 + len(link.stations))
            frame = data.xmat[link.root].reshape(3, 3) @ link.rotation
            turned = data.xmat[bodies].reshape(-1, 3, 3)
            ends = data.xpos[bodies] + turned[:, :, 0] * link.offsets[:, None] - data.xpos[link.root]
            moved = ends @ frame
            moved[:, 0] -= link.stations
            parts.append(np.hstack([moved, _rotation_vectors(frame.T @ turned)]).ravel())
        return np.concatenate(parts)


def _link_bodies(model: Any, number: int, link: Any) -> _LinkBodies:
    """Return the bodies and hinges of the link with index `number` in MuJoCo's model; a rigid link has no hinges."""
    body, orientation = model.body(f"link_{number}").id, np.array(link.orientation)
    if not link.flexible:
        return _LinkBodies(body, orientation, np.zeros((0, 3), dtype=np.int64), np.zeros(0), np.zeros(0))
    cut = rigid_pieces(link, PIECES_PER_SECTION)
    starts = np.array([piece.start for piece in cut[1:]])
    ends = np.concatenate(
        [np.arange(1, PIECES_PER_SECTION + 1) * section.length / PIECES_PER_SECTION for section in link.sections]
    )
    lengths = np.repeat(np.cumsum([0.0, *(section.length for section in link.sections[:-1])]), PIECES_PER_SECTION)
    stations = ends + lengths
    name = f"link_{number}"
    angles = [[model.joint(f"{name}_{j}_{letter}").qposadr[0] for letter in "xyz"] for j in range(len(starts))]
    return _LinkBodies(body, orientation, np.array(angles), stations - starts, stations)


def _rotation_vectors(rotations: Array) -> Array:
    """Return the rotation vectors (k, 3), rad, of rotation matrices (k, 3, 3) with angles below pi / 2."""
    vectors = np.stack([rotations[:, 2, 1] - rotations[:, 1, 2], rotations[:, 0, 2] - rotations[:, 2, 0],
                        rotations[:, 1, 0] - rotations[:, 0, 1]], axis=1) / 2.0  # fmt: skip
    sines = np.minimum(np.linalg.norm(vectors, axis=1), 1.0)
    factors = np.divide(np.arcsin(sines), sines, out=np.ones_like(sines), where=sines > 0.0)
    return np.asarray(vectors * factors[:, None])
