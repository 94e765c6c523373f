"""Stability cases: the models and motions of the maps, and the grids of what they vary."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Payload
from flexman_gym.scene.drive import ConstantTorque, Signal
from flexman_gym.scene.scene import Initial, Scene

SPRINGS, MODES, PAYLOAD, SPIN, SPIN_STIFFENED = (
    "joint stiffness", "modes", "payload", "spin", "spin with stiffening",
)  # fmt: skip
PERIOD = 0.02  # s, the longest step; the others are halves of it, halves of those and so on
FULL_MODES = 12  # of a link with two elements


@dataclass(frozen=True, eq=False)
class Case:
    """One column of a map: a model and the motion that every method has to follow.

    Attributes:
        study, parameter: as in Row.
        model: what moves.
        truth: what the tip should do: the same model, or a better one.
        scene: the motion, with an output every 0.02 s.
        varied: values (n,) of physical parameters that make the first case of the study this one; None where its model
            is another one.
    """

    study: str
    parameter: float
    model: Model
    truth: Model
    scene: Scene
    varied: dict[str, Array] | None = None


def motion(model: Model, start: Array, torque: Sequence[float], periods: int, held: bool = False) -> Scene:
    """The scene of a model that moves from a state (2 d,) on for some periods, all joints held at their rates or none.

    It has an output after each period.
    """
    prescribed = [Signal()] * model.n_joints if held else None
    rest = [0.0] * model.n_joints
    initial = Initial(rest, rest, start.tolist())
    drive = ConstantTorque(torque)
    return Scene(model.arm, model.choice, drive, initial, periods * PERIOD, PERIOD, prescribed=prescribed)


def spring_case(stiffness: float) -> Case:
    """The paper's arm from rest under 400 N m a joint, on joint springs of a stiffness (N m/rad)."""
    model = build_model(catalog.paper_rrr(joint_stiffness=stiffness), 2, 4)
    return _paper_case(SPRINGS, stiffness, model, {"joint_stiffness": np.full(3, stiffness)})


def mode_case(modes: float) -> Case:
    """The same with a number of loaded modes kept of a link; 12 is the full model of two elements."""
    kept = None if modes == FULL_MODES else int(modes)
    return _paper_case(MODES, modes, build_model(catalog.paper_rrr(), 2, kept))


def payload_case(mass: float) -> Case:
    """The same with a payload (kg), which its modes carry."""
    payload = Payload(mass) if mass > 0.0 else None
    return _paper_case(PAYLOAD, mass, build_model(catalog.paper_rrr(payload=payload), 2, 4))


def _paper_case(study: str, parameter: float, model: Model, varied: dict[str, Array] | None = None) -> Case:
    scene = motion(model, model.initial_state(np.zeros(3)), (400.0, 400.0, 400.0), 10)
    return Case(study, parameter, model, model, scene, varied)


def spin_case(rate: float, stiffening: bool) -> Case:
    """One link at a constant rate (rad/s), bent by 1 cm in its plane of rotation; true is the model with stiffening."""
    models = [build_model(catalog.one_link(), 2, 4, stiffening=switch) for switch in (False, True)]
    start = models[0].initial_state([0.0], [rate])
    sideways = models[0].constants.tip_translation[:, 1]
    # of the loaded modes, which ascend in frequency, the first that moves the tip in the plane of rotation
    first = int(np.argmax(np.abs(sideways) > 0.1 * np.abs(sideways).max()))
    start[models[0].elastic_columns(0)][first] = 0.01 / sideways[first]
    study = SPIN_STIFFENED if stiffening else SPIN
    return Case(study, rate, models[stiffening], models[1], motion(models[0], start, (0.0,), 50, True), {})


CASES: dict[str, Callable[[float], Case]] = {
    SPRINGS: spring_case,
    MODES: mode_case,
    PAYLOAD: payload_case,
    SPIN: partial(spin_case, stiffening=False),
    SPIN_STIFFENED: partial(spin_case, stiffening=True),
}
SPIN_RATES = (0.0, 5.0, 10.0, 13.0, 15.0, 20.0, 30.0, 60.0)
PARAMETERS: dict[str, Sequence[float]] = {
    SPRINGS: tuple(10.0 ** (0.5 * i) for i in range(4, 15)),
    MODES: (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 12.0),
    PAYLOAD: (0.0, 1.0, 5.0, 10.0, 20.0, 50.0),
    SPIN: SPIN_RATES,
    SPIN_STIFFENED: SPIN_RATES,
}
HALVINGS = {SPRINGS: range(10), MODES: range(10), PAYLOAD: range(10), SPIN: range(8), SPIN_STIFFENED: range(8)}
QUICK_PARAMETERS: dict[str, Sequence[float]] = {
    SPRINGS: (1e3, 1e6), MODES: (2.0, 4.0), PAYLOAD: (10.0,), SPIN: (10.0, 20.0), SPIN_STIFFENED: (10.0, 20.0),
}  # fmt: skip
QUICK_HALVINGS = range(0, 7, 3)


def parameters_of(study: str, quick: bool = False) -> Sequence[float]:
    """What a study varies, or a few values of it."""
    return (QUICK_PARAMETERS if quick else PARAMETERS)[study]


def steps_of(study: str, quick: bool = False) -> list[float]:
    """The steps (s) of a study's map, or a few of them."""
    return [PERIOD / 2**halving for halving in (QUICK_HALVINGS if quick else HALVINGS[study])]
