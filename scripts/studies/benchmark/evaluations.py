"""Evaluations: what accelerations cost beside Pinocchio's rigid ABA, and what modelling choices add."""

from dataclasses import replace

import numpy as np

import flexman_gym as fm
from studies.benchmark.rows import EVALUATIONS, Row, Timer, in_turns, timer

BATCHES, STEPS = 3, 250
ABA, PLAIN = "Pinocchio aba, rigid arm, from Python", "evaluation, 12 coordinates a link"
NOTE = f"""Medians over rounds, of each the cheapest of {BATCHES} batches. An evaluation is a quarter of an RK4 step,
{4 * STEPS} of them in one compiled call. The `aba` of Pinocchio pays for a call from Python. A row that begins with
"with" is compared with 12 coordinates a link without its choice, any other with `aba`."""
I3 = tuple(map(tuple, np.eye(3)))


def evaluation(model: fm.Model, **drive: tuple[float, ...]) -> Timer:
    """Accelerations as simulations pay for them, at a random state that steps so short do not leave."""
    held = [0] if "acceleration" in drive else []
    simulator = fm.Simulator(model, "rk4", step=1e-8, control_period=STEPS * 1e-8, prescribed=held)
    simulator.reset(state=np.random.default_rng(0).normal(0.0, 0.02, 2 * model.n_dof))
    torque = np.where(np.isin(np.arange(model.n_joints), held), 0.0, 100.0)
    return timer(lambda: simulator.step(torque, **drive), 4 * STEPS, BATCHES)


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
    return {f"  {name}": each for name, each in timers.items()}


def pinocchio_aba(arm: fm.Arm, rigid: fm.Model, count: int = 500) -> Timer:
    """ABA of the rigid arm with its rotors, checked to give the same accelerations."""
    from studies.peers.pinocchio import pin, rigid_model

    model = rigid_model(arm)
    q, v, torque = np.random.default_rng(0).uniform(-1.0, 1.0, (3, arm.n_joints))
    data, ours = model.createData(), fm.acceleration(rigid, rigid.initial_state(q, v), torque)
    assert np.allclose(pin.aba(model, data, q, v, torque), ours, rtol=1e-9), "the rigid arms accelerate differently"
    return timer(lambda: [pin.aba(model, data, q, v, torque) for _ in range(count)], count, BATCHES)


def timers() -> dict[str, Timer]:
    """Everything that is timed; building it warms it up."""
    arm, result = fm.catalog.paper_rrr(link1_area="corrected"), {}
    rigid, modal = fm.build_model(arm, flexible_links=False, flexible_joints=False), fm.build_model(arm, modes=5)
    try:
        result[ABA] = pinocchio_aba(arm, rigid)
    except ImportError:
        print("Pinocchio is missing, so evaluations have no peer: pip install pin")
    models = {"rigid links": rigid, "5 modes a link": modal, "12 coordinates a link": fm.build_model(arm)}
    result |= {f"evaluation, {name}": evaluation(model) for name, model in models.items()}
    result |= switches(arm)
    state, torque = modal.initial_state((0.1, 0.2, 0.3)), np.ones(3)
    result["fm.acceleration, 5 modes, from Python"] = timer(lambda: fm.acceleration(modal, state, torque), 1, BATCHES)
    return result


def rows(rounds: int) -> list[Row]:
    """A row of each."""
    costs, result = in_turns(timers(), rounds), []
    for name, cost in costs.items():
        cpu, wall, _ = np.median(cost, axis=0)
        peer = PLAIN if name.startswith(" ") else ABA
        times = float(np.median(cost[:, 0] / costs[peer][:, 0])) if peer in costs else None
        compared = peer if times else "", times
        result.append(Row(EVALUATIONS, name.strip(), None, None, float(cpu), float(wall), *compared))
    return result
