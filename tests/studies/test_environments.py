"""Tests of the environment pages against docstrings, stored rows and environments."""

import inspect
import re

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.tasks import TASKS
from flexman_gym.evaluation.shares import share_text
from studies.environments.family import FAMILIES
from studies.environments.measure import BASELINES, LONG_NAME, SEEDS, SPEED, accuracy, baseline_rows, run
from studies.environments.rewards import reward, reward_lines
from studies.environments.text import SECTIONS, baseline_table, docstring_sections, is_slew, length, make
from studies.results import Results

from oracles.files import ROOT

PAGES = ROOT / "docs" / "environments"


@pytest.fixture(scope="module")
def baselines():
    """Return the stored metrics of the baselines, as on all pages."""
    return Results().baselines()


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_a_task_has_the_sections_of_gymnasium_in_their_order(task):
    lines = inspect.cleandoc(task.__doc__).splitlines()  # Python 3.13 has taken the indentation off already
    assert tuple(line for line in lines if line in SECTIONS) == SECTIONS
    assert all(docstring_sections(task).values()), "none is empty"


@pytest.mark.evidence
@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.file)
def test_the_page_of_a_family_begins_with_tables_of_actions_and_observations(family):
    text = (PAGES / f"{family.file}.md").read_text(encoding="utf-8")
    titles = re.findall(r"^## (.*)$", text, re.MULTILINE)
    reward = ["Reward"] if is_slew(family.environments[0]) else []
    assert titles == ["Actions", "Observations", *reward, "Arm", *family.environments]
    for name in family.environments:
        for suffix, least, most in (("svg", 20_000, 150_000), ("gif", 50_000, 400_000)):
            assert least < (PAGES / f"{name}.{suffix}").stat().st_size < most and f"({name}.{suffix})" in text


def test_the_plotted_rewards_are_those_of_their_formulas():
    errors, speeds, reach, slew_time = np.array([0.0, 0.02, 5.0]), np.array([0.0, 0.3, 1.0]), 8.5, 3.2
    near, far = reach / 425.0, reach / 1.7
    expected = 1.0 - np.log1p((errors**2 + (slew_time * speeds / 32.0) ** 2) / near**2) / np.log1p((far / near) ** 2)
    np.testing.assert_allclose(reward("distance", errors, speeds, reach, slew_time), expected, atol=1e-12)
    bells = np.mean([1.0 / (1.0 + (errors / width) ** 2) for width in (2.0, 0.4, 0.08)], axis=0)
    expected = 0.7 * bells + 0.2 / (1.0 + (speeds / 0.3) ** 2) + 0.1
    np.testing.assert_allclose(reward("bells", errors, speeds, reach, slew_time), expected, atol=1e-12)


@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexOne-v0"])
def test_a_page_names_the_default_reward_of_its_environment(name):
    default = make(name).configuration.task.reward
    text = " ".join(reward_lines(name))
    assert f"is `{default}`" in text and ('reward="distance"' in text) == (default == "bells")


@pytest.mark.evidence
def test_the_gallery_shows_every_environment_and_links_to_its_section():
    text = (PAGES / "index.md").read_text(encoding="utf-8")
    links = dict(re.findall(r"\[\*\*(.*?)\*\*\]\((.*?)\)", text))
    assert list(links) == list(NAMED_ENVIRONMENTS) == [name for family in FAMILIES for name in family.environments]
    for name, link in links.items():
        file, section = link.split("#")
        assert f"## {name}\n" in (PAGES / file).read_text(encoding="utf-8") and section == name.lower()
        assert f"]({name}.gif)]({link})" in text


def test_a_caption_of_the_gallery_states_the_speed_and_where_the_pd_is_better(baselines):
    lines = (ROOT / "docs" / "environments" / "index.md").read_text(encoding="utf-8").splitlines()
    found = {(row.environment, row.baseline): row for row in baselines}
    for name in NAMED_ENVIRONMENTS:
        caption = next(line for line in lines if line.startswith(f"[**{name}**]"))
        assert (" times slower" in caption) == (SPEED.get(name, 1.0) < 1.0), name
        pd, lqr = (found.get((name, each)) for each in ("PD", "tracking LQR"))
        slew = "move the tip" in caption
        better = lqr is not None and (pd.settling_time < lqr.settling_time if slew else pd.rms_error < lqr.rms_error)
        assert ("The PD " in caption) == better, name


@pytest.mark.evidence
@pytest.mark.parametrize("name", NAMED_ENVIRONMENTS)
def test_a_moving_picture_is_480_pixels_wide_and_holds_its_last_frame(name):
    image = pytest.importorskip("PIL.Image")
    with image.open(PAGES / f"{name}.gif") as read:
        read.seek(read.n_frames - 1)
        assert read.size == (480, 360) and read.info["duration"] >= 2000, "ms"


@pytest.mark.parametrize("baseline", ["PD", "tracking LQR"])
def test_a_row_of_a_slew_has_what_evaluate_gives(baseline, baselines):
    (row,) = [each for each in baselines if (each.environment, each.baseline) == ("FlexOne-v0", baseline)]
    found = fm.evaluate(BASELINES[baseline], "FlexOne-v0", SEEDS)
    assert (row.settled, row.failed, row.episodes) == (found["settled"], found["failed"], len(SEEDS))
    assert row.settling_time == pytest.approx(found["settling_time"], abs=0.02)


def test_the_pd_that_does_not_settle_in_its_episodes_settles_in_longer_ones(baselines):
    short, long = ([row for row in baselines if (row.environment, row.baseline) == ("FlexRRR-v0", name)]
                   for name in ("PD", LONG_NAME))  # fmt: skip
    assert short[0].settled == 0.0 and long[0].settled == 1.0 and 10.0 < long[0].settling_time < 30.0


def test_metrics_of_a_task_without_settling_are_those_of_its_records():
    runs = {baseline: run("FlexPlanar-Hold-v0", agent) for baseline, agent in BASELINES.items()}
    rows = baseline_rows("FlexPlanar-Hold-v0", runs)
    assert all(f"Over {len(SEEDS)} test episodes" in line for line in baseline_table("FlexPlanar-Hold-v0", rows)[:1])
    table = baseline_table("FlexPlanar-Hold-v0", rows)
    for row, each in zip(rows, runs.values(), strict=True):
        error = np.quantile(np.sqrt(np.nanmean(each.errors**2, axis=1)), 0.5, method="higher")
        failed = np.mean([failure != "" for failure in each.failures])
        assert f"| {row.baseline} | {length(error)} | {share_text(failed, len(SEEDS))} |" in table
    assert rows[2].rms_error < rows[1].rms_error < rows[0].rms_error


def test_lengths_have_units_that_a_reader_can_imagine():
    assert [length(value) for value in (12.53, 1.0, 0.4567, 1e-3, 4e-7, 0.0, np.inf)] == [
        "12.5 m", "1 m", "457 mm", "1 mm", "below 0.01 mm", "below 0.01 mm", "-",
    ]  # fmt: skip


@pytest.mark.slow
def test_the_default_is_judged_by_finer_steps_and_a_finer_model():
    """Halving the step of the default quarters its error, since its method has order 2."""
    default, half = accuracy("FlexPlanar-v0"), accuracy("FlexPlanar-v0", step=0.00125)
    assert half.steps == pytest.approx(default.steps / 4.0, rel=0.5)
    assert (default.model > default.steps).all() and default.model.max() < 0.01 and default.cost > 1.0
