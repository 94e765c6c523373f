"""Tests of refused models, states, postures and links: one line names field, value and what is allowed."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm

from oracles.assertions import refusal

STRIP, HUB, REST = fm.Link.strip(0.5, 0.04, 0.003), fm.Joint((0.0, 0.0, 1.0)), (0.0, 0.0)
TWO = fm.catalog.planar_2r()
LOOSE = replace(TWO, joints=[TWO.joints[0], replace(TWO.joints[1], stiffness=50.0, damping=0.0)])
DAMPED = replace(TWO, joints=[TWO.joints[0], replace(TWO.joints[1], stiffness=50.0, damping=2.0)])
RIGID, SPRUNG, DASHED = (fm.build_model(arm, flexible_links=False) for arm in (TWO, LOOSE, DAMPED))
HALF = fm.build_model(fm.catalog.one_link(), flexible_links=False)
BENT, STEPPED = fm.build_model(fm.catalog.one_link()), fm.Arm([fm.NonUniformLink([STRIP] * 3)], [HUB])
LOOSE_GEAR = fm.build_model(replace(TWO, joints=[replace(DAMPED.joints[1], damping=0.0, backlash=1e-3)] * 2),
                            flexible_links=False)  # fmt: skip
RIPPLE = fm.Motor(9.0, 0.1, 1e-4, ripple_cycles=1.0)
RIPPLED = fm.build_model(replace(TWO, joints=[replace(HUB, motor=RIPPLE)] * 2), flexible_links=False)
REDUCED = fm.linearize(BENT).reduced(50.0)
BODY = fm.LumpedMass(0.2, 0.5)


def build(**options):
    """Build a model of three links."""
    return fm.build_model(fm.catalog.paper_rrr(), **options)


REFUSED = [  # call, and the beginning of its message
    (lambda: build(modes=13), "modes[0]: "),
    (lambda: build(modes=(4, 4, 13)), "modes[2]: "),
    (lambda: build(modes=(4, (0, 12), 3)), "modes[1]: "),
    (lambda: build(modes=(4, 4)), "modes: "),
    (lambda: build(elements=(2, 2, 2, 2)), "elements: "),
    (lambda: build(elements=0), "ModelChoice.elements: "),
    (lambda: build(flexible_links=(True,)), "flexible_links: "),
    (lambda: build(flexible_joints=1), "ModelChoice.flexible_joints: "),
    (lambda: build(rotary_inertia=0), "ModelChoice.rotary_inertia: 0 is not allowed; give true or false"),
    (lambda: fm.build_model(STEPPED, 22), "elements[0]: 22 is not allowed; give at most 21 for each of the 3 sections"),
    (lambda: fm.build_model(STEPPED, 1, 19), "modes[0]: 19 is not allowed; give at most 18"),
    (lambda: fm.strain(HALF, [0.0], 0, 1.0), "state: "),
    (lambda: fm.strain(HALF, [0.0, np.nan], 0, 1.0), "state[1]: "),
    (lambda: fm.strain(HALF, REST, 1, 1.0), "link: "),
    (lambda: fm.strain(HALF, REST, -1, 1.0), "link: "),
    (lambda: fm.strain(HALF, REST, 0.0, 1.0), "link: "),
    (lambda: fm.strain(HALF, REST, 0, -0.1), "position: "),
    (lambda: fm.strain(HALF, REST, 0, 2.1), "position: "),
    (lambda: fm.strain(HALF, REST, 0, None), "position: "),
    (lambda: fm.strain(HALF, REST, 0, 1.0, "top"), "y: "),
    (lambda: fm.strain(HALF, REST, 0, 1.0, 0.0, np.inf), "z: "),
    (lambda: fm.curves(BENT, [0.0], 5), "states: "),
    (lambda: fm.curves(BENT, [np.nan] * 26, 5), "states: "),
    (lambda: fm.curves(BENT, [0.0] * 26, 1), "points: "),
    (lambda: fm.curves(BENT, [0.0] * 26, 5, -1), "gain: "),
    (lambda: fm.acceleration(HALF, np.zeros(3), [0.0]), "state: "),
    (lambda: fm.acceleration(HALF, [0.0, np.nan], [0.0]), "state[1]: "),
    (lambda: fm.acceleration(HALF, REST, [0.0, 1.0]), "torque: "),
    (lambda: fm.acceleration(HALF, REST, [np.inf]), "torque[0]: "),
    (lambda: fm.acceleration(HALF, REST, 1.0), "torque: "),
    (lambda: fm.mass_matrix(HALF, "rest"), "state: "),
    (lambda: fm.mass_matrix(HALF, np.zeros((2, 1))), "state[0]: "),
    (lambda: fm.frequencies(HALF, REST), "joint_angles: "),
    (lambda: fm.frequencies(HALF, [None]), "joint_angles[0]: "),
    (lambda: fm.modes(BENT, motors="loose"), "motors: 'loose' is not allowed; give one of"),
    (lambda: fm.modes("arm"), "model: 'arm' is not allowed; give a Model"),
    (lambda: fm.inverse_dynamics(fm.build_model(TWO), REST, REST, REST), "model.choice.flexible_links: "),
    (lambda: fm.inverse_dynamics(SPRUNG, REST, REST, REST), "joint_jerks: "),
    (lambda: fm.inverse_dynamics(SPRUNG, REST, REST, REST, REST), "joint_snaps: "),
    (lambda: fm.inverse_dynamics(DASHED, *[REST] * 5), "model.arm.joints[1].damping: "),
    (lambda: fm.inverse_dynamics(RIGID, [0.0], REST, REST), "joint_angles: "),
    (lambda: fm.inverse_dynamics(RIGID, REST, [0.0, np.inf], REST), "joint_rates[1]: "),
    (lambda: fm.inverse_dynamics(RIGID, REST, REST, 1.0), "joint_accelerations: "),
    (lambda: fm.inverse_dynamics(RIGID, REST, REST, REST, [0.0]), "joint_jerks: "),
    (lambda: fm.tip_acceleration(RIGID, REST, REST), "state: "),
    (lambda: fm.tip_acceleration(RIGID, REST + REST, [0.0]), "torque: "),
    (lambda: fm.rest_state(BENT, REST), "motor_angles: (0.0, 0.0) is not allowed; give 1 numb"),
    (lambda: fm.holding_torques(BENT, [np.nan]), "motor_angles[0]: nan is not allowed; give a finite"),
    (lambda: fm.linearize(RIGID, [0.0]), "joint_angles: "),
    (lambda: fm.linearize(RIGID, [0.0, np.nan]), "joint_angles[1]: "),
    (lambda: fm.linearize(RIGID, state=np.zeros(3)), "state: "),
    (lambda: fm.linearize(RIGID, REST, state=np.zeros(4)), "state: "),
    (lambda: fm.linearize(RIGID, torque=[1.0]), "torque: "),
    (lambda: fm.linearize(RIGID, torque=[1.0, "much"]), "torque[1]: "),
    (lambda: fm.linearize(BENT, period=501.0), "period: 501.0 is not allowed; give at most 500 s, 100000 steps"),
    (lambda: fm.linearize(BENT, friction="none"), "friction: 'none' is not allowed; give "),
    (lambda: fm.linearize(BENT, outputs=["tips"]), "outputs[0]: 'tips' is not allowed; give one of motor_angles"),
    (lambda: fm.linearize(BENT, inputs=["torque"]), "inputs[0]: 'torque' is not allowed; give one of motor_torques"),
    (lambda: fm.linearize(BENT, inputs=[]), "inputs: [] is not allowed; give at least one of motor_torques"),
    (lambda: fm.linearize(BENT).reduced(0.0), "frequency: 0.0 is not allowed; give "),
    (
        lambda: REDUCED.scaled(),
        "model: 'a changed model' is not allowed; give the continuous-time model of linearize",
    ),
    (lambda: REDUCED.discrete(0.0), "period: 0.0 is not allowed; give "),
    (lambda: REDUCED.discrete(0.1, -1.0), "delay: -1.0 is not allowed; give "),
    (lambda: REDUCED.discrete(0.1).discrete(0.1), "period: 0.1 is not allowed; give a continuous model"),
    (lambda: REDUCED.frequency_response([-1.0]), "frequencies[0]: -1.0 is not allowed; give "),
    (lambda: fm.inverse_dynamics(LOOSE_GEAR, *[REST] * 5), "model.arm.joints: 'with backlash or stiffness pieces' is"),
    (
        lambda: fm.inverse_dynamics(RIPPLED, *[REST] * 3),
        "model.arm.joints: 'with torque ripple' is not allowed; give mo",
    ),
    (lambda: fm.LumpedMass(0.0, 0.1), "LumpedMass.mass: 0.0 is not allowed; give a finite number > 0"),
    (lambda: fm.LumpedMass(1.0, -0.1), "LumpedMass.position: -0.1 is not allowed; give a finite number >= 0"),
    (lambda: fm.LumpedMass(1.0, 0.1, -np.eye(3)), "LumpedMass.inertia: "),
    (lambda: fm.LumpedMass(1.0, 0.1, None, REST), "LumpedMass.offset: (0.0, 0.0) is not allowed; give 3"),
    (lambda: replace(STRIP, masses=[BODY, 3.0]), "Link.masses[1]: 3.0 is not allowed; give a LumpedMass"),
    (lambda: fm.NonUniformLink([replace(STRIP, masses=[BODY])]), "NonUniformLink.sections[0].masses: "),
]


@pytest.mark.parametrize(("call", "line"), REFUSED, ids=[line for _, line in REFUSED])
def test_bad_input_is_refused_in_one_line(call, line):
    said = refusal(call)
    assert said.startswith(line) and " is not allowed; give " in said, said
