"""Diagnosis: causes that were planted are named, and shares of made-up errors are those that went in."""

from types import SimpleNamespace

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.controllers.excited_modes import excited_modes
from flexman_gym.toolbox.controllers.margins import margins, sampled_loops
from flexman_gym.toolbox.diagnosis import diagnosis
from flexman_gym.toolbox.diagnosis.diagnosis import (
    CYCLE,
    FAILED,
    NOISE,
    OFFSET,
    REMEDIES,
    RINGING,
    TRAINING_REMEDIES,
    TRANSIENT,
    diagnose,
)

PERIOD, COUNT = 0.01, 300
TIME = PERIOD * np.arange(COUNT)
MODES = {"mode 1, motors held": 2.0, "mode 1, motors free": 5.0}
STAY = {"kind": "slew", "start": 0.5, "slew": 1e-6}  # an arm that starts at its goal, so that nothing else is left
FLAT = {"catalog": "vertical_2r", "gravity": [0, 0, 0]}
STIFF = {"kind": "pd", "stiffness": [60.0, 20.0], "damping": [5.0, 2.0]}


def ending(errors, actions=None, feed=0.0, loss=1.0):
    """An episode's end with errors (T,) along x, actions (T,), motors that feed so many W at 2 Hz, and a loss in W."""
    actions = np.zeros(COUNT) if actions is None else actions
    swing = np.sqrt(2.0) * np.sin(2.0 * np.pi * 2.0 * TIME)
    three = np.stack([errors, np.zeros(COUNT), np.zeros(COUNT)], axis=1)
    signals = {"torques": feed * swing[:, None], "rates": swing[:, None], "loss": loss * TIME}
    own = {"actions": actions[:, None], "period": PERIOD, "band": 0.02, "failure": ""}
    return SimpleNamespace(errors=three, **signals, **own)


def tone(frequency, size=1.0, phase=0.3):
    """A sinusoid of a root mean square."""
    return size * np.sqrt(2.0) * np.sin(2.0 * np.pi * frequency * TIME + phase)


def test_shares_are_those_that_went_in_and_add_up_to_one():
    random = np.random.default_rng(0).standard_normal(COUNT)
    found = diagnosis._split_error(ending(3.0 + tone(2.0, 2.0) + tone(7.0, 1.5) + random, tone(2.0)), MODES)
    whole = 9.0 + 4.0 + 2.25 + 1.0
    assert sum(found.shares.values()) == pytest.approx(1.0) and found.rms == pytest.approx(np.sqrt(whole), rel=0.03)
    assert [found.shares[each] for each in (OFFSET, RINGING, NOISE)] == pytest.approx(
        [9.0 / whole, 6.25 / whole, 1.0 / whole], abs=0.02
    )
    assert [each[0] for each in found.tones] == pytest.approx([2.0, 7.0], abs=0.05)
    assert [each[3] for each in found.tones] == ["mode 1, motors held", ""]


def test_ringing_that_dies_away_is_one_tone():
    found = diagnosis._split_error(ending(np.exp(-0.5 * TIME) * tone(1.7)), MODES)
    assert found.cause == RINGING and found.shares[RINGING] > 0.95
    assert found.tones[0][1] > 0.95 and found.tones[0][3] == "mode 1, motors held", "motors that yield lower a mode"


def test_who_feeds_in_the_rhythm_of_the_tone_keeps_it_up():
    """The same motion: fed, unfed, braked, and with actions of another rhythm."""
    moved, own, other = tone(2.0), tone(2.0, 0.1), tone(9.0, 0.1)
    for actions, feed, cause in ((own, 1.0, CYCLE), (own, 0.2, RINGING), (own, -1.0, RINGING), (other, 1.0, NOISE)):
        found = diagnosis._split_error(ending(moved, actions, feed), MODES)
        assert found.cause == cause and found.shares[cause] > 0.95, (feed, cause)
    assert diagnosis._split_error(ending(moved, own, 1.0, loss=10.0), MODES).cause == RINGING, (
        "what feeds little keeps nothing up"
    )


def test_a_slow_motion_that_has_not_ended_is_a_transient():
    assert diagnosis._split_error(ending(tone(0.6)), MODES).cause == TRANSIENT
    assert diagnosis._split_error(ending(tone(0.6)), {"mode 1, motors held": 0.7}).cause == RINGING
    assert diagnosis._split_error(ending(tone(0.9)), MODES).cause == RINGING, "the record holds more than two cycles"
    assert diagnosis._split_error(ending(np.linspace(1.0, 0.2, COUNT)), {}).shares[TRANSIENT] == pytest.approx(1.0)
    assert diagnosis._split_error(ending(5.0 + np.linspace(1.0, 0.2, COUNT)), {}).cause == OFFSET


