"""Model of the paper's arm in SoRoMoX: bending strains quadratic along a link, constant torsion.

SoRoMoX joints have no rotors. A motor is therefore an additional joint followed by a link of one micrometre, and the
rotor inertia is added to the mass matrix of the package. A round section matches our mass and stiffness; links neither
stretch nor shear.
"""

import importlib
import os
import time
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.toolbox.precision.peers.peer_run import PeerRun, output_count, peer_row
from flexman_gym.toolbox.precision.runs import PrecisionScene, Timer

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
jax: Any = importlib.import_module("jax")
gvs: Any = importlib.import_module("soromox.systems.gvs")
parts: Any = importlib.import_module("soromox.systems.components")
jax.config.update("jax_enable_x64", True)

ORDER, STEP, STUB = (
    2,
    1e-2 / 15,
    1e-6,
)  # polynomial order of both bending strains; stable RK4 step, s; length of motor links, m
AXES, SIGNS, START = (
    ("x", "y", "y"),
    (1.0, -1.0, -1.0),
    (0.0, np.pi / 2, 0.0),
)  # joint axes and signs; initial angles (rad) of the vertical link 1


def robot(arm: fm.Arm) -> Any:
    """Return the `GVS` of the paper's arm."""
    segments, none = [], gvs.StrainBasisSpec("legendre", [0] * 6, 0)
    bent = gvs.StrainBasisSpec("legendre", [1, 1, 1, 0, 0, 0], [0, ORDER, ORDER, 0, 0, 0])
    for axis, link, joint in zip(AXES, arm.links, arm.joints, strict=True):
        (section,) = link.sections
        twice, radius = 2.0 * section.second_moment_y, (4.0 * section.second_moment_y / np.pi) ** 0.25
        beam = {"radius": radius, "reference_strain": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]}
        beam |= {"density": section.density * section.area / (np.pi * radius**2)}
        beam |= {"young_modulus": section.youngs_modulus}
        beam |= {"shear_modulus": section.shear_modulus * section.torsion_constant / twice}
        spring = parts.JointSpec.revolute(axis, stiffness=[[joint.stiffness]])
        for length, each, basis in ((STUB, parts.JointSpec.revolute(axis), none), (link.length, spring, bent)):
            segments.append(gvs.GVSSegment(parts.LinkSpec.circular(length=length, **beam), each, basis, 5))
    return gvs.GVS.from_segments(segments, gravity=jax.numpy.array(arm.gravity))


@cache
def compiled(arm: fm.Arm, torque: tuple[float, ...], step: float, count: int) -> tuple[Callable, Callable, Any]:
    """Return functions of the state for `count` Runge-Kutta steps (s) and for the tip, and the state at rest."""
    model = robot(arm)
    motors = (2 * ORDER + 5) * np.arange(len(torque))  # per link: motor, spring, torsion, two bending strains
    rotors, load, rest = np.zeros(model.K.shape), np.zeros(len(model.K)), np.zeros((2, len(model.K)))
    rotors[motors, motors] = [joint.rotor_inertia for joint in arm.joints]
    load[motors], rest[0, motors] = np.multiply(SIGNS, torque), START

    def slope(state: Any) -> Any:
        mass, gyration, weight = model.dynamics_terms(*state)
        force = load - gyration - weight - model.K @ state[0]
        return jax.numpy.stack([state[1], jax.numpy.linalg.solve(mass + rotors, force)])

    def one(_: int, state: Any) -> Any:
        a = slope(state)
        b = slope(state + step / 2 * a)
        c = slope(state + step / 2 * b)
        return state + step / 6 * (a + 2 * b + 2 * c + slope(state + step * c))

    tip = jax.jit(lambda state: model.forward_kinematics_tips(state[0])[-1, :3, 3])
    return jax.jit(lambda state: jax.lax.fori_loop(0, count, one, state)), tip, jax.numpy.array(rest)


def run(scene: fm.Scene, step: float = STEP) -> PeerRun:
    """Run a scene of constant torques from rest at zero angles; the step (s) must divide the output step."""
    rows, count = output_count(scene, step)
    advance, tip, state = compiled(scene.arm, scene.torque.value, step, count)  # type: ignore[arg-type, union-attr]
    tips = [np.asarray(tip(0.0 * advance(state) + state))]  # compiles both functions
    started = time.process_time(), time.perf_counter()
    for _ in range(rows):
        state = advance(state)
        tips.append(np.asarray(tip(state)))
    costs = (time.process_time() - started[0]) / scene.duration, (time.perf_counter() - started[1]) / scene.duration
    return PeerRun("SoRoMoX, quadratic strains", "RK4", step, np.array(tips), *costs, 4 / step)


def runs(scene: PrecisionScene) -> list[Timer]:
    """Return the timer of the arm."""
    return [lambda: peer_row(scene, run(scene.scene))]
