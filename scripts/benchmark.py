"""Times accelerations and environment steps beside Pinocchio's rigid ABA, and prints them as one table."""

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from timeit import repeat

import gymnasium as gym
import numpy as np

import flexman_gym as fm
from flexman_gym.verification import machine, machine_text

REPETITIONS, BATCHES, STEPS = 40, 3, 250
ABA, PLAIN = "Pinocchio aba, rigid arm, from Python", "evaluation, 12 coordinates a link"
TARGETS = {"evaluation, 5 modes a link": 4.0, PLAIN: 8.0, "  with foreshortening": 1.3}  # times its peer, at most
NOTE = f"""Medians of {REPETITIONS} repetitions in turns, each the quickest of {BATCHES} batches (perf_counter).
An evaluation is a quarter of an RK4 step, {4 * STEPS} of them in one compiled call; aba pays for a call from Python.
Indented rows are compared with 12 coordinates a link without that choice, the others with aba."""
I3 = tuple(map(tuple, np.eye(3)))
Timer = tuple[Callable[[], object], int]  # a call, and how many times it does what is timed


def evaluation(model: fm.Model, **drive: tuple[float, ...]) -> Timer:
    """Accelerations as simulations pay for them, at a random state that steps so short do not leave."""
    held = [0] if "acceleration" in drive else []
    simulator = fm.Simulator(model, "rk4", step=1e-8, control_period=STEPS * 1e-8, prescribed=held)
    simulator.reset(state=np.random.default_rng(0).normal(0.0, 0.02, 2 * model.n_dof))
    torque = np.where(np.isin(np.arange(model.n_joints), held), 0.0, 100.0)
    return lambda: simulator.step(torque, **drive), 4 * STEPS


def switches(arm: fm.Arm) -> dict[str, Timer]:
    """Evaluations with 12 coordinates a link and one modelling choice that the paper's scene does without."""
    halves = []
    for link in arm.links:
        (whole,) = link.sections
        halves.append(fm.NonUniformLink([replace(whole, length=link.length / 2, orientation=I3)] * 2, link.orientation))
    joints = [replace(joint, viscous_friction=5.0, coulomb_friction=20.0) for joint in arm.joints]
    body = fm.Payload(5.0, inertia=I3, offset=(0.1, 0.0, 0.0))
    models = {
        "with foreshortening": fm.build_model(arm, stiffening=True),
        "without rotary inertia": fm.build_model(arm, rotary_inertia=False),
        "with spinning rotors": fm.build_model(arm, spinning_rotors=True),
        "with joint friction": fm.build_model(replace(arm, joints=joints)),
        "with a payload of inertia and offset": fm.build_model(replace(arm, payload=body)),
        "with links of two sections": fm.build_model(replace(arm, links=halves), elements=1),
    }
    plain, pushed = fm.build_model(arm), (1.0, 2.0, 3.0)
    timers = {name: evaluation(model) for name, model in models.items()}
    timers["with a force on the tip"] = evaluation(plain, tip_force=pushed)
    timers["with an accelerated base"] = evaluation(plain, base_acceleration=pushed)
    timers["with a prescribed joint"] = evaluation(plain, acceleration=(1.0, 0.0, 0.0))
    return {f"  {name}": timer for name, timer in timers.items()}


def environment(env: gym.Env, count: int = 50) -> Timer:
    """Steps of an environment under random actions; episodes that end start anew."""
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(count)]
    return lambda: [env.reset() for action in actions if any(env.step(action)[2:4])], count


def pinocchio_aba(arm: fm.Arm, rigid: fm.Model, count: int = 500) -> Timer:
    """ABA of the rigid arm with its rotors, checked to give the same accelerations."""
    from peers_pinocchio import pin, rigid_model

    model = rigid_model(arm)
    q, v, torque = np.random.default_rng(0).uniform(-1.0, 1.0, (3, arm.n_joints))
    data, ours = model.createData(), fm.acceleration(rigid, rigid.initial_state(q, v), torque)
    assert np.allclose(pin.aba(model, data, q, v, torque), ours, rtol=1e-9), "the rigid arms accelerate differently"
    return lambda: [pin.aba(model, data, q, v, torque) for _ in range(count)], count


def timers() -> dict[str, Timer]:
    """Everything that is timed; building it warms it up."""
    arm, rows = fm.catalog.paper_rrr(link1_area="corrected"), {}
    rigid, modal = fm.build_model(arm, flexible_links=False, flexible_joints=False), fm.build_model(arm, modes=5)
    try:
        rows[ABA] = pinocchio_aba(arm, rigid)
    except ImportError:
        print("Pinocchio is missing, so there are no ratios: pip install pin")
    models = {"rigid links": rigid, "5 modes a link": modal, "12 coordinates a link": fm.build_model(arm)}
    rows |= {f"evaluation, {name}": evaluation(model) for name, model in models.items()}
    rows |= switches(arm)
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
    peers = {name: version(name) for name in ["gymnasium", *["pin"] * (ABA in calls)]}
    header = f"{'':<40}{'microseconds':>12}{'times peer':>12}{'at most':>12}"
    print(machine_text(**peers), NOTE, header, sep="\n")
    rows = []
    for name, found in times.items():
        peer = PLAIN if name.startswith(" ") else ABA
        ratio = float(np.median(found / times[peer])) if peer in times else None
        row = {"microseconds": float(np.median(found)), "times_peer": ratio, "at_most": TARGETS.get(name)}
        print(f"{name:<40}" + "".join(f"{'' if x is None else f'{x:.2f}':>12}" for x in row.values()))
        rows.append(dict[str, object](name=name, **row))
    if file:
        file.write_text(json.dumps({"machine": machine() | peers, "note": NOTE, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
