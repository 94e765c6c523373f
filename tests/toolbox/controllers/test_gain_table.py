"""Table of LQR gains: designs, interpolation and the file in which designs are kept."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.model.model import build_model
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers import gain_table
from flexman_gym.toolbox.controllers.cost_weights import CostWeights
from flexman_gym.toolbox.controllers.gain_table import (
    POSTURE_SPACING,
    GainDesigns,
    GainTable,
    PathGains,
    make_gains,
    spread,
)
from flexman_gym.toolbox.controllers.lqr import LQR

WEIGHTS, PAYLOADS = CostWeights(0.02, 0.1, 0.4), (0.05, 0.1, 0.2)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where the tables of a test are kept."""
    monkeypatch.setattr(gain_table, "find_cache_folder", lambda: str(tmp_path))
    return tmp_path


def small(name):
    """Model, limits and period of a named environment with few coordinates."""
    setup = Configuration.from_keywords({"name": name, "elements": 1, "modes": 1})
    return resolve_fidelity(setup).model, np.array(setup.torque_limit), setup.control_period


def table(name="FlexPlanar-v0", payloads=PAYLOADS, weights=WEIGHTS):
    model, limits, period = small(name)
    return GainTable(GainDesigns(model, limits, period, weights, payloads))


def asked(own, places, arms=None):
    """The gains at places (r, n + 1): postures, then a payload."""
    places = np.array(places)
    return own(np.arange(len(places)) if arms is None else arms, places[:, :-1], places[:, -1])


def designed(name, posture, payload, weights=WEIGHTS):
    model, limits, period = small(name)
    return LQR(varied_model(model, payload_mass=payload), limits, period, weights).gain(posture)


PLACES = [[0.3, -0.2, 0.07], [0.31, -0.1, 0.2], [-0.4, 0.5, 0.13], [0.2, 0.2, 0.05]]


@pytest.mark.parametrize("payload", PAYLOADS)
def test_at_its_places_it_is_the_regulator_of_the_arm_with_that_payload(payload):
    posture = POSTURE_SPACING * np.array([2.0, -3.0])
    expected = designed("FlexPlanar-v0", posture, payload)
    others = [designed("FlexPlanar-v0", posture, each) for each in PAYLOADS if each != payload]
    result = asked(table(), [[*posture, payload]])[0]
    assert result == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert all(np.abs(result - other).max() > 0.01 * np.abs(result).max() for other in others)


