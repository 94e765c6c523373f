"""Fidelity scenes: the arms and motions of the study of `choose_model`."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import flexman_gym as fm


def random_scene(seed: int) -> fm.Scene:
    """A chain of 1 to 3 hollow metal links on springs, driven by sine torques."""
    rng, links, joints = np.random.default_rng(seed), [], []
    for _ in range(1 + seed % 3):
        radius, length = rng.uniform(0.008, 0.02), rng.uniform(0.5, 1.5)
        area, bending = 0.36 * np.pi * radius**2, 0.5904 * np.pi / 4 * radius**4  # a wall of 0.2 radii
        turn, across = (Rotation.random(random_state=rng).as_matrix().tolist() for _ in range(2))
        links.append(fm.Link(length, area, bending, bending, 2 * bending, 70e9, 26e9, 2700.0, turn))
        joints.append(fm.Joint(across[0], rng.uniform(0.02, 0.2), 10 ** rng.uniform(2.0, 3.5), rng.uniform(0.0, 0.5)))

    def draw(low: float, high: float) -> list[float]:
        return [float(number) for number in rng.uniform(low, high, len(links))]

    torque = fm.SineTorque(draw(1.0, 6.0), draw(0.4, 2.0), draw(0.0, 3.0))
    start, arm = fm.Initial(draw(-1.0, 1.0), draw(-1.0, 1.0)), fm.Arm(links, joints, fm.Payload(rng.uniform(0.0, 0.5)))
    return fm.Scene(arm, fm.ModelChoice(True, 2), torque, start, 1.0, 0.01)


def scenes() -> dict[str, fm.Scene]:
    """The scenes of the study."""
    result = {f"paper {case}": replace(fm.catalog.paper_scene(case), duration=1.0) for case in ("rr", "fr", "ff")}
    heavy = fm.catalog.paper_rrr(rotor_inertia=10.0, payload=fm.Payload(5.0), gravity=(0.0, 0.0, -9.81))
    strips, hub = fm.catalog.planar_2r(joint_stiffness=50.0), fm.catalog.one_link(rotor_inertia=0.1)
    result["paper ff with gravity"] = replace(result["paper ff"], arm=heavy)
    for name, arm, torque in (("two strips", strips, [0.2, 0.05]), ("one link", hub, [0.5])):
        rest = [0.0] * arm.n_joints
        start, choice = fm.Initial(rest, rest), fm.ModelChoice(True, 4 - arm.n_joints)
        result[name] = fm.Scene(arm, choice, fm.ConstantTorque(torque), start, 1.0, 0.01)
    return result | {f"random {seed}": random_scene(seed) for seed in range(6)}


def open_scenes() -> dict[str, fm.Scene]:
    """The same, with the finite elements left to the choice."""
    return {name: replace(scene, model=replace(scene.model, elements=None)) for name, scene in scenes().items()}
