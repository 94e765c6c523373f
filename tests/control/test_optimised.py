"""Optimised: the shipped table and tables of one's own replay what they hold, and refuse what they do not."""

import numpy as np
import pytest

from flexman_gym.__main__ import main
from flexman_gym.control import Episode
from flexman_gym.control.lqr import LQR
from flexman_gym.control.optimised import Optimised
from flexman_gym.control.shooting import Slew, spread
from flexman_gym.control.slew_table import MAKE, SHIPPED, SlewTable
from flexman_gym.envs.description import Description
from flexman_gym.envs.setup import build, setup_of
from flexman_gym.evaluation import evaluate, rollout
from flexman_gym.evaluation.optimising import empty_table, optimise
from flexman_gym.metrics import settling_time

from oracles.refusals import refusal

ONE, ONLY = Description("FlexOne-v0", {"horizon": 3.0}), np.array([0])


@pytest.fixture
def table():
    """Two made-up slews of the single joint."""
    result, random = empty_table(ONE), np.random.default_rng(4)
    for seed in (7, 3):
        ends = random.uniform(-1.0, 1.0, (2, 1))
        result.found[seed] = ends, Slew(random.uniform(-1.0, 1.0, (seed + 2, 1)), 20 + seed, 11), 0.1 * seed
    return result


def player(table, **changes):
    """What replays a table."""
    setup = setup_of({"name": "FlexOne-v0"})
    given = {"torque_limit": setup.torque_limit, "period": setup.control_period} | changes
    return Optimised(table, build(setup).model, **given)


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
        assert np.array_equal(again.torques(*ends), spread(slew.knots, slew.periods))
    assert again.settling_time(7) == pytest.approx(0.7)
    empty_table(ONE).save(path)
    assert SlewTable.load(path).found == {}


def test_it_replays_torques_then_regulates_and_each_arm_has_its_own(table):
    controller = player(table)
    (first, one, _), (second, other, _) = table.found[7], table.found[3]
    controller.reset(np.array([0, 1]), Episode(*np.stack([first, second], axis=1), 0.02))
    regulator = LQR(controller.model, controller.limits, 0.02)
    regulator.reset(np.array([0, 1]), Episode(*np.stack([first, second], axis=1), 0.02))
    states = 0.01 * np.random.default_rng(0).standard_normal((2, 2 * controller.model.n_dof))
    torques = [controller.torques(states) for _ in range(28)]
    closed = regulator.torques(states)
    for arm, slew in enumerate((one, other)):
        expected = [*spread(slew.knots, slew.periods), *[closed[arm]] * 28][:28]
        assert np.array_equal([each[arm] for each in torques], expected)
    controller.reset(np.array([1]), Episode(*first[:, None], 0.02))
    assert np.array_equal(controller.torques(states), [closed[0], spread(one.knots, one.periods)[0]])


def test_what_no_table_has_is_refused_with_the_command_that_makes_one(table):
    controller = player(table)
    start, goal = table.found[7][0]
    near = 0.9e-9
    controller.reset(ONLY, Episode(start[None] + near, goal[None] - near, 0.02))
    for ends in ((start, goal + 2e-9), (start - 2e-9, goal), (goal, start)):
        said = refusal(controller.reset, ONLY, Episode(ends[0][None], ends[1][None], 0.02))
        assert said.startswith("episode: [[") and said.endswith(MAKE)
    assert refusal(table.settling_time, 5).startswith("seed: 5 is not allowed; give one that the table has")
    moving = Episode(start[None], goal[None], 0.02, lambda: np.zeros((1, 4, 1)))
    assert refusal(controller.reset, ONLY, moving).startswith("episode: 'a goal that moves' is not allowed")


@pytest.mark.parametrize("changes", [{"period": 0.01}, {"torque_limit": 0.7}])
def test_a_table_of_another_arm_is_refused(table, changes):
    said = refusal(lambda: player(table, **changes))
    assert said.startswith("table: ") and said.endswith(MAKE)


