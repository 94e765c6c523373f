"""Optimised slews: single shooting, tables and replay."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.limits import Limits
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.metrics import settling_time
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.lqr import LQR
from flexman_gym.toolbox.controllers.references import single_shooting
from flexman_gym.toolbox.controllers.references.optimised_slews import (
    COMMAND,
    SHIPPED_TABLE,
    OptimisedController,
    SlewTable,
)
from flexman_gym.toolbox.controllers.references.single_shooting import (
    SETTLED_BAND,
    SETTLING_TIME,
    TAIL_TIME,
    SingleShooting,
    interpolate_torques,
    simulate_torques,
)
from flexman_gym.toolbox.controllers.tuning import empty_slew_table, optimise_slews

from oracles.assertions import refusal

PERIOD = 0.02


def shooting(model, limits, band, start, goal, rate=1e3, **moved):
    """A search for an arm."""
    moved = {"method": "midpoint_3", "step": PERIOD, "control_period": PERIOD} | moved
    regulator = LQR(model, limits, moved["control_period"], scales=ArmScales.of_design_named(model))
    return SingleShooting(
        regulator, lambda arms: Batch(model, arms=arms, **moved), band, rate, (np.array(start), np.array(goal))
    )


def made_up(knots, periods, arrival=1):
    """A slew with given torques at knots."""
    return SimpleNamespace(knots=np.array(knots), periods=periods, arrival=arrival)


def interpolated(slew):
    """The torques of a slew that a table returns."""
    return SlewTable({}, np.zeros(1), {0: (np.zeros((2, 1)), slew, 1.0)}).torques(np.zeros(1), np.zeros(1))


def test_torques_of_periods_are_those_in_their_middles():
    """Of a line through the knots, and the mean of two neighbours where a period lies between them."""
    line = interpolated(made_up([[3.0, 0.0], [5.0, 1.0], [7.0, 2.0]], 10))
    middles = (np.arange(10) + 0.5) / 10
    assert line == pytest.approx(np.array([3.0 + 4.0 * middles, 2.0 * middles]).T)
    assert interpolated(made_up([[1.0], [5.0], [2.0]], 2)).tolist() == [[3.0], [3.5]]


def test_slews_side_by_side_move_as_each_alone():
    model, limit = fm.build_model(fm.catalog.planar_2r(), 1), 5.0
    search, knots = shooting(model, limit, 0.01, [0.1, 0.2], [0.3, 0.1]), np.random.default_rng(0)
    knots = knots.uniform(-1.0, 1.0, (3, 7, 2))
    both = search.errors(knots, 25)
    assert all(np.array_equal(search.errors(one[None], 25)[0], each) for one, each in zip(knots, both, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("start", "way", "seconds"), [(0.2, 1.0, 2.0), (0.5, -0.7, 1.5)])
def test_a_rigid_link_is_as_quick_as_full_torque_forth_and_back(start, way, seconds):
    """From rest it speeds up all the time, then brakes, and only just does not leave the band on its other side.

    With the acceleration a, the way s and the band b it is within the band after 2 sqrt((s + b) / a) - 2 sqrt(b / a).
    """
    model = fm.build_model(fm.catalog.one_joint(), flexible_links=False, flexible_joints=False)
    inertia, reach = float(mass_matrix(model, np.zeros(2))[0, 0]), float(model.constants.length.sum())
    band, acceleration = 0.02, 4.0 * abs(way) / seconds**2
    search = shooting(model, acceleration * inertia, band * reach, [start], [start + way])
    slew = search.search()
    least = 2.0 * (np.sqrt((abs(way) + band) / acceleration) - np.sqrt(band / acceleration))
    assert least <= slew.arrival * PERIOD <= least + 2.0 * PERIOD
    assert np.abs(slew.knots).max() <= acceleration * inertia
    ways = np.linalg.norm(search.errors(slew.knots[None], slew.periods)[0, :, :3], axis=1)
    assert len(ways) == slew.periods + round(SETTLING_TIME / PERIOD)
    assert ways[slew.arrival - 1 :].max() <= SETTLED_BAND * band * reach < ways[slew.arrival - 2]


@pytest.mark.slow
def test_a_rigid_link_that_may_not_be_as_quick_goes_on_at_its_largest_rate():
    """With the rate v it is within the band after (s + b) / v + v / a - 2 sqrt(b / a), see above."""
    model = fm.build_model(fm.catalog.one_joint(), flexible_links=False, flexible_joints=False)
    inertia, reach = float(mass_matrix(model, np.zeros(2))[0, 0]), float(model.constants.length.sum())
    band, acceleration, rate = 0.02, 1.0, 0.6
    search = shooting(model, acceleration * inertia, band * reach, [-0.3], [0.7], rate)
    slew = search.search()
    least = (1.0 + band) / rate + rate / acceleration - 2.0 * np.sqrt(band / acceleration)
    assert least <= slew.arrival * PERIOD <= 1.05 * least
    rates = search.errors(slew.knots[None], slew.periods)[0, :, 3]
    assert 0.95 < np.abs(rates).max() < 1.0


@pytest.mark.slow
def test_links_deflect_by_at_most_the_limit_of_the_model():
    """A soft link on a strong motor: by its own simulation, a slew searched without the limit deflects it by more."""
    link = fm.Link.strip(0.4, 0.03, 0.001, material="steel", masses=[fm.LumpedMass(0.02, 0.4)])
    joint = fm.Joint((0.0, 0.0, 1.0), 0.01, torque_limit=10.0)
    model = fm.build_model(fm.Arm([link], [joint], gravity=(0.0, 0.0, 0.0), modal_damping_ratio=0.005), 2)
    largest = []
    for factor in (1.0, 1e3):
        search = shooting(model, 10.0, 0.008, [0.0], [2.0], step=0.002)
        search._max_deflections = factor * search._max_deflections
        slew = search.search()
        torques = interpolate_torques(slew.knots, slew.periods)
        states = simulate_torques(search._make_batch(1), fm.rest_state(model, [0.0]), torques)
        largest.append(np.abs(LinearMeasurements(model).measure(states)["link_deflections"]).max())
    assert largest[0] <= Limits.deflection * link.length < largest[1]


def test_slopes_are_those_of_errors():
    """Of a rigid link about its place at rest, whose tip goes across the link as linearly as it turns."""
    model = fm.build_model(fm.catalog.one_joint(), flexible_links=False, flexible_joints=False)
    search = shooting(model, 1.0, 0.01, [0.0], [0.05])
    knots = np.zeros((6, 1))
    errors, slopes = search._jacobian(knots, 25)
    moved = 0.01 * np.array([1.0, -2.0, 0.5, 0.0, 1.0, -1.0])[:, None]
    expected = (errors + np.tensordot(moved.ravel(), slopes, 1))[:, 1]
    assert search.errors(moved[None], 25)[0, :, 1] == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(moved).max())
    assert np.ptp(expected) > 0.01


def test_slopes_that_follow_a_move_map_it_to_the_change_and_others_as_before():
    random = np.random.default_rng(2)
    slopes, move, change = random.normal(size=(4, 5, 3)), random.normal(size=4), random.normal(size=(5, 3))
    result, across = single_shooting._broyden_update(slopes, move, change), np.array([move[1], -move[0], 0.0, 0.0])
    assert np.tensordot(move, result, 1) == pytest.approx(change)
    assert np.tensordot(across, result, 1) == pytest.approx(np.tensordot(across, slopes, 1))


def test_a_stretched_slew_holds_as_before_and_moves_with_the_square_of_its_speed():
    """An arm under its weight: what holds it stays, what moves it grows fourfold in half of the time."""
    model, start, goal = fm.build_model(fm.catalog.vertical_2r(), 1), [0.1, -0.2], [0.3, 0.1]
    search, parts = shooting(model, 1e3, 0.1, start, goal), np.linspace(0.0, 1.0, 51)[:, None]
    tail, ends = round(TAIL_TIME / PERIOD), [fm.holding_torques(model, posture) for posture in (start, goal)]
    held = ends[0] + parts * (ends[1] - ends[0])
    moving = np.concatenate([held + np.sin(2.0 * np.pi * parts), np.repeat(ends[1:], 2 * tail, axis=0)])
    known = made_up(moving, len(moving) - 1, 50)
    for arrival, factor in ((50, 1.0), (25, 4.0), (100, 0.25)):
        knots = search.rescale(known, arrival)
        come = np.minimum(np.linspace(0.0, arrival + tail, len(knots)) / arrival, 1.0)[:, None]
        expected = ends[0] + come * (ends[1] - ends[0]) + factor * np.sin(2.0 * np.pi * come)
        assert knots == pytest.approx(expected, abs=1e-2 * factor)


def test_errors_in_the_inner_band_weigh_nothing_and_others_what_is_beyond_it():
    search = shooting(fm.build_model(fm.catalog.one_joint(), 1), 1.0, 0.1, [0.0], [0.1])
    errors = np.zeros((1, 8, 4))
    errors[0, :, 1] = [9.0, 9.0, 9.0, 0.06, 9.0, -0.16, 9.0, 0.0]
    errors[0, :, 3] = [0.0, 0.97, -0.98, 0.0, 0.0, 0.0, 0.0, 0.99]
    ways = [[0, 0, 0], [0, pytest.approx(-1.0), 0], [0, 0, 0]]
    rates = [0, 0, pytest.approx(-0.5), 0, 0, 0, 0, pytest.approx(1.0)]
    assert search._residuals(errors, 4)[0].tolist() == [*ways[0], *ways[1], *ways[2], *rates]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-v0"])
def test_an_arm_is_quicker_than_with_the_tracking_lqr(name):
    """Replayed in the environment, where it settles, also under its weight; and within the limits."""
    environment = Configuration(name, {"horizon": 3.0})
    table = empty_slew_table(environment)
    (found,) = optimise_slews(environment, [5000], table)
    slew = table.found[5000][1]
    assert found.settling_time == pytest.approx(slew.arrival * environment.control_period) == table.settling_time(5000)
    assert found.settling_time < 0.8 * found.tracking < np.inf
    assert (np.abs(slew.knots) <= np.array(environment.torque_limit)).all()


def test_a_replay_is_the_search_s_own_simulation_to_the_bit():
    """Open loop and regulator, in the single environment and among three arms."""
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0"})
    model, method, step, _ = resolve_fidelity(setup)
    random, period = np.random.default_rng(1), setup.control_period
    environment = Configuration("FlexPlanar-v0", {"horizon": 2.0})
    table, ends = empty_slew_table(environment), random.uniform(-0.2, 0.2, (3, 2, 2))
    search = [
        shooting(model, setup.torque_limit, 0.01, *pair, method=method, step=step, control_period=period)
        for pair in ends
    ]
    expected = []
    for seed, (each, pair) in enumerate(zip(search, ends, strict=True)):
        knots = fm.holding_torques(model, pair[0]) + 0.02 * random.uniform(-1.0, 1.0, (5, 2)) * setup.torque_limit
        table.found[seed] = pair, made_up(knots, 20 + seed), 1.0
        expected.append(each.errors(knots[None], 20 + seed)[0])
    base = OptimisedController(table, model, setup.torque_limit, period)
    venv = gym.make_vec("FlexPlanar-v0", 3, "vector_entry_point", base=base, horizon=2.0).unwrapped
    venv.reset(seed=0, options={"start": ends[:, 0], "goal_angles": ends[:, 1]})
    env = gym.make(
        "FlexPlanar-v0", base=OptimisedController(table, model, setup.torque_limit, period), horizon=2.0
    ).unwrapped
    env.reset(seed=0, options={"start": ends[2, 0], "goal_angles": ends[2, 1]})
    for row in range(120):
        venv.step(np.zeros((3, 2), dtype=np.float32))
        env.step(np.zeros(2, dtype=np.float32))
        view = venv.episodes.view
        for arm in range(3):
            assert np.array_equal(view.tip[arm] - view.target[arm], expected[arm][row, :3]), (arm, row)
        assert np.array_equal(env.episodes.view.tip[0], view.tip[2])


ONE, ONLY = Configuration("FlexOne-v0", {"horizon": 3.0}), np.array([0])


@pytest.fixture
def table():
    """Two made-up slews of the single joint."""
    result, random = empty_slew_table(ONE), np.random.default_rng(4)
    for seed in (7, 3):
        ends = random.uniform(-1.0, 1.0, (2, 1))
        result.found[seed] = ends, made_up(random.uniform(-1.0, 1.0, (seed + 2, 1)), 20 + seed, 11), 0.1 * seed
    return result


def player(table, **changes):
    """What replays a table."""
    setup = Configuration.from_keywords({"name": "FlexOne-v0"})
    given = {"torque_limit": setup.torque_limit, "period": setup.control_period} | changes
    return OptimisedController(table, resolve_fidelity(setup).model, **given)


def test_a_table_comes_back_from_its_file_as_it_was(table, tmp_path):
    path = tmp_path / "table.npz"
    table.save(path)
    again = SlewTable.load(path)
    assert again.about == table.about and np.array_equal(again.arm, table.arm)
    assert sorted(again.found) == [3, 7] and [each.name for each in tmp_path.iterdir()] == ["table.npz"]
    for seed, (ends, slew, time) in table.found.items():
        own_ends, own_slew, own_time = again.found[seed]
        assert np.array_equal(own_ends, ends) and np.array_equal(own_slew.knots, slew.knots)
        assert (own_slew.periods, own_slew.arrival, own_time) == (slew.periods, slew.arrival, time)
        assert np.array_equal(again.torques(*ends), interpolated(slew))
    assert again.settling_time(7) == pytest.approx(0.7)
    empty_slew_table(ONE).save(path)
    assert SlewTable.load(path).found == {}


def test_it_replays_torques_then_regulates_and_each_arm_has_its_own(table):
    controller = player(table)
    (first, one, _), (second, other, _) = table.found[7], table.found[3]
    controller.reset(np.array([0, 1]), EpisodeInfo(*np.stack([first, second], axis=1), 0.02), 2)
    regulator = LQR(controller.model, controller.limits, 0.02, scales=controller.scales)
    regulator.reset(np.array([0, 1]), EpisodeInfo(*np.stack([first, second], axis=1), 0.02), 2)
    states = 0.01 * np.random.default_rng(0).standard_normal((2, 2 * controller.model.n_dof))
    torques = [controller.torques(states) for _ in range(28)]
    closed = regulator.torques(states)
    for arm, slew in enumerate((one, other)):
        expected = [*interpolated(slew), *[closed[arm]] * 28][:28]
        assert np.array_equal([each[arm] for each in torques], expected)
    controller.reset(np.array([1]), EpisodeInfo(*first[:, None], 0.02), 2)
    assert np.array_equal(controller.torques(states), [closed[0], interpolated(one)[0]])


def test_what_no_table_has_is_refused_with_the_command_that_makes_one(table):
    controller = player(table)
    start, goal = table.found[7][0]
    near = 0.9e-9
    controller.reset(ONLY, EpisodeInfo(start[None] + near, goal[None] - near, 0.02), 1)
    for ends in ((start, goal + 2e-9), (start - 2e-9, goal), (goal, start)):
        said = refusal(controller.reset, ONLY, EpisodeInfo(ends[0][None], ends[1][None], 0.02), 1)
        assert said.startswith("episode: [[") and said.endswith(COMMAND)
    assert refusal(table.settling_time, 5).startswith("seed: 5 is not allowed; give a seed in the table")
    moving = EpisodeInfo(start[None], goal[None], 0.02, lambda: np.zeros((1, 4, 1)))
    assert refusal(controller.reset, ONLY, moving, 1).startswith("episode: 'a moving goal' is not allowed")


@pytest.mark.parametrize("changes", [{"period": 0.01}, {"torque_limit": 0.7}])
def test_a_table_of_another_arm_is_refused(table, changes):
    said = refusal(lambda: player(table, **changes))
    assert said.startswith("table: ") and said.endswith(COMMAND)


def test_an_arm_is_known_however_finely_it_is_modelled(table):
    setup = Configuration.from_keywords({"name": "FlexOne-v0", "elements": 3, "modes": None})
    OptimisedController(table, resolve_fidelity(setup).model, setup.torque_limit, setup.control_period)
    heavy = Configuration("FlexOne-v0").changed(["arm.payload.mass=0.07"])
    assert refusal(OptimisedController, table, resolve_fidelity(heavy).model, heavy.torque_limit, 0.02).startswith(
        "table: "
    )


def test_a_file_that_is_no_table_is_refused_in_one_line(tmp_path, table):
    path = tmp_path / "table.npz"
    path.write_text("nothing")
    for broken in (lambda: None, lambda: np.savez(path, seeds=ONLY), lambda: path.write_bytes(b"")):
        broken()
        said = refusal(SlewTable.load, path)
        assert said.startswith(f"{path}: this is not a table of slews") and "\n" not in said
    with pytest.raises(FileNotFoundError):
        SlewTable.load(tmp_path / "none.npz")


@pytest.mark.slow
def test_the_command_makes_a_table_and_goes_on_with_it(tmp_path, capsys):
    path = tmp_path / "one.npz"
    assert main(["optimise", "slews", "FlexOne-v0", "--seeds", "5003", "1", "--out", str(path)]) == 0
    first = SlewTable.load(path)
    assert main(["optimise", "slews", "FlexOne-v0", "--seeds", "5003", "2", "--out", str(path)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[0] for line in lines] == ["seed", "5003", "1", "seed", "5004", "2"]
    both = SlewTable.load(path)
    assert sorted(both.found) == [5003, 5004] and both.about["command"].endswith("--seeds 5003 2")
    assert np.array_equal(both.found[5003][1].knots, first.found[5003][1].knots)
    base = {"kind": "optimised", "table": str(path)}
    replayed = rollout(base, "FlexOne-v0", [5003, 5004]).records
    for seed, record in zip((5003, 5004), replayed, strict=True):
        assert settling_time(record.errors, record.band, record.period) == both.settling_time(seed)
    other = main(["optimise", "slews", "FlexPlanar-v0", "--seeds", "1", "1", "--out", str(path)])
    assert other == 2 and capsys.readouterr().err.startswith("table: ")


def test_an_environment_that_draws_more_than_slews_is_refused():
    for environment in (Configuration("FlexOne-v0", {"randomisation": {"payload_mass": (0.0, 0.1)}}),
                        Configuration("FlexPlanar-Track-v0"), Configuration("FlexPlanar-Hold-v0")):  # fmt: skip
        assert refusal(lambda each=environment: next(optimise_slews(each, [1], empty_slew_table(each)))).startswith(
            "environment: "
        )


def test_the_shipped_table_is_that_of_the_test_episodes():
    shipped = SlewTable.load(SHIPPED_TABLE)
    limits = np.array(Configuration.from_keywords({}).torque_limit)
    times = np.array([shipped.settling_time(seed) for seed in range(9000, 9100)])
    assert np.median(times) <= 2.1 and np.isfinite(times).mean() >= 0.95
    assert all((np.abs(slew.knots) <= limits).all() for _, slew, _ in shipped.found.values())
    assert shipped.about["environment"]["id"] == "FlexRRR-v0" and shipped.about["command"].startswith(
        "flexman optimise"
    )
    assert SHIPPED_TABLE.stat().st_size < 150_000


def test_the_shipped_slews_settle_when_they_are_replayed():
    """In the times that the table says."""
    shipped, seeds = SlewTable.load(SHIPPED_TABLE), [9000, 9050, 9099]
    records = rollout("optimised", "FlexRRR-v0", seeds).records
    times = [settling_time(each.errors, each.band, each.period) for each in records]
    assert times == pytest.approx([shipped.settling_time(seed) for seed in seeds], abs=0.05)
    assert refusal(evaluate, "optimised", "FlexRRR-v0", [1]).endswith(COMMAND)