def test_an_end_that_is_short_or_still_has_no_tones():
    for length in (1, 20):
        end = vars(ending(tone(2.0))).items()
        cut = {name: values[:length] if isinstance(values, np.ndarray) else values for name, values in end}
        brief = diagnosis._split_error(SimpleNamespace(**cut), MODES)
        assert brief.tones == () and sum(brief.shares.values()) == pytest.approx(1.0)
    still = diagnosis._split_error(ending(np.zeros(COUNT)), MODES)
    assert still.rms == 0.0 and still.negligible and not diagnosis._split_error(ending(tone(2.0)), MODES).negligible


def test_torques_that_stay_are_no_noise():
    """However they are rounded."""
    for held in (0.1, 0.3, 0.7, 0.9):
        assert diagnosis._split_error(ending(tone(2.0), np.full(COUNT, held)), MODES).cause == RINGING


def test_what_is_watched_is_what_happened():
    """Errors to the target, the work of the motors by torques and rates, losses, and the modes at the goal."""
    ledger, environment = [], Configuration("FlexPlanar-v0", {"horizon": 3.4, "randomisation": {"delay": [0, 2]}})
    soft = {"kind": "pd", "stiffness": [20.0, 8.0], "damping": [2.0, 0.5]}
    result = rollout(soft, environment, [7, 8], lambda episodes: ledger.append(
        (episodes.batch.rows[:, -2:].copy(), episodes.view.goal_angles.copy(), episodes.batch.model)))  # fmt: skip
    for arm, (end, modes) in enumerate(diagnosis._episode_ends(soft, environment, [7, 8])):
        assert len(end.errors) == 300 == len(end.actions) and end.actions == pytest.approx(result.actions[arm, 40:])
        assert np.linalg.norm(end.errors, axis=1) == pytest.approx(result.errors[arm, 41:])
        work, loss = np.array([row[0][arm] for row in ledger[40:]]).T
        assert np.cumsum(PERIOD * np.sum(end.torques * end.rates, axis=1)) == pytest.approx(
            work[1:] - work[0], abs=1e-6
        )
        assert end.loss == pytest.approx(loss[1:]) and np.ptp(work) > 1e-4 < np.ptp(loss)
        held = excited_modes(ledger[0][2], ledger[0][1][arm])
        assert modes["mode 1, motors held"] == pytest.approx(held[0, 0])


def test_the_energy_that_a_log_dissipates_is_that_of_its_simulation(monkeypatch):
    """Without Coulomb friction, up to the error of a sum over the control periods."""
    soft, environment = (
        {"kind": "pd", "stiffness": [20.0, 8.0], "damping": [2.0, 0.5]},
        Configuration("FlexPlanar-v0", {"horizon": 3.4}),
    )
    ((simulated, _),) = diagnosis._episode_ends(soft, environment, [7])
    found, split = [], diagnosis._split_error
    monkeypatch.setattr(diagnosis, "_split_error", lambda end, modes: (found.append(end), split(end, modes))[1])
    diagnosis.diagnose_log(rollout(soft, environment, [7]).episode(0))
    (logged,) = found
    assert np.ptp(logged.loss) == pytest.approx(np.ptp(simulated.loss), rel=0.02) and np.ptp(simulated.loss) > 1e-4


def unstable(scale, stiffness, damping):
    """A PD with its torques beyond the gain that the arm bears with a delay of one period."""
    setup = Configuration("FlexPlanar-v0", {"arm": FLAT})
    loops = [
        sampled_loops(resolve_fidelity(setup).model, [0.2, each], setup.control_period, 1)[0]
        for each in (-0.5, 0.0, 0.5)
    ]
    gain = scale * margins(loops, stiffness, damping).gain
    assert gain > scale
    return {
        "kind": "pd",
        "stiffness": [gain * each for each in stiffness],
        "damping": [gain * each for each in damping],
    }