def test_an_arm_is_known_however_finely_it_is_modelled(table):
    setup = setup_of({"name": "FlexOne-v0", "elements": 3, "modes": None})
    Optimised(table, build(setup).model, setup.torque_limit, setup.control_period)
    heavy = Description("FlexOne-v0").changed(["arm.payload.mass=0.07"]).setup()
    assert refusal(Optimised, table, build(heavy).model, heavy.torque_limit, 0.02).startswith("table: ")


def test_a_file_that_is_no_table_is_refused_in_one_line(tmp_path, table):
    path = tmp_path / "table.npz"
    path.write_text("nothing")
    for broken in (lambda: None, lambda: np.savez(path, seeds=ONLY), lambda: path.write_bytes(b"")):
        broken()
        said = refusal(SlewTable.load, path)
        assert said.startswith(f"{path}: it is no table of slews") and "\n" not in said
    with pytest.raises(FileNotFoundError):
        SlewTable.load(tmp_path / "none.npz")


def test_the_command_makes_a_table_and_goes_on_with_it(tmp_path, capsys):
    path = tmp_path / "one.npz"
    assert main(["optimise", "FlexOne-v0", "--seeds", "5003", "1", "--out", str(path)]) == 0
    first = SlewTable.load(path)
    assert main(["optimise", "FlexOne-v0", "--seeds", "5003", "2", "--out", str(path)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[0] for line in lines] == ["seed", "5003", "1", "seed", "5004", "2"]
    both = SlewTable.load(path)
    assert sorted(both.found) == [5003, 5004] and both.about["command"].endswith("--seeds 5003 2")
    assert np.array_equal(both.found[5003][1].knots, first.found[5003][1].knots)
    base = {"kind": "optimised", "table": str(path)}
    replayed = rollout(base, "FlexOne-v0", [5003, 5004]).records
    for seed, record in zip((5003, 5004), replayed, strict=True):
        assert settling_time(record.errors, record.band, record.period) == both.settling_time(seed)
    other = main(["optimise", "FlexPlanar-v0", "--seeds", "1", "1", "--out", str(path)])
    assert other == 2 and capsys.readouterr().err.startswith("table: ")


def test_an_environment_that_draws_more_than_slews_is_refused():
    for environment in (Description("FlexOne-v0", {"randomisation": {"payload_mass": (0.0, 0.1)}}),
                        Description("FlexPlanar-Track-v0"), Description("FlexPlanar-Hold-v0")):  # fmt: skip
        assert refusal(lambda each=environment: next(optimise(each, [1], empty_table(each)))).startswith(
            "environment: "
        )


def test_the_shipped_table_is_that_of_the_test_episodes():
    shipped = SlewTable.load(SHIPPED)
    limits = np.array(setup_of({}).torque_limit)
    times = np.array([shipped.settling_time(seed) for seed in range(9000, 9100)])
    assert np.median(times) <= 2.1 and np.isfinite(times).mean() >= 0.95
    assert all((np.abs(slew.knots) <= limits).all() for _, slew, _ in shipped.found.values())
    assert shipped.about["environment"]["id"] == "FlexRRR-v0" and shipped.about["command"].startswith(
        "flexman optimise"
    )
    assert SHIPPED.stat().st_size < 150_000


def test_the_shipped_slews_settle_when_they_are_replayed():
    """In the times that the table says."""
    shipped, seeds = SlewTable.load(SHIPPED), [9000, 9050, 9099]
    records = rollout("optimised", "FlexRRR-v0", seeds).records
    times = [settling_time(each.errors, each.band, each.period) for each in records]
    assert times == pytest.approx([shipped.settling_time(seed) for seed in seeds], abs=0.05)
    assert refusal(evaluate, "optimised", "FlexRRR-v0", [1]).endswith(MAKE)
