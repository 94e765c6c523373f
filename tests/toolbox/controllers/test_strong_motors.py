"""Controllers of arms whose motors have many times the torque that a slew without vibration needs."""

import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.controllers.cost_weights import NamedWeights

PACKAGES = {"mpc": "daqp", "hinf": "slycot"}  # agent -> package that it needs


def strips(payload=0.2):
    """Return two strips of aluminium in a horizontal plane, with a motor at the elbow and a payload (kg) at the tip."""
    links = [
        fm.Link.strip(0.25, 0.04, 0.003, masses=[fm.LumpedMass(0.6, 0.25)]),
        fm.Link.strip(0.25, 0.03, 0.002),
    ]
    motors = zip((0.004, 0.0005), (12.0, 4.0), strict=True)
    joints = [fm.Joint((0.0, 0.0, 1.0), inertia, torque_limit=torque) for inertia, torque in motors]
    return fm.Arm(links, joints, payload=fm.Payload(payload), gravity=(0.0, 0.0, 0.0), modal_damping_ratio=0.005)


def ruler():
    """Return a ruler of steel with a mass of 20 g at its tip, on a geared motor."""
    link = fm.Link.strip(0.4, 0.03, 0.001, material="steel", masses=[fm.LumpedMass(0.02, 0.4)])
    joint = fm.Joint((0.0, 0.0, 1.0), 0.01, torque_limit=4.0, viscous_friction=0.05)
    return fm.Arm([link], [joint], gravity=(0.0, 0.0, 0.0), modal_damping_ratio=0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("agent", "arm"),
    [("lqr", strips(0.1)), ("mpc", strips()), ("mpc", ruler()), ("planned", strips()), ("hinf", ruler())],
    ids=["lqr, strips", "mpc, strips", "mpc, ruler", "planned, strips", "hinf, ruler"],
)
def test_slews_of_strong_motors_keep_the_limits_of_the_arm(agent, arm):
    if agent in PACKAGES:
        pytest.importorskip(PACKAGES[agent])
    settings = Configuration("FlexRRR-v0", {"arm": arm})
    assert rollout(agent, settings, 6).lengths.tolist() == 6 * [settings.max_periods]


def test_the_design_named_has_weights_of_the_reach():
    """Policies are stored that were trained on these regulators."""
    settings = Configuration("FlexRRR-v0")
    plant = make_plant(settings, resolve_fidelity(settings).model)
    assert make_base("lqr", plant).weights == NamedWeights.of_reach(plant.model)
    assert make_base({"kind": "lqr", "design": "arm"}, plant).weights != NamedWeights.of_reach(plant.model)