def test_between_its_places_it_is_linear_in_every_angle_and_in_the_payload():
    part = np.array([0.3, 0.8, 0.6])
    corners = np.array(list(product((0, 1), repeat=3)))
    weights = np.where(corners, part, 1.0 - part).prod(axis=1)
    lattice = [[POSTURE_SPACING * (a - 2), POSTURE_SPACING * (b + 1), PAYLOADS[1 + p]] for a, b, p in corners]
    place = [POSTURE_SPACING * (part[0] - 2.0), POSTURE_SPACING * (part[1] + 1.0), 0.1 + 0.1 * part[2]]
    own = table()
    expected = np.tensordot(weights, asked(own, lattice), axes=1)
    assert asked(own, [place])[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_beyond_its_payloads_it_is_that_of_the_nearest():
    own = table()
    low, lowest, high, highest = asked(own, [[0.1, 0.2, payload] for payload in (0.0, 0.05, 0.3, 0.2)])
    assert np.array_equal(low, lowest) and np.array_equal(high, highest) and (low != high).any()


def test_with_one_payload_there_is_nothing_between():
    result = asked(table(payloads=(0.1,)), [[0.0, 0.0, payload] for payload in (0.0, 0.1, 0.3)])
    expected = designed("FlexPlanar-v0", np.zeros(2), 0.1)
    for each in result:
        assert each == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_what_was_asked_before_changes_no_bit(folder, monkeypatch):
    """Nor does an arm that comes back, or a file: the last table makes no design of its own."""
    first, backwards = table(), table()
    expected = asked(first, PLACES)
    assert np.array_equal(asked(backwards, PLACES[::-1])[::-1], expected)
    one = [asked(backwards, [place], np.array([0]))[0] for place in PLACES]
    assert np.array_equal(one, expected), "one arm that goes from place to place"
    first.save()
    assert len(list(folder.iterdir())) == 1
    monkeypatch.delattr(CostWeights, "gain")
    assert np.array_equal(asked(table(), PLACES), expected)


@pytest.mark.parametrize("harm", ["cut", "empty", "other", "changed", "of another shape", "of other names"])
def test_a_damaged_file_is_written_anew(harm, folder):
    own = table()
    expected = asked(own, PLACES)
    own.save()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    if harm.startswith("of"):
        names = ("keys", "gains") if harm == "of another shape" else ("a", "b")
        np.savez(file, **dict(zip(names, (np.zeros((2, 3), dtype=int), np.zeros((2, 1, 1))), strict=True)))
    else:
        middle = len(whole) // 2
        spoiled = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
        file.write_bytes({"cut": whole[:middle], "empty": b"", "other": b"gains\n", "changed": spoiled}[harm])
    again = table()
    assert np.array_equal(asked(again, PLACES), expected)
    again.save()
    assert file.read_bytes() == whole and list(folder.iterdir()) == [file]


def test_other_designs_are_kept_apart(folder):
    """Of another payload, other weights and another arm."""
    tables = [table(), table(payloads=(0.05, 0.1, 0.25)), table(weights=WEIGHTS._replace(motor=0.5))]
    for own in [*tables, table(), table("FlexOne-v0", (0.05,))]:
        n = len(own._joints)
        asked(own, [[0.1] * n + [0.05]])
        own.save()
    assert len(list(folder.iterdir())) == 4


def test_without_a_folder_it_keeps_nothing(monkeypatch):
    monkeypatch.setattr(gain_table, "find_cache_folder", lambda: None)
    own = table()
    asked(own, PLACES[:1])
    own.save()


@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexRRR-Gravity-v0"])
def test_a_joint_that_turns_the_arm_about_gravity_has_no_axis(name):
    """The gain there is that of the regulator at any angle of it."""
    posture, turned, payload = POSTURE_SPACING * np.array([0.0, 1.0, -2.0]), [1.3, 0.0, 0.0], 10.0
    weights = CostWeights(0.2, 1.0, 0.5)
    result = asked(table(name, (payload,), weights), [[*posture, payload], [*(posture + turned), payload]])
    assert np.array_equal(*result)
    expected = designed(name, posture + turned, payload, weights)
    assert result[0] == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_a_joint_that_lifts_the_arm_has_one():
    first, turned = asked(table(), [[0.0, 0.5, 0.1], [1.0, 0.5, 0.1]])
    assert np.abs(turned - first).max() > 1e-4 * np.abs(first).max()


def test_gains_are_those_of_motors_that_slide():
    """With the slope of the smoothed friction at rest, motors would look clamped and gains be wrong once they turn."""
    model, limits, period = small("FlexPlanar-v0")
    rubbing = [replace(joint, coulomb_friction=0.5) for joint in model.arm.joints]
    other = build_model(replace(model.arm, joints=rubbing), **vars(model.choice))
    places = [[0.3, -0.6, 0.1], [1.1, 0.2, 0.05]]
    designs = (GainDesigns(each, limits, period, WEIGHTS, PAYLOADS) for each in (model, other))
    plain, sliding = (asked(GainTable(each), places) for each in designs)
    assert np.array_equal(plain, sliding)


ROUTE = np.array([[0.0, 0.1], [0.2, -0.3], [0.4, -0.7]])


def along(route=ROUTE, payloads=PAYLOADS, name="FlexPlanar-v0"):
    """Gains along a path of an arm."""
    model, limits, period = small(name)
    return PathGains(GainDesigns(model, limits, period, WEIGHTS, payloads), lambda arm: route)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_gains_at_the_postures_of_a_path_are_those_of_the_regulator(payload):
    own = along()
    for posture in ROUTE:
        expected = designed("FlexPlanar-v0", posture, payload)
        assert asked(own, [[*posture, payload]])[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert own.at(posture, np.array([payload])) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_gains_along_a_path_are_linear_in_place_and_payload():
    own, part, share = along(), 0.3, 0.6
    ends = asked(own, [[*posture, payload] for posture in ROUTE[1:] for payload in PAYLOADS[:2]])
    weights = np.outer([1.0 - part, part], [1.0 - share, share]).ravel()
    place = [*(ROUTE[1] + part * (ROUTE[2] - ROUTE[1])), PAYLOADS[0] + share * (PAYLOADS[1] - PAYLOADS[0])]
    assert asked(own, [place])[0] == pytest.approx(np.tensordot(weights, ends, axes=1), rel=1e-9, abs=1e-9)


def test_gains_beside_a_path_are_those_of_its_nearest_point():
    """Also at a corner of it, before its start and beyond its end."""
    bent = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]])
    own = along(bent)
    for beside, nearest in (([0.3, -0.1], [0.3, 0.0]), ([0.7, 0.2], [0.5, 0.2]), ([-1.0, 0.1], [0.0, 0.0]),
                            ([0.6, 0.9], [0.5, 0.5]), ([0.6, -0.1], [0.5, 0.0])):  # fmt: skip
        first, second = asked(own, [[*beside, 0.1], [*nearest, 0.1]])
        assert first == pytest.approx(second, rel=1e-9, abs=1e-9), beside


