"""Replica: other simulations move the arms of a batch, which is read as if nothing had happened."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.external_simulator import ArmShapes, ExternalIntegrator, RefinedSimulator

PERIOD, ARMS = 0.02, 3
ARM = NAMED_ENVIRONMENTS["FlexRRR-v0"].arm
FULL = fm.build_model(ARM, 2, stiffening=True)
USUAL = fm.build_model(ARM, 2, (4, 4, 5))
OWN = {
    "payload_mass": np.array([4.0, 0.0, 11.0]), "joint_stiffness": np.full((ARMS, 3), 4e3),
    "link_stiffness_factor": np.array([[0.8, 1.1, 1.3], [1.0, 1.0, 1.0], [1.2, 0.7, 0.9]]),
}  # fmt: skip


def batch(model, parts=6):
    """Arms that are not alike, bent and moving."""
    result, arms = Batch(model, "midpoint_3", PERIOD / parts, PERIOD, arms=ARMS), np.arange(ARMS)
    result.vary(arms, **OWN)
    random = np.random.default_rng(3)
    start = np.zeros((ARMS, 2 * model.n_dof))
    start[:, : model.n_joints] = start[:, model.motor_columns] = random.uniform(-0.5, 0.5, (ARMS, model.n_joints))
    start[:, model.n_dof + model.motor_columns] = random.uniform(-0.2, 0.2, (ARMS, model.n_joints))
    return result, start


def drives(model, period):
    """Torques that change, a force on the tip and a base that is accelerated."""
    random = np.random.default_rng(period)
    return random.uniform(-1.0, 1.0, (ARMS, model.n_joints + 6)) * [*[200.0] * model.n_joints, *[5.0] * 3, *[0.5] * 3]


def played(model, double=None, periods=10):
    """Rows, and outputs, of a batch after each period, moved by itself or by a double."""
    result, start = batch(model)
    if double is not None:
        other = double(result)
        result.replace_integrator(lambda mover: ExternalIntegrator(model, mover, other))
    result.reset(np.arange(ARMS), start)
    trail = [(result.state.copy(), result.outputs.copy())]
    for period in range(periods):
        result.step(drives(model, period))
        trail.append((result.state.copy(), result.outputs.copy()))
    assert (result.status == layout.OK).all()
    return [np.array(each) for each in zip(*trail, strict=True)]


class Recorder:
    """External simulator that keeps what each arm is started from, and returns given shapes."""

    def __init__(self, stations, shapes):
        self.stations, self.shapes, self.started = stations, shapes, {}

    def start(self, arm, shape, rate, parameters):
        self.started[arm] = shape, rate, parameters

    def read(self, arms):
        return ArmShapes(self.shapes[arms], 0.0 * self.shapes[arms], np.zeros((len(arms), layout.DEFLECTION_COLUMN)))


def started(model, stations, states, shapes=None, parameters=None):
    """Return the arguments of the start of each arm, and the states that are read from its shapes."""
    count = len(states)
    arms, size = np.arange(count), 2 * model.n_joints + 6 * sum(map(len, stations))
    recorder = Recorder(stations, np.zeros((count, size)) if shapes is None else shapes)
    result = Batch(model, "midpoint_3", PERIOD / 6, PERIOD, arms=count)
    if parameters:
        result.vary(arms, **parameters)
    result.replace_integrator(lambda mover: ExternalIntegrator(model, mover, recorder))
    result.reset(arms, states)
    return [recorder.started[arm] for arm in range(count)], result.state[:, : model.n_dof]


def shape_matrices(model, stations):
    """Return the matrices from coordinates to shapes and from shapes to coordinates, of unit rows."""
    d, size = model.n_dof, 2 * model.n_joints + 6 * sum(map(len, stations))
    into = np.array([shape for shape, _, _ in started(model, stations, np.eye(d, 2 * d))[0]])
    return into, started(model, stations, np.zeros((size, 2 * d)), np.eye(size))[1]


@pytest.mark.parametrize("model", [FULL, USUAL, fm.build_model(fm.catalog.paper_rrr(), 1, flexible_joints=False)])
def test_coordinates_come_back_from_their_shapes(model):
    stations = [np.linspace(0.0, link.length, 6)[1:] for link in model.arm.links]
    into, back = shape_matrices(model, stations)
    assert np.allclose(into @ back, np.eye(model.n_dof), rtol=0.0, atol=1e-9)


def test_shapes_say_where_tips_are():
    """Of each link, as its tip's translation and rotation; stations are in order."""
    stations = [np.array([0.4 * link.length, link.length]) for link in ARM.links]
    into, _ = shape_matrices(USUAL, stations)
    state = np.random.default_rng(0).normal(size=USUAL.n_dof)
    shape = (state @ into)[6:].reshape(3, 2, 6)
    for i in range(3):
        rows = slice(*USUAL.constants.elastic_start[i : i + 2])
        own = state[USUAL.elastic_columns(i)]
        both = np.concatenate(
            [own @ each[rows] for each in (USUAL.constants.tip_translation, USUAL.constants.tip_rotation)]
        )
        assert np.allclose(shape[i, 1], both, rtol=1e-12)


