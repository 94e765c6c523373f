"""Verification cases in motion: reference trajectories, conservation laws, spin-up; and the list of all cases."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import scene_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.signals import ConstantTorque, Signal
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory
from flexman_gym.toolbox.verification.cases import CLOSED_FORMS
from flexman_gym.toolbox.verification.table import VerificationRow
from studies.verification.arms import CASES, IDENTITY

INDEPENDENT = "independent automatic-differentiation code"
KANE = "two independent codes; case of Kane, Ryan and Banerjee (1987)"
REFERENCES = ("paper_rr", "pendulum_1", "paper_fr", "paper_ff", "gravity_payload_ff", "spin_up_stiffened")
QUICK_REFERENCES = REFERENCES[:2]


def _motion_rows(reference: Path, quick: bool = False) -> Iterator[VerificationRow]:
    """Yield the rows of motions; `reference` is the folder of the reference scenes and solutions."""
    for name in QUICK_REFERENCES if quick else REFERENCES:
        yield from _trajectory_rows(reference, name)
    yield from _spin_up_rows()
    if not quick:
        yield from _momentum_rows(reference)
        yield from _effect_rows()
        yield from _large_rotation_rows(reference)


def _trajectory_rows(reference: Path, name: str) -> Iterator[VerificationRow]:
    """Yield the errors of a reference scene with the reference method, and its energy balance."""
    scene, expected = Scene.load(reference / f"{name}.json"), _solution(reference, name)
    result = _motion(reference, name)
    largest = np.abs(expected[:, -1]).max()
    energy = np.abs(result.energy - expected[: len(result.time), -1]).max() / largest
    residual = np.abs(result.energy_residual).max() / largest
    yield VerificationRow(
        f"{name}, largest distance of the tip, m", INDEPENDENT, 0.0, _farthest(result, expected), 1e-6
    )
    yield VerificationRow(
        f"{name}, largest relative error of energy", INDEPENDENT, 0.0, _whole(result, scene, energy), 1e-6
    )
    yield VerificationRow(
        f"{name}, work - dissipation - energy, relative", IDENTITY, 0.0, _whole(result, scene, residual), 1e-6
    )


def _momentum_rows(reference: Path) -> Iterator[VerificationRow]:
    """Yield the error of the angular momentum of the paper's flexible arm about the vertical axis, 400 t.

    The momentum of the links is conjugate to the first joint angle. The first rotor is added; the others do not
    contribute.
    """
    scene = Scene.load(reference / "paper_ff.json")
    result, model = _motion(reference, "paper_ff"), scene_model(scene)
    d, motor, rotor = model.n_dof, model.motor_columns[0], scene.arm.joints[0].rotor_inertia
    gaps = []
    for time, state in zip(result.time[::20], result.states[::20], strict=True):
        momentum = mass_matrix(model, state)[0] @ state[d:] + rotor * state[d + motor]
        gaps.append(abs(momentum - 400.0 * time) / (400.0 * scene.duration))
    worst = _whole(result, scene, max(gaps))
    yield VerificationRow("paper FF, angular momentum - 400 t, largest, of that at the end", IDENTITY, 0.0, worst, 1e-6)


def _large_rotation_rows(reference: Path) -> Iterator[VerificationRow]:
    """Yield the distance of the flexible arm from a large-rotation solution, with and without foreshortening."""
    expected = _solution(reference, "paper_ff_large_rotation")
    source = "independent large-rotation code"
    for name, stiffening, limits in (("with", True, (2e-3, 6e-3)), ("without", False, (None, None))):
        result = _motion(reference, "paper_ff", stiffening)
        for end, limit in zip((1.0, 2.0), limits, strict=True):
            worst = _farthest(result, expected, int((expected[:, 0] < end + 1e-6).sum()))
            yield VerificationRow(f"paper FF {name} foreshortening, tip within {end:g} s, m", source, 0.0, worst, limit)


def _spin_up_scene(stiffening: bool) -> Scene:
    """Return a 10 m beam accelerated to 6 rad/s within 15 s, at the rate 6 (t/15 - sin(2 pi t/15)/(2 pi))."""
    link = Link(10.0, 4e-4, 2e-7, 2e-7, 4e-7, youngs_modulus=7e10, shear_modulus=2.7e10, density=3000.0)
    return Scene(
        Arm([link], [Joint((0.0, 0.0, 1.0))]),
        ModelChoice(True, elements=4, stiffening=stiffening),
        ConstantTorque([0.0]),
        Initial([0.0], [0.0]),
        duration=20.0,
        output_step=0.01,
        prescribed=[Signal(0.4, 0.4, 1.0 / 15.0, -np.pi / 2.0, stop=15.0)],
    )


def _spin_up_rows() -> Iterator[VerificationRow]:
    """Yield lag and stretch of the tip in the rotating frame, and the divergence without foreshortening."""
    result = simulate(_spin_up_scene(stiffening=True), method="ros2", step=0.002)
    cosine, sine = np.cos(result.joint_angles[:, 0]), np.sin(result.joint_angles[:, 0])
    lag = sine * result.deflection[:, 0] - cosine * result.deflection[:, 1]
    stretch = cosine * result.deflection[:, 0] + sine * result.deflection[:, 1]
    steady, peak = result.time > 15.0, int(np.argmax(lag))
    yield VerificationRow("spin-up to 6 rad/s, peak lag of the tip, m", KANE, 0.5739, lag[peak], 5e-3)
    yield VerificationRow("spin-up to 6 rad/s, time of the peak, s", KANE, 6.76, result.time[peak], 0.05 / 6.76)
    yield VerificationRow("spin-up to 6 rad/s, steady stretch, m", KANE, 5.143e-4, stretch[steady].mean(), 5e-3)
    yield VerificationRow("spin-up to 6 rad/s, residual lag, m", KANE, 3.7e-3, np.abs(lag[steady]).max(), 0.05)
    linear = simulate(_spin_up_scene(stiffening=False), method="ros2", step=0.002)
    diverged = float(linear.status == "diverged")
    yield VerificationRow("spin-up to 6 rad/s without foreshortening, 1 for a divergence", KANE, 1.0, diverged, 0.0)


def _effect_rows() -> Iterator[VerificationRow]:
    """Yield the effect of each modelling option on the tip of the paper's flexible arm within 2 s, m."""
    scene = catalog.paper_scene("ff")
    body = Payload(5.0, inertia=((0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.5)), offset=(0.2, 0.0, 0.0))
    joints = [replace(joint, viscous_friction=5.0, coulomb_friction=20.0) for joint in scene.arm.joints]
    first, second, third = scene.arm.links
    (part,) = second.sections
    tapered = [replace(part, length=2.0, area=factor * part.area, second_moment_y=factor**2 * part.second_moment_y,
                       second_moment_z=factor**2 * part.second_moment_z,
                       torsion_constant=factor**2 * part.torsion_constant) for factor in (1.2, 0.8)]  # fmt: skip
    pulse, still = Signal(100.0, start=0.5, stop=0.6), Signal()
    loaded, carrying = (replace(scene, arm=replace(scene.arm, payload=each)) for each in (Payload(5.0), body))
    links = [first, NonUniformLink(tapered), third]
    changes = {
        "foreshortening": (scene, _chosen(scene, stiffening=True)),
        "no rotary inertia of sections": (scene, _chosen(scene, rotary_inertia=False)),
        "rotors as spinning bodies": (scene, _chosen(scene, spinning_rotors=True)),
        "friction of 5 N m s/rad and 20 N m": (scene, replace(scene, arm=replace(scene.arm, joints=joints))),
        "a payload of 5 kg": (scene, loaded),
        "0.5 kg m^2 and 0.2 m of offset in that payload": (loaded, carrying),
        "100 N upward on the tip for 0.1 s": (scene, replace(scene, tip_force=[still, still, pulse])),
        "0.1 m/s^2 of the base upward": (scene, replace(scene, base_acceleration=[still, still, Signal(0.1)])),
        "link 2 of two sections, 20 % more and less area": (scene, _tapered(scene, links)),
    }
    for name, (before, after) in changes.items():
        pair = [simulate(each, rtol=1e-7, atol=1e-9) for each in (before, after)]
        moved = _whole(pair[1], after, float(np.linalg.norm(pair[1].tip - pair[0].tip, axis=1).max()))
        yield VerificationRow(
            f"paper FF, what moves the tip within 2 s, m: {name}", "with and without", 0.0, moved, None
        )