def planted():
    """Cause, who acts, what is changed of the arm, and seeds: fifty episodes."""
    bend, late = {"initial_vibration": [0.005, 0.02]}, {"delay": [1, 1], "initial_vibration": [0.001, 0.001]}
    weak = {**STIFF, "damping": [2.0, 0.8]}
    biased = {"sensors": {"kind": "motor_encoders", "bias": 0.005}, "horizon": 8.0}
    noisy = {"randomisation": {"sensor_noise": [0.002, 0.002]}}
    return [
        (RINGING, STIFF, {"randomisation": bend, "horizon": 4.0}, range(100, 107)),
        (RINGING, weak, {"randomisation": bend, "horizon": 4.0}, range(107, 113)),
        (CYCLE, unstable(1.3, [20.0, 8.0], [3.0, 0.6]), {"arm": FLAT, "randomisation": late}, range(200, 206)),
        (CYCLE, unstable(1.3, [40.0, 10.0], [4.0, 1.3]), {"arm": FLAT, "randomisation": late}, range(206, 212)),
        (OFFSET, STIFF, {"randomisation": {"payload_mass": [0.15, 0.2]}, "horizon": 8.0}, range(300, 307)),
        (OFFSET, STIFF, biased, range(307, 313)),
        (NOISE, STIFF, noisy, range(400, 406)),
        (NOISE, {**STIFF, "stiffness": [120.0, 40.0]}, noisy, range(406, 412)),
    ]  # fmt: skip


@pytest.mark.slow
def test_a_failed_episode_is_one():
    """Without torques an arm falls to its limits; what its error was at that time has no other cause."""
    found = diagnose("zero", "FlexPlanar-v0", range(9000, 9004))
    failures = rollout("zero", "FlexPlanar-v0", range(9000, 9004)).failures
    assert [each.failure for each in found] == list(failures) and any(failures)
    for each in found:
        assert (each.cause == FAILED) == bool(each.failure) and sum(each.shares.values()) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "acts"), [("FlexPlanar-v0", "lqg"), ("FlexOne-v0", "pd"), ("FlexRRR-v0", "pd")])
def test_noise_of_one_percent_is_no_offset(name, acts):
    """An arm that starts at its goal stays there without noise, so that noise is the whole cause."""
    noisy = {"task": {**STAY, "start": 0.0}, "randomisation": {"sensor_noise": [0.01, 0.01]}, "horizon": 6.0}
    for found in diagnose(acts, Configuration(name, noisy), [400, 401]):
        assert found.cause == NOISE and found.shares[NOISE] > 0.9


@pytest.mark.slow
def test_an_offset_stays_one_beside_noise():
    changes = {
        "task": STAY,
        "horizon": 8.0,
        "randomisation": {"payload_mass": [0.2, 0.2], "sensor_noise": [5e-4, 5e-4]},
    }
    for found in diagnose(STIFF, Configuration("FlexPlanar-v0", changes), [300, 301]):
        assert found.cause == OFFSET and sum(found.shares.values()) == pytest.approx(1.0)


def test_a_slow_sway_is_no_offset():
    """A motor that is held by a soft spring and hardly damped sways far slower than the link bends."""
    soft = {"kind": "pd", "stiffness": [0.05], "damping": [0.02]}
    environment = Configuration("FlexOne-v0", {"horizon": 40.0})
    ((end, modes),) = diagnosis._episode_ends(soft, environment, [9001])
    found = diagnosis._split_error(end, modes)
    frequency = found.tones[0][0]
    assert not found.negligible and frequency < 0.2 * min(modes.values())
    assert found.cause in (RINGING, CYCLE) and found.shares[OFFSET] < 0.1


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:PD.damping:UserWarning")
def test_of_fifty_planted_causes_at_least_45_are_named():
    right = total = 0
    for cause, acts, changes, seeds in planted():
        environment = Configuration("FlexPlanar-v0", {"task": STAY, "horizon": 5.0, **changes})
        found = [each.cause for each in diagnose(acts, environment, seeds)]
        right, total = right + found.count(cause), total + len(found)
    assert total == 50 and right >= 45, right


def test_ringing_is_named_after_the_mode_that_was_bent():
    """Motors held stiffly, without gravity: the tone is the first mode of the arm at its goal."""
    environment = Configuration(
        "FlexPlanar-v0",
        {"arm": FLAT, "task": {**STAY, "start": 0.0}, "horizon": 4.0, "control_period": 0.002,
         "randomisation": {"initial_vibration": [0.01, 0.01]}},
    )  # fmt: skip
    stiff = {"kind": "pd", "stiffness": [3000.0, 1500.0], "damping": [40.0, 15.0]}
    (found,) = diagnose(stiff, environment, [5])
    frequency, _, cause, name = found.tones[0]
    held = excited_modes(resolve_fidelity(environment).model, [0.0, 0.0])[0, 0]
    assert (cause, name) == (RINGING, "mode 1, motors held") and frequency == pytest.approx(held, rel=0.05)


def test_every_cause_has_a_remedy():
    for remedies in (REMEDIES, TRAINING_REMEDIES):
        assert set(remedies) == {RINGING, CYCLE, OFFSET, TRANSIENT, NOISE, FAILED} and all(remedies.values())