def test_modes_that_a_model_lacks_are_left_out():
    """Loaded modes are orthogonal where all that a link carries has its weight; both models scale them alike."""
    few, many = fm.build_model(ARM, 2, 4), fm.build_model(ARM, 2, 8)
    stations = [np.linspace(0.0, link.length, 13)[1:] for link in ARM.links]
    into, back = shape_matrices(many, stations)[0], shape_matrices(few, stations)[1]
    for i in range(3):
        left = into[many.elastic_columns(i)][4:] @ back[:, few.elastic_columns(i)]
        assert np.abs(left).max() < 0.12, i


def test_parameters_are_those_that_were_given():
    stations = [np.array([link.length]) for link in ARM.links]
    given, _ = started(USUAL, stations, np.zeros((ARMS, 2 * USUAL.n_dof)), parameters=OWN)
    for arm, (_, _, found) in enumerate(given):
        assert all(np.allclose(found[name], values[arm], rtol=1e-12) for name, values in OWN.items())
        assert found["rotor_inertia"].tolist() == [10.0] * 3


def test_a_double_of_the_same_model_changes_nothing():
    ours, theirs = played(FULL), played(FULL, lambda one: RefinedSimulator(one, 2, 1))
    for one, other in zip(ours, theirs, strict=True):
        assert np.allclose(one, other, rtol=1e-7, atol=1e-8)


def test_a_finer_model_moves_nearly_so():
    """What little there is of a difference is that of the models."""
    ours, theirs = played(USUAL), played(USUAL, lambda one: RefinedSimulator(one, 3, 4))
    tips = np.linalg.norm(ours[1][..., layout.TIP] - theirs[1][..., layout.TIP], axis=-1)
    moved = np.linalg.norm(ours[1][-1, :, layout.TIP] - ours[1][0, :, layout.TIP], axis=-1)
    assert 1e-6 < tips.max() < 0.01 * moved.max()


@pytest.mark.feature
def test_mujoco_moves_nearly_so():
    """Forces on the tip, an accelerated base and parameters of the arms included."""
    pytest.importorskip("mujoco", minversion="4")
    from flexman_gym.toolbox.interchange.mujoco import MuJoCoSimulator

    theirs = played(USUAL, lambda one: MuJoCoSimulator(one.model, one.control_period, ARMS), 6)
    ours = played(USUAL, lambda one: RefinedSimulator(one, 3, 4), 6)
    tips = np.linalg.norm(ours[1][..., layout.TIP] - theirs[1][..., layout.TIP], axis=-1)
    moved = np.linalg.norm(ours[1][-1, :, layout.TIP] - ours[1][0, :, layout.TIP], axis=-1)
    assert tips.max() < 0.02 * moved.min()
    for columns, least in (
        (USUAL.motor_columns, 0.01),
        (np.arange(3), 0.01),
        (USUAL.n_dof + USUAL.motor_columns, 0.02),
    ):
        ends = ours[0][-1, :, columns], theirs[0][-1, :, columns]
        assert np.abs(ends[0] - ends[1]).max() < least * np.abs(ends[0]).max(), columns


@pytest.mark.feature
def test_mujoco_starts_where_it_is_put():
    """Bent and moving: what is read is what was put, but for small angles, which turn one after the other there."""
    pytest.importorskip("mujoco", minversion="4")
    from flexman_gym.toolbox.interchange.mujoco import MuJoCoSimulator

    double = MuJoCoSimulator(USUAL, PERIOD, 1)
    state = 1e-4 * np.random.default_rng(1).normal(size=2 * USUAL.n_dof)
    ((shape, rate, parameters),), _ = started(USUAL, double.stations, state[None])
    double.start(0, shape, rate, parameters)
    now = double.read(np.array([0]))
    turned = [np.r_[:6], *(6 + 18 * i + 6 * j + np.arange(3, 6) for i in range(3) for j in range(3))]
    places = np.concatenate(turned)
    assert np.allclose(now.shapes[0, places], shape[places], rtol=0.0, atol=2e-3 * np.abs(shape).max())
    assert np.allclose(now.rates[0, places], rate[places], rtol=0.0, atol=2e-3 * np.abs(rate).max())


@pytest.mark.feature
def test_what_diverges_in_mujoco_is_a_status():
    pytest.importorskip("mujoco", minversion="4")
    from flexman_gym.toolbox.interchange.mujoco import MuJoCoSimulator

    result, start = batch(USUAL)
    result.replace_integrator(lambda mover: ExternalIntegrator(USUAL, mover, MuJoCoSimulator(USUAL, PERIOD, ARMS)))
    result.reset(np.arange(ARMS), start)
    drive = drives(USUAL, 0)
    drive[1, 0] = 1e14
    result.step(drive)
    assert result.status.tolist() == [layout.OK, layout.DIVERGED, layout.OK] and np.isfinite(result.rows).all()