def test_gains_of_a_path_that_stands_still_are_those_of_its_posture():
    for route in (ROUTE[:1], ROUTE[[0, 0, 0]]):
        expected = designed("FlexPlanar-v0", ROUTE[0], 0.1)
        assert asked(along(route), [[0.3, 0.5, 0.1]])[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_gains_along_a_path_do_not_depend_on_the_order_of_the_calls(monkeypatch):
    """To the bit, and with a memory of one gain."""
    first, backwards, forgetful = along(), along(), along()
    expected = asked(first, PLACES)
    assert np.array_equal(asked(backwards, PLACES[::-1])[::-1], expected)
    monkeypatch.setattr(gain_table, "MAX_STORED", 1)
    assert np.array_equal(asked(forgetful, PLACES), expected)


@pytest.mark.parametrize("joints", [4, 5])
def test_gains_of_more_than_four_joints_are_along_paths(joints):
    """A cell of a grid of five joints has 64 corners."""
    link = fm.Link.rigid(0.2, 1.0, (0.1, 0.0, 0.0), np.diag([0.01] * 3).tolist())
    axes = [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)] * 3
    arm = fm.Arm([link] * joints, [fm.Joint(axis, 0.1, stiffness=1e3) for axis in axes[:joints]])
    designs = GainDesigns(fm.build_model(arm, 1), np.ones(joints), 0.01, WEIGHTS, (0.0,))
    gains = make_gains(designs, lambda arm: np.zeros((1, joints)))
    assert isinstance(gains, PathGains if joints == 5 else GainTable)


def test_payloads_of_gains_are_dense_where_an_arm_is_light():
    """Each is twice that before it, so that gains of a light payload are close to those of its regulator."""
    nodes = np.array(spread((1.0, 2.0, 3.0)))
    assert nodes[0] == 1.0 and nodes[-1] == 3.0 and np.diff(np.log2(nodes[1:] - 1.0)) == pytest.approx(np.ones(5))
    assert spread((2.0,)) == (2.0,)
    payload, posture = 0.05, np.zeros(2)
    exact = designed("FlexPlanar-v0", posture, payload)
    coarse, fine = (
        np.abs(asked(table(payloads=nodes), [[*posture, payload]])[0] - exact).max()
        for nodes in ((0.0, 2.0), spread((0.0, 2.0)))
    )
    assert 10.0 * fine < coarse > 0.1 * np.abs(exact).max()
