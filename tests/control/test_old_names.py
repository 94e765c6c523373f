"""Names of release 0.2 in controllers, observers, action modes and saved states: still read, with a warning."""

import numpy as np
import pytest

from flexman_gym.agent.action_modes import TorqueMode, make_action_mode
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.tracking import OutputFeedback, Tracking

from oracles.observed_arms import small_plant

ON = np.ones(1, dtype=bool)


class Counter:
    """A controller that names its state as in release 0.2."""

    kept = ("count",)

    def __init__(self):
        self.count = np.zeros(1)


def test_kept_names_the_state_with_a_warning():
    counter = Counter()
    with pytest.warns(DeprecationWarning, match="Counter.kept is state_fields now"):
        assert get_state(counter) == {"count": np.zeros(1)}
    with pytest.warns(DeprecationWarning, match="state_fields"):
        set_state("state", counter, {"count": np.ones(1)})
    assert counter.count == 1.0


def test_a_state_with_old_names_of_fields_is_read():
    """The fields of a slew had other names in release 0.2."""
    slews = Tracking(small_plant("FlexOne-v0")).slews
    slews.allocate(1)
    state = get_state(slews)
    old = {"displacement": "way", "start_time": "begun", "duration": "lasting", "_compliance": "_soft",
           "_adapted_coordinates": "_own_coordinates", "_adapted_torques": "_own_torques", "time_scaling": "pace",
           "pace_rate": "quickening"}  # fmt: skip
    state["time_scaling"][:] = 1.5
    set_state("state", slews, {old.get(name, name): value for name, value in state.items()})
    assert slews.time_scaling == 1.5


def test_an_observer_with_wrong_hands_over_to_the_fallback_with_a_warning():
    class Lost:
        sensors, wrong = ("state",), ON

        def reset(self, arms, episode, count): ...

        def estimate(self, readings, applied, active):
            return Estimate(readings["state"], np.zeros(1, dtype=np.int64), {})

    controller = OutputFeedback(Lost(), Tracking(small_plant("FlexOne-v0")))
    controller._updated, controller._fallback_active = ~ON, ~ON
    with pytest.warns(DeprecationWarning, match="Lost.wrong is deprecated; name it inconsistent"):
        controller.update_estimate({"state": np.zeros((1, 2))}, np.zeros((1, 1)), ON)
    assert controller._fallback_active.all()


def test_a_mode_with_shown_and_look_is_used_with_a_warning():
    class Telling(TorqueMode):
        @property
        def shown(self):
            return {"time": 1}

        def look(self, readings, applied, active):
            return np.ones((1, 1))

    with pytest.warns(DeprecationWarning, match="Telling.shown and look are deprecated"):
        mode = make_action_mode(Telling(1), small_plant("FlexOne-v0"), None)
    assert mode.observation_sizes == {"time": 1} and mode.observe({}, None, ON) == 1.0
