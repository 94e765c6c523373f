"""Settings that follow from an arm: closed forms, bounds by motor speeds and modes, and named arms without any."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.arm_settings import PEAK_ACCELERATION, SEED, SLEWS, arm_facts, derived_settings
from flexman_gym.envs.config.configuration import Configuration

LIMIT, INERTIA = 5.0, 0.02  # N m; kg m^2 of the rotor
SPAN = (0.8, 0.8)


def rod(stiffness=None, torque_limit=LIMIT, motor=None, gravity=(0.0, 0.0, 0.0), axis=(0, 0, 1)):
    """Return an arm of one rigid rod of 1 m and 3 kg, and its moment of inertia about the joint with the rotor."""
    link = fm.Link.rigid(1.0, 3.0, (0.5, 0.0, 0.0), np.diag([1e-3, 0.25, 0.25]))
    rotor = {} if motor else {"rotor_inertia": INERTIA, "torque_limit": torque_limit}
    arm = fm.Arm([link], [fm.Joint(axis, stiffness=stiffness, motor=motor, **rotor)], gravity=gravity)
    return arm, 0.25 + 3.0 * 0.5**2


def changes():
    """Return the changes of the motor angle of the drawn slews, rad."""
    random = np.random.default_rng(SEED)
    random.uniform(-0.8, 0.8, (SLEWS, 1))
    return np.abs(random.uniform(-0.8, 0.8, (SLEWS, 1))[:, 0])


@pytest.mark.parametrize("stiffness", [None, 1e6])
def test_a_slew_of_a_rigid_rod_has_the_duration_of_the_closed_form(stiffness):
    """The rotor moves with the rod, also behind a stiff spring."""
    arm, inertia = rod(stiffness)
    expected = np.sqrt(PEAK_ACCELERATION * (inertia + INERTIA) * changes() / (0.95 * LIMIT))
    assert arm_facts(arm, [LIMIT], SPAN).durations == pytest.approx(expected, rel=1e-9)


def test_a_motor_speed_bounds_the_duration_of_a_slew():
    motor = fm.Motor(100.0, 0.5, INERTIA / 1e4, current_limit=100.0, speed_limit=50.0)
    arm, _ = rod(motor=motor)
    expected = 1.875 * changes() / (0.85 * 0.5)
    assert arm_facts(arm, [5000.0], SPAN).durations == pytest.approx(expected, rel=1e-9)


def test_a_slew_lasts_at_least_a_period_of_the_first_mode():
    arm, inertia = rod(stiffness=2.0)
    facts = arm_facts(arm, [1000.0], SPAN)
    period = 2.0 * np.pi * np.sqrt(inertia / 2.0)
    assert facts.held == pytest.approx([1.0 / period]) and facts.durations == pytest.approx(period)


def test_a_free_rotor_and_a_rod_have_the_frequency_of_two_masses_and_no_zero_frequency():
    arm, inertia = rod(stiffness=2.0)
    expected = np.sqrt(2.0 / inertia + 2.0 / INERTIA) / (2.0 * np.pi)
    assert arm_facts(arm, [1000.0], SPAN).free == pytest.approx([expected])
    spatial = arm_facts(fm.catalog.gifu_2link(), [1000.0] * 3, SPAN)
    assert np.all(np.array(spatial.free) > 0.999 * np.array(spatial.held)), (
        "no mode is softer with free motors (interlacing)"
    )


def test_the_holding_torque_of_a_level_rod_is_its_weight_times_its_lever():
    arm, _ = rod(gravity=(0.0, 0.0, -9.81), axis=(0, 1, 0), torque_limit=30.0)
    facts = arm_facts(arm, [30.0], SPAN)
    lever = 3.0 * 9.81 * 0.5 * np.cos(facts.postures[0, 0])
    assert facts.holding * 30.0 == pytest.approx([lever], rel=1e-9)


def test_an_arm_that_cannot_hold_its_weight_is_refused_with_a_limit_that_would_do():
    arm, _ = rod(gravity=(0.0, 0.0, -9.81), axis=(0, 1, 0), torque_limit=10.0)
    with pytest.raises(
        ValueError, match=r"arm.joints\[0\].torque_limit: 10.0 is not allowed; give at least (\S+) N m: "
    ) as told:
        gym.make("FlexOne-v0", arm=arm)
    needed = float(str(told.value).split("at least ")[1].split()[0])
    gym.make("FlexOne-v0", arm=rod(gravity=(0.0, 0.0, -9.81), axis=(0, 1, 0), torque_limit=needed)[0]).reset(seed=0)


@pytest.mark.parametrize("scale", [0.1, 10.0])
def test_settings_of_an_arm_whose_times_are_longer_scale_with_them(scale):
    """Stiffness and torque / scale^2: all times are longer by the scale, and so are their rounded values."""
    slow, _ = rod(stiffness=2000.0 / scale**2)
    slow = derived_settings(slow, [50.0 / scale**2], SPAN)
    usual = derived_settings(rod(stiffness=2000.0)[0], [50.0], SPAN)
    assert slow["limits"].rate == pytest.approx(usual["limits"].rate / scale)
    assert slow["limits"].twist == usual["limits"].twist


@pytest.mark.parametrize("rope", [3.0, 5.0])
def test_an_arm_without_motors_has_the_usual_limit_of_rates(rope):
    env = gym.make("FlexGantry-v0", arm={"catalog": "gantry", "rope": rope}).unwrapped
    env.reset(seed=0)
    assert env.configuration.limits.rate == fm.Limits().rate and "limits" in env.configuration.derived


def test_derived_numbers_are_1_2_or_5_times_a_power_of_ten():
    settings = derived_settings(rod(stiffness=300.0)[0], [LIMIT], SPAN)
    limits = settings["limits"]
    for value in (settings["control_period"], settings["horizon"], settings["slew_time"], limits.rate, limits.twist):
        digits = f"{value:.12e}".partition("e")[0].rstrip("0").rstrip(".")
        assert digits in ("1", "2", "5")


@pytest.mark.parametrize(
    "name", ["FlexRRR-v0", "FlexRRR-v0/friction", "FlexRRR-v0/unmodelled", "FlexPlanar-v0/unmodelled"]
)
def test_named_environments_and_their_conditions_keep_their_settings(name):
    found = Configuration.find(name)
    assert not found.derived and found.control_period == Configuration.find(name.partition("/")[0]).control_period
    assert not Configuration.find(name, ["arm.payload.mass=3.0"]).derived
    assert Configuration.from_plain(found.to_plain()) == found


def test_given_settings_stay_and_the_others_follow_from_the_arm():
    arm, _ = rod(stiffness=2.0)
    found = Configuration("FlexOne-v0", {"arm": arm, "control_period": 0.03})
    assert found.control_period == 0.03 and found.derived.keys() == {"horizon", "limits", "slew_time"}
    assert Configuration("FlexOne-v0", {"arm": arm}).control_period != 0.03


def test_a_stored_configuration_has_the_derived_numbers(tmp_path):
    arm, _ = rod(stiffness=2.0)
    own = Configuration("FlexOne-v0", {"arm": arm})
    own.save(tmp_path / "own.yaml")
    read = Configuration.load(tmp_path / "own.yaml")
    assert read == own and not read.derived
    assert (read.control_period, read.horizon, read.limits) == (own.control_period, own.horizon, own.limits)
    assert read.slew_time == own.slew_time


@pytest.mark.parametrize("torque_limit", [LIMIT, 1e-3])
def test_the_horizon_is_four_of_the_longest_slews_and_at_least_5_s(torque_limit):
    arm, _ = rod(torque_limit=torque_limit)
    own = Configuration("FlexOne-v0", {"arm": arm})
    longest = arm_facts(own.arm, own.torque_limit, own.slew_span).durations.max()
    assert max(4.0 * longest, 5.0) <= own.horizon * (1.0 + 1e-6) <= 2.5 * max(4.0 * longest, 5.0)


def test_settings_named_are_those_of_the_named_environment():
    named = Configuration("FlexOne-v0")
    own = Configuration("FlexOne-v0", {"arm": rod(stiffness=2.0)[0], "settings": "named"})
    assert (own.control_period, own.horizon, own.limits) == (named.control_period, named.horizon, named.limits)
    assert own.slew_time == named.slew_time == 3.2


def test_the_slew_time_is_the_nearest_round_number_to_the_median_slew():
    arm, _ = rod(stiffness=300.0)
    own = Configuration("FlexOne-v0", {"arm": arm})
    ratio = own.slew_time / np.median(arm_facts(own.arm, own.torque_limit, own.slew_span).durations)
    assert abs(np.log(ratio)) <= np.log(2.5) / 2.0
    episodes = gym.make("FlexOne-v0", arm=arm).unwrapped.episodes
    assert episodes.view.slew_time == own.slew_time


def test_an_arm_in_place_of_that_of_a_condition_has_its_own_settings():
    found = Configuration(
        "FlexPlanar-v0", {"condition": "friction", "arm": fm.catalog.paper_rrr(), "torque_limit": 400.0}
    )
    assert found.derived


@pytest.mark.feature
def test_a_description_names_the_horizon_that_is_too_short_and_the_joint_that_hardly_holds():
    arm, _ = rod(gravity=(0.0, 0.0, -9.81), axis=(0, 1, 0), torque_limit=15.0)
    told = fm.describe(arm, "FlexOne-v0", horizon=0.3)
    assert any("the horizon is 0.3 s" in each for each in told.warnings)
    assert any(each.startswith("joint 1 holds") for each in told.warnings)
    assert "control_period" in str(told) and not any(
        "horizon" in each for each in fm.describe(arm, "FlexOne-v0").warnings
    )


def test_a_payload_of_a_named_arm_keeps_its_gains_and_other_links_do_not():
    arm = Configuration("FlexRRR-v0").arm
    assert not Configuration("FlexRRR-v0", {"arm": replace(arm, payload=fm.Payload(3.0))}).derived
    longer = replace(arm, links=[replace(arm.links[0], length=arm.links[0].length * 1.1), *arm.links[1:]])
    assert Configuration("FlexRRR-v0", {"arm": longer}).derived
