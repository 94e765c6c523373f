"""Times accelerations and environment steps beside Pinocchio's rigid ABA, and prints them as one table."""

import argparse
import json
import platform
import re
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from timeit import repeat

import gymnasium as gym
import numpy as np

import flexman_gym as fm

REPETITIONS, BATCHES, STEPS = 40, 3, 250
ABA = "Pinocchio aba, rigid arm, from Python"
TARGETS = {"evaluation, 5 modes a link": 4.0, "evaluation, 12 coordinates a link": 8.0}  # times aba, at most
NOTE = f"""Medians of {REPETITIONS} repetitions in turns, each the quickest of {BATCHES} batches (perf_counter).
An evaluation is a quarter of an RK4 step, {4 * STEPS} of them in one compiled call; aba pays for a call from Python."""
Timer = tuple[Callable[[], object], int]  # a call, and how many times it does what is timed


def evaluation(model: fm.Model) -> Timer:
    """Accelerations as simulations pay for them, at a random state that steps so short do not leave."""
    simulator = fm.Simulator(model, "rk4", step=1e-8, control_period=STEPS * 1e-8)
    simulator.reset(state=np.random.default_rng(0).normal(0.0, 0.02, 2 * model.n_dof))
    return lambda: simulator.step((100.0,) * model.n_joints), 4 * STEPS


def environment(env: gym.Env, count: int = 50) -> Timer:
    """Steps of an environment under random actions; episodes that end start anew."""
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(count)]
    return lambda: [env.reset() for action in actions if any(env.step(action)[2:4])], count


def pinocchio_aba(arm: fm.Arm, rigid: fm.Model, count: int = 500) -> Timer:
    """ABA of the rigid arm with its rotors, checked to give the same accelerations."""
    pin = __import__("pinocchio")  # which has no types
    model, place, parent = pin.Model(), pin.SE3.Identity(), 0
    for (link,), joint in zip((each.sections for each in arm.links), arm.joints, strict=True):  # uniform links
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(*joint.axis), place, f"joint {parent + 1}")
        y, z, slender = link.second_moment_y, link.second_moment_z, link.area * link.length**2 / 12
        inertia = link.density * link.length * np.diag([y + z, y + slender, z + slender])
        body, turn = pin.Inertia(link.mass, np.array([link.length / 2, 0.0, 0.0]), inertia), np.array(link.orientation)
        model.appendBodyToJoint(parent, body, pin.SE3(turn, np.zeros(3)))
        place = pin.SE3(np.eye(3), turn[:, 0] * link.length)
    model.armature, model.gravity.linear = np.array([j.rotor_inertia for j in arm.joints]), np.array(arm.gravity)
    q, v, torque = np.random.default_rng(0).uniform(-1.0, 1.0, (3, arm.n_joints))
    data, ours = model.createData(), fm.acceleration(rigid, rigid.initial_state(q, v), torque)
    assert np.allclose(pin.aba(model, data, q, v, torque), ours, rtol=1e-9), "the rigid arms accelerate differently"
    return lambda: [pin.aba(model, data, q, v, torque) for _ in range(count)], count


def timers() -> dict[str, Timer]:
    """Everything that is timed; building it warms it up."""
    arm, rows = fm.catalog.paper_rrr(), {}
    rigid, modal = fm.build_model(arm, flexible_links=False, flexible_joints=False), fm.build_model(arm, modes=5)
    try:
        rows[ABA] = pinocchio_aba(arm, rigid)
    except ImportError:
        print("Pinocchio is missing, so there are no ratios: pip install pin")
    models = {"rigid links": rigid, "5 modes a link": modal, "12 coordinates a link": fm.build_model(arm)}
    rows |= {f"evaluation, {name}": evaluation(model) for name, model in models.items()}
    state, torque = modal.initial_state((0.1, 0.2, 0.3)), np.ones(3)
    rows["fm.acceleration, 5 modes, from Python"] = lambda: fm.acceleration(modal, state, torque), 1
    rows["FlexRRR-v0 step"] = environment(gym.make("FlexRRR-v0"))
    step = gym.make("FlexRRR-v0").get_wrapper_attr("simulator").step
    rows["Simulator.step of FlexRRR-v0"] = lambda: [step(torque) for _ in range(50)], 50
    return rows | {"Pendulum-v1 step": environment(gym.make("Pendulum-v1"))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="file for the rows")
    file, calls = parser.parse_args().json, timers()
    times = {name: np.zeros(REPETITIONS) for name in calls}
    for i in range(REPETITIONS):  # in turns, so that a slow moment of the machine hits all rows
        for name, (call, count) in calls.items():
            times[name][i] = min(repeat(call, number=1, repeat=BATCHES)) / count * 1e6
    cpu = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text() if platform.system() == "Linux" else "")
    machine = {"processor": cpu[1] if cpu else platform.processor(), "python": platform.python_version()}
    machine |= {name: version(name) for name in ["numba", "numpy", "gymnasium", *["pin"] * (ABA in calls)]}
    header = f"{'':<40}{'microseconds':>12}{'times aba':>12}{'at most':>12}"
    print(", ".join(f"{name} {value}" for name, value in machine.items()), NOTE, header, sep="\n")
    rows = []
    for name, found in times.items():
        ratio = float(np.median(found / times[ABA])) if ABA in times else None
        row = {"microseconds": float(np.median(found)), "times_aba": ratio, "at_most": TARGETS.get(name)}
        print(f"{name:<40}" + "".join(f"{'' if x is None else f'{x:.2f}':>12}" for x in row.values()))
        rows.append(dict[str, object](name=name, **row))
    if file:
        file.write_text(json.dumps({"machine": machine, "note": NOTE, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
