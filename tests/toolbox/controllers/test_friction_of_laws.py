"""Friction in the design of control laws: gains of the arm without friction, torques that compensate it."""

import importlib
import pkgutil

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym import agent
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.model.friction import frictionless
from flexman_gym.simulation.linearization import linearize
from flexman_gym.toolbox import controllers
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.tracking import Tracking

from oracles.frictional import two_links as model

PERIOD, LIMITS = 0.02, (12.0, 4.0)


def test_the_tracking_law_compensates_at_the_state_at_which_its_torques_act():
    """The sum is cut at the limits."""
    own, arms, active = Plant(model(), LIMITS, PERIOD, dict), np.array([0]), np.array([True])
    law = Tracking(own)
    law.reset(arms, EpisodeInfo(np.array([[0.1, -0.3]]), np.array([[0.6, 0.4]]), PERIOD), 1)
    state = fm.rest_state(own.model, np.array([0.1, -0.3]))
    law.torques(Estimate(state[None], np.array([0]), {}), active)
    state[own.model.n_dof + own.model.motor_columns] = 0.05, -0.05
    seen = []
    compensation = law._compensation
    law._compensation = lambda *given: seen.append((given[0].copy(), given[1])) or compensation(*given)
    result = law.torques(Estimate(state[None], np.array([0]), {}), active)
    commands, states = seen[0]
    assert np.array_equal(states, state[None])
    wanted = commands + compensation(commands, states, arms, 1)
    assert (
        np.array_equal(result, np.clip(wanted, -np.array(LIMITS), np.array(LIMITS)))
        and np.abs(wanted - commands).max() > 0.1
    )


def test_no_control_law_is_designed_for_a_linear_model_with_friction(monkeypatch):
    """Linear models of all laws; those of margins and observers have sliding motors."""
    modules = [
        each.name
        for package in (agent, controllers)
        for each in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    ]
    users = [each for each in map(importlib.import_module, modules) if hasattr(each, "linearize")]
    assert {each.__name__.rpartition(".")[2] for each in users} >= {"cost_weights", "mpc", "margins"}
    used = []

    def watched(linearized, *arguments, **named):
        used.append((linearized, named))
        return linearize(linearized, *arguments, **named)

    for each in users:
        monkeypatch.setattr(each, "linearize", watched)
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0", "arm": model().arm, "elements": 1, "modes": 1})
    own = make_plant(setup, resolve_fidelity(setup).model)._replace(unknown={"coulomb_friction_factor": (0.5, 1.5)})
    for name in ("lqr", "lqr-tracking", "mpc", "lqg", "adaptive-lqr", "privileged-lqr"):
        used.clear()
        law = make_base(name, own)
        for table in getattr(getattr(law, "law", None), "_gains", ()):
            table(np.array([0]), np.full((1, 2), 0.31), np.array([0.03]))
        if not hasattr(law, "law"):
            law.reset(np.array([0]), EpisodeInfo(np.zeros((1, 2)), np.array([[0.3, 0.2]]), PERIOD), 1)
        assert used, name
        for linearized, named in used:
            assert linearized is frictionless(linearized) and named.get("friction", "sliding") == "sliding", name


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-6, 1.0, 1.5])
def test_it_settles_an_arm_with_less_and_with_more_friction_than_its_model(factor):
    """Friction that is given, far from that of the model."""
    friction = Configuration.find("FlexRRR-v0/friction").arm
    ranges = {"viscous_friction_factor": (factor, factor), "coulomb_friction_factor": (factor, factor)}
    setup = Configuration.from_keywords({"name": "FlexRRR-v0", "arm": friction, "randomisation": ranges})
    base = make_base("privileged-lqr", make_plant(setup, resolve_fidelity(setup).model))
    result = evaluate(base, setup, range(5000, 5003))
    assert result["settled"] == 1.0 and result["vibration"] < 0.012
