"""Estimator: it finds what is unknown of arms that a test knows, is as sure of it as it may be, and notices changes."""

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.model.linearization import LINEAR_SENSORS
from flexman_gym.model.statics import rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import UNCERTAIN
from flexman_gym.toolbox.controllers.observers.estimator import Estimator
from flexman_gym.toolbox.controllers.observers.observer import MAX_LOST

from oracles.observed_arms import Bench, drawn_parameters, pushes, small_plant

pytestmark = pytest.mark.slow

UNKNOWN = {"payload_mass": (0.0, 0.3), "joint_stiffness_factor": (0.7, 1.3), "link_stiffness_factor": (0.7, 1.3)}
PLANAR = {"payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3), "link_stiffness_factor": (0.7, 1.3)}
NOISE = 1e-3


def plant_of(name="FlexOne-v0", noise=NOISE, **more):
    return small_plant(name, {**(UNKNOWN if name == "FlexOne-v0" else PLANAR), **more, "sensor_noise": (noise, noise)})


def bench_of(plant, arms, seed=0, **more):
    """Arms that are drawn as the plant says."""
    random = np.random.default_rng(seed)
    n = plant.model.n_joints
    parameters = drawn_parameters(plant, arms, random)
    bench = Bench(plant, random.uniform(-0.8, 0.8, (arms, n)), parameters, seed=seed, **more)
    return bench, parameters, random


def relative_errors(plant, estimate, parameters):
    """Largest error of each parameter, as a part of its range."""
    result = {}
    for key, (low, high) in plant.unknown.items():
        name = UNCERTAIN[key]
        scale = (high - low) * (1.0 if name == "payload_mass" else plant.model.constants.joint_stiffness)
        scale = high - low if name == "link_stiffness_factor" else scale
        result[name] = np.abs((estimate.parameters[name] - parameters[name]) / scale).max()
    return result


@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-v0"])
def test_without_noise_it_comes_to_the_truth(name):
    """Exact instruments, believed to 1e-4 of their ranges: parameters and states of all arms."""
    plant = plant_of(name, noise=0.0)
    bench, parameters, random = bench_of(plant, 4)
    estimates = bench.follow(Estimator(plant), pushes(random, 66, 4, plant.model.n_joints))
    errors = relative_errors(plant, estimates[-1], parameters)
    assert max(errors.values()) < 1e-5, errors
    speeds = np.abs(bench.batch.state).max()
    assert np.abs(estimates[-1].states - bench.batch.state).max() < 1e-6 * speeds
    assert estimates[0].states == pytest.approx(rest_state(plant.model, bench.start)), (
        "at first they are where they say"
    )


def test_delays_are_found_and_states_are_those_in_which_torques_begin_to_act():
    plant = plant_of(delay=(0, 2))
    delays = np.array([0, 1, 2, 0, 1, 2])
    bench, parameters, random = bench_of(plant, 6, delays=delays)
    actions = pushes(random, 46, 6, 1, held=4)
    observer = Estimator(plant)
    estimates = bench.follow(observer, actions)
    assert estimates[-1].lead.tolist() == observer.delays.tolist() == delays.tolist()
    assert estimates[8].lead.tolist() == delays.tolist(), "after the first replay"
    said = estimates[-1].states
    for lead in range(2):  # what is asked for now acts on none of the arms before its lead is over
        assert said[delays == lead] == pytest.approx(bench.batch.state[delays == lead], abs=1e-3)
        bench.step(np.zeros((6, 1)))
    assert said[delays == 2] == pytest.approx(bench.batch.state[delays == 2], abs=1e-3)
    assert max(relative_errors(plant, estimates[-1], parameters).values()) < 1e-3


@pytest.mark.parametrize("delay", [1, 2])
def test_a_delay_that_is_known_is_the_delay(delay):
    plant = plant_of(delay=(delay, delay))
    bench, parameters, random = bench_of(plant, 3, delays=delay)
    estimate = bench.follow(Estimator(plant), pushes(random, 46, 3, 1, held=4))[-1]
    assert estimate.lead.tolist() == [delay] * 3
    assert max(relative_errors(plant, estimate, parameters).values()) < 1e-3


def normalised_errors(observer, plant, parameters):
    """Errors of the numbers (b, p) of the arms' parameters, in the standard deviations that the observer has."""
    numbers = observer.theta + observer._change
    known = len(observer.uncertain.names)
    columns = []
    for i, name in enumerate(observer.uncertain.names):
        values = parameters[name] if parameters[name].ndim == 1 else parameters[name][:, observer.uncertain.joints[i]]
        columns.append(numbers[:, i] - values / observer.uncertain.scales[i])
    covariance = np.linalg.inv(observer._information)[:, :known, :known]
    return np.array(columns).T, covariance


@pytest.mark.parametrize(("name", "periods"), [("FlexOne-v0", 30), ("FlexOne-v0", 72), ("FlexPlanar-v0", 34)])
def test_it_is_as_sure_as_it_may_be(name, periods):
    """Of 60 arms drawn from the prior, with noise: squares of whitened errors have mean 1, at and after a replay.

    The mean of 60 x 3 squares has a standard deviation of 0.105. The misfit, of some tens of readings, is about 1.
    """
    plant = plant_of(name)
    bench, parameters, random = bench_of(plant, 60, seed=3, noise=1.0)
    observer = Estimator(plant)
    bench.follow(observer, pushes(random, periods, 60, plant.model.n_joints))
    assert not observer._filtering.any(), "no false alarm"
    errors, covariance = normalised_errors(observer, plant, parameters)
    squares = np.einsum("bi,bij,bj->b", errors, np.linalg.inv(covariance), errors)
    assert squares.mean() / errors.shape[1] == pytest.approx(1.0, abs=0.3)
    assert observer.estimates["misfit"].mean() == pytest.approx(1.0, abs=0.1)
    prior = observer.uncertain.deviation
    deviations = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert (deviations < 0.5 * prior).all(), "it has learned"


def test_more_readings_make_it_surer():
    """Over the periods between two replays, of what stays: information grows by what each reading says, once."""
    plant = plant_of()
    bench, _, random = bench_of(plant, 2, seed=1, noise=1.0)
    observer = Estimator(plant)
    bench.follow(observer, pushes(random, 45, 2, 1))
    whole = observer._information.copy()
    sweep_information = whole - np.eye(4) / observer._prior.deviation**2
    assert np.linalg.eigvalsh(sweep_information).min() > -1e-3 * np.abs(whole).max()
    before = whole
    for action in pushes(random, 3, 2, 1):
        bench.step(action)
        observer.estimate(bench.readings(), bench.applied, np.ones(2, dtype=bool))
        slopes = observer._models.measurement_jacobian(observer._states, observer._steps, observer.theta)
        added = observer._information - before
        expected = slopes.transpose(0, 2, 1) @ (slopes * (observer._instruments.deviations**-2.0)[:, None])
        if (observer._ages[0] - 1) % 5:
            assert added == pytest.approx(expected, rel=1e-9)
        before = observer._information.copy()


def test_a_reading_of_the_wrong_sign_does_not_pass_unnoticed():
    """Nor does one that is late: the misfit says that the arm is not the one that is simulated."""
    plant = plant_of()
    bench, _, random = bench_of(plant, 2, noise=1.0)
    given = bench.readings
    bench.readings = lambda: {**given(), "root_strains": -given()["root_strains"]}
    observer = Estimator(plant)
    bench.follow(observer, pushes(random, 28, 2, 1))
    assert (observer.estimates["misfit"] > 2.0).all()


def test_a_payload_that_changes_on_the_way_is_noticed_and_found():
    plant = plant_of()
    bench, parameters, random = bench_of(plant, 2, noise=1.0)
    bench.batch.vary(np.arange(2), **parameters | {"payload_mass": np.array([0.05, 0.05])})
    observer = Estimator(plant)
    estimates = bench.follow(observer, pushes(random, 50, 2, 1))
    assert np.abs(estimates[-1].parameters["payload_mass"] - 0.05).max() < 0.02
    bench.batch.vary(
        np.array([1]), **{name: each[1:] for name, each in parameters.items()} | {"payload_mass": np.array([0.25])}
    )
    estimates = bench.follow(observer, pushes(random, 110, 2, 1), begin=False)
    changed = [estimate.parameters["payload_mass"] for estimate in estimates]
    assert changed[-1] == pytest.approx([0.05, 0.25], abs=0.02)
    assert observer._filtering.tolist() == [False, True]
    assert np.abs(estimates[-1].states - bench.batch.state)[:, :2].max() < 0.02


def test_a_force_that_nobody_tells_is_borne():
    """A filter takes the place of the fit; the state stays where it is, though the fit would leave it."""
    plant = plant_of("FlexPlanar-v0", tip_load=(0.0, 1.0))
    bench, _, random = bench_of(plant, 2, noise=1.0)
    observer = Estimator(plant)
    assert plant.tip_force == 1.0
    actions = 0.5 * pushes(random, 60, 2, 2)
    bench.force = np.array([0.7, 0.0, -0.7])
    estimates = bench.follow(observer, actions)
    assert observer._filtering.all()
    error = np.abs(estimates[-1].states - bench.batch.state)
    assert error[:, :4].max() < 0.02 and (observer.estimates["misfit"] < 3.0).all()


def test_an_arm_whose_trials_are_lost_begins_anew():
    """A simulation that went wrong says nothing; the arm is followed again from where it is."""
    plant = plant_of()
    bench, _, random = bench_of(plant, 2, noise=1.0)
    observer = Estimator(plant)
    bench.follow(observer, pushes(random, 35, 2, 1))
    observer._states[0] = np.nan
    estimates = bench.follow(observer, pushes(random, 70, 2, 1), begin=False)
    assert np.isfinite(observer.estimates["misfit"]).all() and (observer.estimates["misfit"] < 20.0).all()
    assert np.abs(estimates[-1].states - bench.batch.state)[:, :2].max() < 0.02


def test_an_arm_that_begins_anew_is_never_simulated_from_a_start_that_it_has_left(monkeypatch):
    plant = plant_of()
    bench, _, random = bench_of(plant, 1, noise=1.0)
    observer = Estimator(plant)
    bench.follow(observer, pushes(random, 32, 1, 1))
    monkeypatch.setattr(observer, "_start_filter", lambda arms, sudden: np.zeros(len(arms), dtype=bool))
    observer._restart_after_change(np.array([0]))
    monkeypatch.setattr(observer, "_refit", lambda *_: pytest.fail("a replay"))
    estimates = bench.follow(observer, pushes(random, 20, 1, 1), begin=False)
    assert np.abs(estimates[-1].states - bench.batch.state)[:, :2].max() < 0.05


def test_encoders_that_are_off_are_found_out():
    """Biases of all readings of up to 0.5 % of their ranges; the start is taken as it was told."""
    plant = plant_of()
    ranges = {name: values[0] for name, values in plant.measured().items()}
    names = ("motor_angles", "motor_rates", "joint_twists", "joint_twist_rates", "root_strains")
    signs = np.random.default_rng(4)
    biases = {name: 0.004 * signs.uniform(-1.0, 1.0, len(ranges[name])) * ranges[name] for name in names}
    bench, parameters, random = bench_of(plant, 3, noise=1.0, biases=biases)
    actions = pushes(random, 66, 3, 1)
    observer = Estimator(plant, biased=True)
    estimate = bench.follow(observer, actions)[-1]
    found = observer.theta[:, observer._models.dynamic :] + observer._change[:, observer._models.dynamic :]
    size = np.concatenate([ranges[name] for name in names])
    true = np.concatenate([biases[name] for name in names])
    assert np.abs((found - true) / size).max() < 1e-3
    assert np.abs(estimate.parameters["payload_mass"] - parameters["payload_mass"]).max() < 0.03
    assert (observer.estimates["misfit"] < 1.3).all()
    bench, _, random = bench_of(plant, 3, noise=1.0, biases=biases)
    plain = Estimator(plant)
    bench.follow(plain, actions[:25])
    assert (plain.estimates["misfit"] > 1.3).all(), "one that knows of no biases sees that something is wrong"


WIDE = {
    "joint_stiffness_factor": (0.5, 1.5), "link_stiffness_factor": (0.5, 1.5), "delay": (0, 3),
    "viscous_friction_factor": (0.0, 1.5), "coulomb_friction_factor": (0.0, 1.5), "sensor_bias": (-0.003, 0.003),
    "gauge_gain_factor": (0.98, 1.02),
}  # fmt: skip
RUBBING = Configuration.find("FlexPlanar-v0/friction").arm


def uncertain_bench(arms, seed=0, **more):
    """Planar arms of which everything is drawn, with biases and gain errors; plant, bench, errors of sensors."""
    plant = small_plant("FlexPlanar-v0", {"payload_mass": (0.0, 0.25), "sensor_noise": (NOISE, NOISE), **WIDE},
                        arm=RUBBING)  # fmt: skip
    ranges, random = {name: each[0] for name, each in plant.measured().items()}, np.random.default_rng([1, seed])
    names = ("motor_angles", "motor_rates", "joint_twists", "joint_twist_rates", "root_strains")
    biases = {name: 0.003 * random.uniform(-1.0, 1.0, len(ranges[name])) * ranges[name] for name in names}
    gains = random.uniform(0.98, 1.02, len(ranges["root_strains"]))
    bench, parameters, random = bench_of(plant, arms, seed, noise=1.0, delays=np.arange(arms) % 4, biases=biases,
                                         **more)  # fmt: skip
    read = bench.read.measure
    bench.read.measure = lambda states: (exact := read(states)) | {"root_strains": gains * exact["root_strains"]}
    return plant, bench, parameters, random, np.concatenate([np.concatenate(list(biases.values())), gains - 1.0])


def test_everything_that_is_drawn_is_found():
    """Delays, from the first fits on; friction; biases and gain errors of the gauges within their deviations."""
    plant, bench, parameters, random, errors = uncertain_bench(12)
    observer = Estimator(plant)
    actions = pushes(random, 92, 12, 2)
    assert bench.follow(observer, actions[:22])[-1].lead.tolist() == bench.delays.tolist()
    estimate = bench.follow(observer, actions[22:], begin=False)[-1]
    assert estimate.lead.tolist() == bench.delays.tolist()
    assert not observer._filtering.any() and observer.estimates["misfit"].mean() == pytest.approx(1.0, abs=0.15)
    assert max(relative_errors(plant, estimate, parameters)[name] for name in ("payload_mass",)) < 0.02
    friction = estimate.parameters["coulomb_friction"] - parameters["coulomb_friction"]
    assert np.abs(friction / plant.model.constants.coulomb_friction).mean() < 0.1
    found = (observer.theta + observer._change)[:, observer._models.dynamic :]
    deviations = np.sqrt(np.diagonal(np.linalg.inv(observer._information), axis1=1, axis2=2))
    own = (found - errors) / deviations[:, observer._models.dynamic :]
    assert (own**2).mean() == pytest.approx(1.0, abs=0.35) and np.abs(own).max() < 6.0
    encoders = observer._instruments.places["motor_rates"]
    known = deviations[:, observer._models.dynamic :][:, encoders] / observer._instruments.biases[encoders]
    assert (known < 0.3).all(), "it has learned"


class Lossy:
    """Readings of a bench of which a share of the samples is lost, each sensor for itself."""

    def __init__(self, bench, share, seed=0):
        self.true, self.random, self.share, self.held, self.lost = (
            bench.readings,
            np.random.default_rng(seed),
            share,
            {},
            [],
        )

    def __call__(self):
        new, lost = self.true(), []
        for names in LINEAR_SENSORS.values():
            gone = (self.random.uniform(size=len(new["state"])) < self.share) & bool(self.held)
            for name in names:
                new[name] = np.where(gone[:, None], self.held.get(name, new[name]), new[name])
            lost.append(gone)
        self.held = dict(new)
        self.lost.append(np.array(lost).T)
        return new


def test_lost_samples_have_no_weight():
    """A lost sample of a moving arm is recognised, no other is, and the misfit stays that of the noise."""
    plant = plant_of("FlexPlanar-v0")
    bench, parameters, random = bench_of(plant, 8, noise=1.0)
    lossy = bench.readings = Lossy(bench, 0.1)
    observer = Estimator(plant)
    estimate = bench.follow(observer, pushes(random, 70, 8, 2))[-1]
    lost = np.array(lossy.lost).transpose(1, 0, 2)  # (b, T, sensors)
    found = observer._history.lost[:, : lost.shape[1]][:, :, observer._instruments._firsts]
    assert not (found & ~lost).any()
    moved = np.abs(np.diff(observer._history.readings[:, :71], axis=1)).max(axis=2) > 0.0
    assert found[:, 10:].sum() >= 0.9 * lost[:, 10:].sum() > 100 and moved.any()
    assert not observer._filtering.any() and observer.estimates["misfit"].mean() == pytest.approx(1.0, abs=0.15)
    assert relative_errors(plant, estimate, parameters)["payload_mass"] < 0.02


def test_a_repeated_sample_of_an_arm_at_rest_is_not_lost():
    """Quantised encoders repeat their numbers where the arm rests, also where the model moves and the arm sticks."""
    plant = plant_of("FlexPlanar-v0")
    bench, _, _ = bench_of(plant, 2)
    true, steps = bench.readings, {name: each[1] for name, each in plant.measured().items()}
    bench.readings = lambda: {
        name: np.round(each / steps[name]) * steps[name] for name, each in true().items() if name in steps
    }
    observer = Estimator(plant)
    bench.follow(observer, np.zeros((30, 2, 2)))
    assert not observer._history.lost.any()
    instruments = observer._instruments
    now, change = np.ones((1, len(instruments.ranges))), 5.0 * instruments.deviations[None]
    repeats = np.zeros(now.shape, dtype=np.int64)
    for period in range(6):
        lost, repeats = instruments.lost(now, now, change, repeats)
        assert lost.all() == lost.any() == (period < MAX_LOST)
    almost = now.copy()
    almost[0, 0] += 1e-9
    lost, repeats = instruments.lost(almost, now, change, np.zeros_like(repeats))
    assert not lost[0, : 2 * 2].any() and lost[0, 2 * 2 :].all(), "all numbers of a sensor, or none is lost"


def test_friction_is_estimated_wherever_a_model_has_some():
    rubbing = small_plant("FlexPlanar-v0", {"sensor_noise": (NOISE, NOISE)}, arm=RUBBING)
    names = Estimator(rubbing).uncertain.names
    assert names.count("coulomb_friction") == names.count("viscous_friction") == 2
    assert "coulomb_friction" not in Estimator(plant_of("FlexPlanar-v0")).uncertain.names
    assert Estimator(rubbing, unknown={"payload_mass": (0.0, 1.0)}).uncertain.names == ("payload_mass",)


def test_an_arm_outside_the_ranges_is_found_too():
    """Joints a quarter of the range, and a payload a fifth of the range beyond what the plant names."""
    plant = plant_of()
    parameters = {
        "payload_mass": np.array([0.36]),
        "joint_stiffness": 1.45 * plant.model.constants.joint_stiffness[None],
    }
    bench, random = Bench(plant, [[0.3]], parameters, noise=1.0), np.random.default_rng(5)
    observer = Estimator(plant)
    estimate = bench.follow(observer, pushes(random, 70, 1, 1))[-1]
    assert estimate.parameters["payload_mass"] == pytest.approx(0.36, abs=0.01)
    assert estimate.parameters["joint_stiffness"] / parameters["joint_stiffness"] == pytest.approx(1.0, abs=0.02)
    assert observer.consistent.all()


def test_arms_that_begin_at_different_times_do_not_touch_each_other():
    """The second begins 9 periods after the first; each gets what it gets alone, to the bit."""
    plant = plant_of(delay=(0, 1))

    def run(seeds, begins):
        observer, result = Estimator(plant), []
        benches = [bench_of(plant, 1, seed=seed, noise=1.0, delays=seed % 2) for seed in seeds]
        pushed = [pushes(random, 40, 1, 1) for *_, random in benches]
        for period in range(40):
            fresh = np.flatnonzero(np.array(begins) == period)
            if period == 0 or len(fresh):
                arms = np.arange(len(seeds)) if period == 0 else fresh
                start = np.concatenate([benches[arm][0].start for arm in arms])
                observer.reset(arms, benches[0][0].episode().__class__(start, start, plant.period), len(arms))
            active = np.array(begins) <= period
            each = [bench.readings() for bench, *_ in benches]
            readings = {name: np.concatenate([one[name] for one in each]) for name in each[0]}
            applied = np.concatenate([bench.applied for bench, *_ in benches])
            result.append(observer.estimate(readings, applied, active))
            for arm in np.flatnonzero(active):
                benches[arm][0].step(pushed[arm][period - begins[arm]])
        return result

    both, first = run([0, 1], [0, 9]), run([0], [0])
    for one, other in zip(both, first, strict=True):
        assert np.array_equal(one.states[0], other.states[0]) and one.lead[0] == other.lead[0]
        names = [UNCERTAIN[name] for name in plant.unknown]
        assert all(np.array_equal(one.parameters[name][0], other.parameters[name][0]) for name in names)


def test_trials_that_part_are_drawn_together_and_their_steps_with_them():
    """Slopes stay what they are when trials are drawn together; the arm as it is estimated stays where it is."""
    plant = plant_of("FlexPlanar-v0")
    bench, _, random = bench_of(plant, 2, noise=1.0)
    observer = Estimator(plant)
    bench.follow(observer, pushes(random, 10, 2, 2))
    motors, some = plant.model.motor_columns, np.arange(2)
    observer._states[1, 2, motors] += 3.0
    before, steps = observer._states.copy(), observer._steps.copy()
    slopes = observer._models.jacobian(before, steps)
    observer._reduce_perturbations(some)
    assert np.array_equal(observer._states[:, 0], before[:, 0]) and observer._perturbations_reduced.tolist() == [
        False,
        True,
    ]
    assert observer._models.jacobian(observer._states, observer._steps) == pytest.approx(slopes, rel=1e-6, abs=1e-6)
    assert observer._steps[1, 1] < 0.3 * steps[1, 1]
    spread = np.abs(observer._states[:, 1:, motors] - observer._states[:, :1, motors]).max()
    assert spread <= 0.5 * (1.0 + 1e-9)


def test_its_trials_have_the_numbers_that_it_says():
    """After a shift the trials move as arms with those numbers, one changed each by its step."""
    plant = plant_of("FlexPlanar-v0")
    bench, _, random = bench_of(plant, 2, noise=1.0)
    observer = Estimator(plant)
    bench.follow(observer, pushes(random, 15, 2, 2))
    states, trials = observer._states.copy(), observer._models
    bench.step(np.full((2, 2), 0.2))
    observer._advance(np.arange(2), bench.applied)
    numbers = trials.perturb(observer.theta, observer._steps).reshape(-1, trials.size)
    alone = Batch(plant.model, *plant.integration, plant.period, arms=len(numbers))
    alone.vary(np.arange(len(numbers)), **trials.parameters(numbers))
    alone.reset(np.arange(len(numbers)), states.reshape(len(numbers), -1))
    drive = np.zeros((len(numbers), 8))
    drive[:, :2] = np.repeat(bench.applied * plant.torque_limit, len(numbers) // 2, axis=0)
    alone.step(drive)
    assert np.array_equal(observer._states.reshape(len(numbers), -1), alone.state)


def test_a_confidence_region_contains_the_truth_of_most_arms():
    """Deviations along each parameter: a heavier payload, softer springs; delays that fit; states that move along."""
    plant = plant_of(noise=1e-3, delay=(0, 2))
    random, arms = np.random.default_rng(3), 24
    parameters = drawn_parameters(plant, arms, random)
    delays = random.integers(0, 3, arms)
    bench = Bench(plant, random.uniform(-0.8, 0.8, (arms, 1)), parameters, delays, noise=1.0, seed=3)
    estimator = Estimator(plant)
    bench.follow(estimator, pushes(random, 25, arms, 1))
    region = estimator.confidence_region(np.arange(arms), 2.0)
    assert region.states.shape[1] == region.deviations + 3, "one model, one for each parameter, two other delays"
    assert (region.delays.min(axis=1) <= delays).all() and (delays <= region.delays.max(axis=1)).all()
    for name, true in parameters.items():
        values = region.parameters[name].reshape(arms, -1)
        most_probable, deviations = values[:, 0], values[:, 1 : 1 + region.deviations] - values[:, :1]
        radius = np.sqrt((deviations**2).sum(axis=1))
        assert (np.abs(most_probable - true.reshape(arms)) <= radius + 1e-9).mean() >= 0.75, name
        own = deviations[:, list(dict.fromkeys(estimator.uncertain.names)).index(name)]
        assert (own >= 0.0 if name == "payload_mass" else own <= 0.0).all() and own.any(), name
    error = np.abs(region.states[:, 0] - bench.batch.state)
    radius = np.sqrt(((region.states[:, 1:] - region.states[:, :1]) ** 2).sum(axis=1))
    assert (error <= radius + 1e-12).mean() >= 0.5
    some = estimator.confidence_region(np.array([5, 2]), 2.0)
    assert all(
        np.array_equal(one, every[[5, 2]])
        for one, every in zip(some.parameters.values(), region.parameters.values(), strict=True)
    )
    assert np.array_equal(some.states, region.states[[5, 2]])  # fmt: skip


def test_a_consistent_copy_is_as_sure_as_it_may_be_between_resimulations():
    """A link that barely vibrates: a re-simulation confirms the deviations of its stiffness, which errors obey.

    An estimator that updates its models to the estimate is too sure of them: they vibrate, the arm does not.
    """
    springs = {"joint_stiffness_factor": (0.7, 1.3), "link_stiffness_factor": (0.6, 1.4), "sensor_noise": (3e-3, 3e-3)}
    plant, arms, (before, after), ratios, largest = small_plant("FlexRRR-v0", springs), 12, (29, 30), [], []
    parameters = drawn_parameters(plant, arms, np.random.default_rng(1))
    for estimator in (Estimator(plant), Estimator(plant).consistent_copy()):
        random, time = np.random.default_rng(2), plant.period * np.arange(after)[:, None, None]
        bench = Bench(plant, random.uniform(-0.8, 0.8, (arms, 3)), parameters, noise=1.0, seed=4)
        actions = 0.6 * np.sin(2.0 * np.pi * time / 1.5) * random.choice([-1, 1], (1, arms, 3))
        bench.follow(estimator, actions[:before])
        errors, covariance = normalised_errors(estimator, plant, parameters)
        deviations = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        largest.append(np.abs(errors / deviations).max())
        bench.follow(estimator, actions[before:after], begin=False)
        later = np.sqrt(np.diagonal(normalised_errors(estimator, plant, parameters)[1], axis1=1, axis2=2))
        ratios.append((deviations / later)[:, -3:].min())
    assert ratios[0] < 0.7 < ratios[1], ratios
    assert largest[1] < 3.0, largest