def _chosen(scene: Scene, **choice: bool) -> Scene:
    return replace(scene, model=replace(scene.model, **choice))


def _tapered(scene: Scene, links: list[Link | NonUniformLink]) -> Scene:
    """Return the scene with the given links, of which the second has two sections of one element each."""
    return replace(scene, arm=replace(scene.arm, links=links), model=replace(scene.model, elements=(2, 1, 2)))


@cache
def _motion(reference: Path, name: str, stiffening: bool = False) -> Trajectory:
    """Return a reference scene simulated with the reference method, optionally with foreshortening."""
    scene = Scene.load(reference / f"{name}.json")
    chosen = replace(scene, model=replace(scene.model, stiffening=stiffening or scene.model.stiffening))
    return simulate(chosen, rtol=1e-8, atol=1e-10)


def _solution(reference: Path, name: str) -> Array:
    """Return the rows of a reference solution: time, tip, joint angles ..."""
    return np.loadtxt(reference / f"{name}.csv", delimiter=",", skiprows=1)


def _farthest(result: Trajectory, expected: Array, until: int | None = None) -> float:
    """Return the largest distance of the tip, m; infinite if the run ended early."""
    if result.status != "ok" or len(result.time) != len(expected):
        return np.inf
    return float(np.linalg.norm(result.tip - expected[:, 1:4], axis=1)[:until].max())


def _whole(result: Trajectory, scene: Scene, value: float) -> float:
    """Return the value if the run reached the end of its scene, else infinity."""
    return float(value) if result.status == "ok" and np.isclose(result.time[-1], scene.duration) else np.inf


REFERENCE = Path(__file__).parent / "reference"  # reference scenes and solutions of independent codes


def rows(reference: Path, quick: bool = False) -> list[VerificationRow]:
    """Return all rows, or only the fast ones; `reference` is the folder of the reference scenes and solutions."""
    return [*(row for case in (*CLOSED_FORMS, *CASES) for row in case()), *_motion_rows(reference, quick)]
