"""Table of LQR gains: designs, interpolation and the file in which designs are kept."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.model.model import build_model
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers import lqr
from flexman_gym.toolbox.controllers.lqr import LQR, POSTURE_SPACING, CostWeights, GainTable

WEIGHTS, PAYLOADS = CostWeights(0.02, 0.1, 0.4), (0.05, 0.1, 0.2)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where the tables of a test are kept."""
    monkeypatch.setattr(lqr, "find_cache_folder", lambda: str(tmp_path))
    return tmp_path


def small(name):
    """Model, limits and period of a named environment with few coordinates."""
    setup = Configuration.from_keywords({"name": name, "elements": 1, "modes": 1})
    return resolve_fidelity(setup).model, np.array(setup.torque_limit), setup.control_period


def table(name="FlexPlanar-v0", payloads=PAYLOADS, weights=WEIGHTS):
    model, limits, period = small(name)
    return GainTable(model, limits, period, weights, payloads)


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
    monkeypatch.delattr(lqr.CostWeights, "gain")
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
    monkeypatch.setattr(lqr, "find_cache_folder", lambda: None)
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
    plain, sliding = (asked(GainTable(each, limits, period, WEIGHTS, PAYLOADS), places) for each in (model, other))
    assert np.array_equal(plain, sliding)
