"""Setup: what an environment is made of, checked, with the model that its fidelity asks for."""

from dataclasses import dataclass, field, fields
from typing import Any

from flexman_gym.checks import one_of, positive, refusal, store
from flexman_gym.envs.randomisation import Randomisation
from flexman_gym.envs.sensors.full import Limits
from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.fidelity.choose import Choice, assembled_modes, choose_model
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.catalog import paper_rrr
from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import SineTorque
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.simulation.families import Method
from flexman_gym.simulation.trajectory import ENERGY_ALARM

CHOSEN = ("elements", "modes", "method", "step")  # by fidelity="auto"
SLEW = 3.0  # s, of the motion for which fidelity="auto" chooses


@dataclass(frozen=True, eq=False)
class Setup:
    """What an environment is made of; the keyword arguments of `gym.make` and `gym.make_vec`.

    Attributes:
        arm: None takes the arm of FlexRRR-v0.
        task: None takes `Slew()`.
        limits: None takes `Limits()`.
        torque_limit: N m, of each motor.
        control_period: s.
        fidelity: "default" or "auto"; the latter with a tolerance, and without the next four.
        tolerance: m, largest error of the tip in a slew.
        elements, modes, method, step: see `build_model` and `Simulator`; "assembled" modes are those that `FlexManEnv`
            describes.
        energy_alarm: part of the energy turned over (the largest of kinetic + elastic energy, work and dissipation).
        randomisation: a Randomisation, or a dict of its attributes; None for none.
        model: made from the above.
        choice: of fidelity="auto", else None.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    arm: Arm = None  # type: ignore[assignment]
    task: Slew = None  # type: ignore[assignment]
    limits: Limits = None  # type: ignore[assignment]
    torque_limit: float = 400.0
    control_period: float = 0.02
    fidelity: str = "default"
    tolerance: float | None = None
    elements: int | tuple[int, ...] = 2
    modes: int | tuple[int | tuple[int, ...], ...] | str | None = "assembled"
    method: str | Method = "ros2"
    step: float = 0.005
    energy_alarm: float = ENERGY_ALARM
    randomisation: Randomisation | None = None
    model: Model = field(init=False)
    choice: Choice | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        parts: tuple[tuple[str, type, str, Any], ...] = (
            ("arm", Arm, "an Arm", default_arm),
            ("task", Slew, "a task, such as Slew()", Slew),
            ("limits", Limits, "Limits", Limits),
        )
        for name, kind, allowed, default in parts:
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise refusal(name, value, allowed)
            store(self, **{name: default() if value is None else value})
        store(self, randomisation=_randomisation(self.randomisation))
        store(self, torque_limit=positive("torque_limit", self.torque_limit, "N m"))
        store(self, energy_alarm=positive("energy_alarm", self.energy_alarm))
        store(self, control_period=positive("control_period", self.control_period, "s"))
        if self._automatic():
            choice = self._chosen()
            store(self, choice=choice, model=choice.model, method=choice.method, step=choice.step)
        else:
            nyquist = 0.5 / self.control_period
            modes = assembled_modes(self.arm, self.elements, nyquist) if isinstance(self.modes, str) else self.modes
            store(self, model=build_model(self.arm, self.elements, modes))

    def _automatic(self) -> bool:
        """Whether the fidelity is to be chosen; refuses what contradicts that."""
        if one_of("fidelity", self.fidelity, ("default", "auto")) == "default":
            if self.tolerance is not None:
                raise refusal("tolerance", self.tolerance, 'None without fidelity="auto"')
            if isinstance(self.modes, str):
                one_of("modes", self.modes, ("assembled",))
            return False
        for each in fields(self):
            if each.name in CHOSEN and getattr(self, each.name) != each.default:
                raise refusal(each.name, getattr(self, each.name), 'nothing: fidelity="auto" chooses it')
        positive("tolerance", self.tolerance, 'm, for fidelity="auto"')
        return True

    def _chosen(self) -> Choice:
        """Fidelity for a slew of the task: sine torques of the limit from a posture in the middle of its range."""
        n = self.arm.n_joints
        start = [0.5 * self.task.start * (-1.0) ** i for i in range(n)]
        steps = max(1, round(SLEW / self.control_period))
        scene = Scene(
            self.arm,
            ModelChoice(flexible_links=True, elements=2),
            SineTorque([self.torque_limit] * n, [0.5] * n, [0.0] * n),
            Initial(start, [0.0] * n),
            duration=steps * self.control_period,
            output_step=self.control_period,
        )
        tolerance = positive("tolerance", self.tolerance, "m")
        return choose_model(scene, tolerance, longest_step=self.control_period)


def _randomisation(value: object) -> Randomisation | None:
    if isinstance(value, dict):
        names = [each.name for each in fields(Randomisation)]
        return Randomisation(**{one_of("randomisation", name, names): ranges for name, ranges in value.items()})
    if value is not None and not isinstance(value, Randomisation):
        raise refusal("randomisation", value, "a Randomisation, or a dict of its attributes")
    return value


def default_arm() -> Arm:
    """The arm of FlexRRR-v0."""
    return paper_rrr(rotor_inertia=10.0, modal_damping_ratio=0.005)
