"""Places: starts and goals that are given by where the tip is."""

import numpy as np
import pytest

from flexman_gym.envs.config.reset_options import replace_tip_positions
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import refusal


@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexPlanar-v0", "FlexOne-v0", "FlexRRR-Gravity-v0"])
def test_a_goal_by_its_place_is_that_place_also_where_weight_bends_the_arm(name):
    env = FlexManEnv(name=name)
    view = env.episodes.view
    start, goal = np.full(view.n_joints, 0.3), np.linspace(-0.3, 0.5, view.n_joints)
    place = view.rest_tips(goal[None])[0]
    _, info = env.reset(seed=0, options={"start": start, "goal_tip": place})
    assert info["target"] == pytest.approx(place, abs=1e-7 * view.reach)
    turned, known = info["goal_angles"] - start, goal - start
    assert (turned**2).sum() <= (known**2).sum() + 1e-6, "it turns no farther than a posture that leads there"
    _, info = env.reset(seed=0, options={"start_tip": place, "goal_angles": goal})
    assert info["tip"] == pytest.approx(place, abs=1e-6 * view.reach) and info["tip_error"] < 1e-6 * view.reach


def posture_at(place, near, view):
    """Return the posture of a tip position near a start posture."""
    parameters = {"start": np.array([near]), "goal_tip": np.array([place])}
    return replace_tip_positions(parameters, view)["goal_angles"][0]


def test_of_two_elbows_it_takes_the_one_that_turns_less():
    """The law of cosines gives both postures of two links of 0.5 m."""
    view = FlexManEnv(name="FlexPlanar-v0").episodes.view
    distance, heading = 0.7, 0.4
    elbow = np.arccos(distance**2 / 0.5 - 1.0)
    both = [np.array([heading - side * elbow / 2.0, side * elbow]) for side in (1.0, -1.0)]
    place = view.rigid_tips(both[0][None])[0]
    assert view.rigid_tips(both[1][None])[0] == pytest.approx(place)
    view.has_gravity = False
    for wanted in both:
        for near in (np.add(wanted, (0.2, -0.3)), np.add(wanted, (-0.4, 0.1))):
            assert posture_at(place, near, view) == pytest.approx(wanted, abs=1e-6)
    near = both[0] + (1.1184511, 1.1817330)  # from where Newton's method ends a turn away
    assert posture_at(place, near, view) == pytest.approx(both[0], abs=1e-6)
    assert posture_at(place, both[0] + 2.0 * np.pi, view) == pytest.approx(both[0] + 2.0 * np.pi, abs=1e-6)


def test_each_arm_of_many_has_its_own_place():
    venv = FlexManVectorEnv(2, name="FlexRRR-v0")
    places = np.array([[4.0, 2.0, 3.0], [5.0, -1.0, 2.5]])
    _, infos = venv.reset(seed=0, options={"goal_tip": places})
    assert infos["target"] == pytest.approx(places, abs=1e-6)
    again = venv.reset(seed=0, options={"goal_tip": places.tolist()})[1]
    assert np.array_equal(again["goal_angles"], infos["goal_angles"])


def test_each_arm_of_many_turns_from_its_own_start():
    """One place for both arms, beside one posture of the elbow each."""
    venv = FlexManVectorEnv(2, name="FlexPlanar-v0")
    view = venv.episodes.view
    elbows = np.array([[0.2, 0.8], [1.0, -0.8]])
    place = view.rest_tips(elbows[:1])[0]
    _, infos = venv.reset(seed=0, options={"start": elbows + 0.1, "goal_tip": [place, place]})
    assert (np.abs(infos["goal_angles"] - elbows) < 0.1).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"goal_tip": [9.0, 0.0, 0.0]},
            "options['goal_tip']: [9.0, 0.0, 0.0] is not allowed; give a position of the tip (m, base frame)",
        ),
        ({"start_tip": [0.0, 0.0, 99.0]}, "options['start_tip']: [0.0, 0.0, 99.0] is not allowed"),
        ({"goal_tip": [1.0, 2.0]}, "options['goal_tip']: [1.0, 2.0] is not allowed; give 3 numbers (m)"),
        (
            {"goal_tip": [4.0, 2.0, 3.0], "goal_angles": [0.0] * 3},
            "options['goal_angles']: [0.0, 0.0, 0.0] is not allowed; give either",
        ),
        (
            {"tip": [4.0, 2.0, 3.0]},
            "options: 'tip' is not allowed; give one of start, goal_angles, start_tip, goal_tip, parameters",
        ),
    ],
)
def test_places_that_cannot_be_are_refused_in_one_line(options, said):
    env = FlexManEnv()
    env.reset(seed=1)
    assert refusal(lambda: env.reset(options=options)).startswith(said)
    assert env.reset()[1]["status"] == "ok"


def test_a_planar_arm_does_not_leave_its_plane():
    said = refusal(lambda: FlexManEnv(name="FlexOne-v0").reset(options={"goal_tip": [0.5, 0.5, 0.2]}))
    assert said.startswith("options['goal_tip']: [0.5, 0.5, 0.2] is not allowed") and said.endswith(
        "within the reach of the arm, 0.8 m"
    )
