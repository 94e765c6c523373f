"""Certificate: a league of one agent, whose scenarios are those of the league, with the reasons of each failure."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config import base_and_mode
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.policy_files import FOLDER, METADATA, POLICIES, write_policy
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.league import certificate, certificate_file, rows
from flexman_gym.toolbox.league.certificate import METRIC_NAMES, certify
from flexman_gym.toolbox.league.certificate_file import CERTIFICATE, read_certificate
from flexman_gym.toolbox.league.rows import VALUES, EpisodeBlock, EpisodeRow
from flexman_gym.toolbox.league.scenarios import CHANGES, PLANTS, find_scenario

from oracles.assertions import refusal
from oracles.shipped import DESCRIBED, made_up, write_still

SEEDS = range(9000, 9002)
LEAGUE = Path(__file__).parents[3] / "docs" / "league" / "rows.csv"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A policy that does nothing beside its PD controller, under a name."""
    write_still(tmp_path / "still")
    monkeypatch.setattr(certificate_file, "FOLDER", tmp_path)
    monkeypatch.setattr(certificate, "METHOD", "midpoint_2")  # another one compiles for long
    monkeypatch.delitem(certificate.PLANTS, "mujoco")  # and this one plays for long
    monkeypatch.setattr(certificate, "worst_case", lambda name, environment, seed: {"seed": seed})
    return tmp_path / "still"


def test_a_certificate_leaves_out_mujoco_for_an_arm_that_it_cannot_simulate(folder, tmp_path, monkeypatch):
    run, names = certificate.run_league, ["", "@mujoco"]
    monkeypatch.setattr(certificate, "_certificate_scenarios", lambda name: [name + each for each in names])

    def refusing(agents, scenarios, *arguments):
        if "@" in scenarios[0]:
            cell = SimpleNamespace(scenario=scenarios[0], why="plant: only arms without Coulomb friction")
            return SimpleNamespace(cells={0: cell}, rows={})
        return run(agents, scenarios, *arguments)

    monkeypatch.setattr(certificate, "run_league", refusing)
    monkeypatch.setattr(certificate, "find_spec", lambda name: object())
    said = []
    certify(str(folder), SEEDS, 2, tmp_path / "rows", log=said.append)
    found = read_certificate(folder)
    reason = f"{folder}@mujoco: plant: only arms without Coulomb friction"
    assert found["left_out"] == {f"{folder}@mujoco": reason} and len(found["rows"]) == 2
    assert f"left out: {reason}" in said
    monkeypatch.setattr(certificate, "find_spec", lambda name: None)  # not installed
    assert refusal(lambda: certify(str(folder), SEEDS, 2, tmp_path / "rows", log=said.append)) == reason


def test_policy_that_settles_in_no_episode_is_described(folder):
    """`flexman export policy` writes null for an infinite median."""
    path = folder / METADATA
    row = {"environment": "FlexPlanar-v0", "settled": 0.0, "settling_time": None, "vibration": None}
    for given, text in ((row, "0% settle. "), (row | {"vibration": 0.3}, "0% settle, vibration 300 mm. ")):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"league": given}))
        assert f" FlexPlanar-v0: {text}" in certificate_file.describe_policy("still")


@pytest.mark.slow
def test_scenarios_are_run_as_their_names_say_and_kept_beside_the_policy(folder, tmp_path):
    assert certificate_file.describe_policy("still").endswith("Made up. It has no certificate.")
    said = []
    path = certify(str(folder), SEEDS, 6, tmp_path / "rows", log=said.append)
    result = json.loads(path.read_text())
    assert len(said) == len(result["rows"])
    *known, search = result["rows"]
    found = {row["scenario"].removeprefix(str(folder)): row for row in known}
    assert list(found)[:3] == ["", "@finer", "/method=midpoint_2"]
    finer = rollout("pd", DESCRIBED, SEEDS, set_plant=PLANTS["finer"][1]).records
    assert found["@finer"]["error"] == METRICS["error"].evaluate(finer)
    far = ("payload=0:0.2", "stiffness=0.7:1.3", "friction=1", "delay=0", "delay=3", "noise=0.003")
    assert {f"/{name}{given}" for name in far for given in ("+given", "")} <= found.keys()
    for name, changes in (
        ("", {}),
        ("/payload=0:0.2+given", {"randomisation": {"payload_mass": [0.0, 0.2]}}),
        ("/delay=1", {"randomisation": {"delay": [1, 1]}}),
        ("/friction=1+given", Configuration.find("FlexPlanar-v0/friction").given),
    ):
        expected = fm.evaluate("pd", Configuration("FlexPlanar-v0", {**DESCRIBED.given, **changes}), SEEDS)
        shown = {each: expected[each] if np.isfinite(expected[each]) else None for each in METRIC_NAMES}
        assert {each: found[name][each] for each in METRIC_NAMES} == shown, name
    draws = range(certificate.SEARCH_SEED, certificate.SEARCH_SEED + 6)
    rewards = {seed: fm.evaluate("pd", DESCRIBED, [seed])["reward"] for seed in draws}
    assert [each["seed"] for each in search["worst"]] == sorted(draws, key=rewards.__getitem__)[:5]
    assert search["worst_case"] == {"seed": certificate.SEARCH_SEED}
    failed = [row["scenario"] for row in result["rows"] if row["fails"]]
    counted = [name for name in failed if "=" not in name or "+given" in name or "/method=" in name]
    assert len(result["fails"]) == len(counted) < len(failed)
    assert f"{folder}/delay=3+given" in result["fails"], "the arm then never settles in its second"
    assert f"{folder}/delay=3" in failed and f"{folder}/delay=3" not in result["fails"], "which is not given"
    lines = {line.split()[0].removeprefix(str(folder)): line for line in said}
    assert "does not count" in lines["/delay=3"] and "does not count" not in lines["/delay=3+given"]
    assert f"{folder} on seeds 50000 to 50005" in result["fails"]
    assert ("delay=3", found["/delay=3+given"]["fails"]) in certificate_file.exceeded_limits("still")
    assert f"; delay=3: {found['/delay=3+given']['fails'].split(',')[0]}" in certificate_file.describe_policy("still")


@pytest.mark.slow
def test_rows_of_a_certificate_are_kept_and_a_refused_cell_says_why(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(certificate, "_certificate_scenarios", lambda name: [name])
    first = certify(str(folder), SEEDS, 2, tmp_path / "rows", log=list).read_bytes()
    monkeypatch.setattr(rows, "rollout", lambda *_, **__: pytest.fail("the rows are there"))
    assert certify(str(folder), SEEDS, 2, tmp_path / "rows", log=list).read_bytes() == first

    def refuse(name):
        raise ValueError("plant: 'finer' is not allowed; give a plant that is installed")

    monkeypatch.setattr(certificate, "_certificate_scenarios", lambda name: [f"{name}@finer"])
    monkeypatch.setattr(rows, "PLANTS", dict.fromkeys(PLANTS, ("", refuse)))
    monkeypatch.setattr(rows, "rollout", lambda *_, set_plant, **__: set_plant("finer"))
    line = refusal(certify, str(folder), SEEDS, 2, tmp_path / "rows")
    assert line == f"{folder}@finer: plant: only a plant that is installed"


def test_a_policy_is_described_by_its_results_and_by_the_limits_that_it_exceeds(folder):
    about = json.loads((folder / METADATA).read_text())
    empty = {"arrays_hash": about["arrays_hash"], "fails": [], "rows": []}
    (folder / CERTIFICATE).write_text(json.dumps(empty))
    row = {"environment": "FlexRRR-v0", "settled": 0.986, "settling_time": 3.184, "vibration": 6.6e-5}
    (folder / METADATA).write_text(json.dumps({**about, "league": row}))
    reached = "Made up. FlexRRR-v0: 99% settle, median 3.18 s, vibration 0.066 mm. "
    assert certificate_file.describe_policy("still") == reached + "Within all limits of its certificate."
    fails = ["FlexRRR-v0@mujoco", "FlexRRR-v0/nominal/delay=2+given"]
    reasons = ["vibration 3 mm (limit 2 mm)", "80% settle (limit 95%), settling in 3.00 s (limit 2.60 s)"]
    rows = [{"scenario": name, "fails": text} for name, text in zip(fails, reasons, strict=True)]
    (folder / CERTIFICATE).write_text(json.dumps({**empty, "fails": fails, "rows": rows}))
    assert certificate_file.exceeded_limits("still") == [("@mujoco", reasons[0]), ("delay=2", reasons[1])]
    text = "Beyond its limits: @mujoco: vibration 3 mm (limit 2 mm); delay=2: 80% settle (limit 95%)."
    assert certificate_file.describe_policy("still").endswith(text)
    (folder / CERTIFICATE).write_text(json.dumps({**empty, "arrays_hash": "another"}))
    assert certificate_file.describe_policy("still").endswith(" It has no certificate.")


@pytest.mark.parametrize("row", [{}, 3, {"scenario": 3}, {"settled": 1.0}])
def test_a_certificate_with_a_row_of_no_scenario_is_refused_in_one_line(folder, row):
    about = json.loads((folder / METADATA).read_text())
    (folder / CERTIFICATE).write_text(json.dumps({"arrays_hash": about["arrays_hash"], "fails": [], "rows": [row]}))
    assert "this is no certificate (give rows that are mappings with a scenario)" in refusal(read_certificate, folder)


def episodes(vibration=0.0, failed=0.0, settled=1.0, count=1, time=2.0, excess=np.nan):
    """Rows with these metrics, 0 for all others."""
    values = dict.fromkeys(VALUES, 0.0) | {
        "excess": excess, "vibration": vibration, "failed": failed, "settled": settled,
        "settling_time": time if settled else np.inf,
    }  # fmt: skip
    return [EpisodeRow("", "a", "b", 9000 + i, tuple(values.values())) for i in range(count)]


@pytest.mark.parametrize(
    ("scenario", "found", "said"),
    [
        ("a", episodes(count=20), ""),
        ("a", episodes(count=18) + episodes(settled=0.0, count=2), "90% settle (limit 95%)"),
        ("a/delay=3", episodes(count=19) + episodes(settled=0.0), ""),
        ("a/delay=3", episodes(count=18) + episodes(settled=0.0, count=2), "90% settle (limit 95%)"),
        ("a/delay=3", episodes(count=99) + episodes(failed=1.0), "1% end at a limit of the environment"),
        ("a", episodes(count=99, excess=0.0) + episodes(excess=0.123), "12 % beyond the limits of the environment"),
        ("a/delay=3+given", episodes(time=2.59), ""),
        ("a/delay=3+given", episodes(time=2.61), "settling in 2.61 s (limit 2.60 s)"),
        ("a/delay=3+given", episodes(settled=0.0), "0% settle (limit 95%), settling in inf s (limit 2.60 s)"),
        ("a/payload=3+given", episodes(4.9e-3), ""),
        ("a/payload=3+given", episodes(5.1e-3), "vibration 5.1 mm (limit 5 mm)"),
        ("a", episodes(5.1e-3), "vibration 5.1 mm (limit 5 mm)"),
        ("a@finer", episodes(1.9e-3), ""),
        ("a@finer", episodes(2.1e-3), "vibration 2.1 mm (limit 2 mm)"),
        ("a@mujoco", episodes(3e-3), "vibration 3 mm (limit 2 mm)"),
        ("a/method=gauss_2", episodes(3e-3), ""),
        ("a/method=gauss_2", episodes(np.inf), "vibration inf mm (limit 5 mm)"),
    ],
)
def test_a_row_fails_for_what_it_says(scenario, found, said):
    """Of an arm of 8.5 m that vibrates by 1 mm and settles within 2 s as trained."""
    assert certificate._certificate_row(scenario, SEEDS, found, episodes(1e-3), 8.5)["fails"] == said


def test_limits_of_vibration_are_fractions_of_the_reach_and_on_other_plants_never_above_that_of_all():
    """An arm of 0.85 m may vibrate by 0.5 mm, and on another plant by 0.1 mm more than as trained."""
    for scenario, before, vibration, fails in (
        ("a", 0.0, 4.9e-4, False), ("a", 0.0, 5.1e-4, True), ("a@finer", 1e-4, 1.9e-4, False),
        ("a@finer", 1e-4, 2.1e-4, True), ("a@mujoco", 4.5e-4, 5.1e-4, True),
    ):  # fmt: skip
        assert (
            bool(certificate._certificate_row(scenario, SEEDS, episodes(vibration), episodes(before), 0.85)["fails"])
            == fails
        )


def test_other_physics_are_compared_with_the_episodes_as_trained(folder, tmp_path, monkeypatch):
    """Of the same seeds: the first row of the certificate; of an arm of 1 m, with 0.12 mm more on another plant."""
    louder = {"": 1e-4, "@finer": 3e-4, "/method=midpoint_2": 7e-4, "/delay=3+given": 7e-4, "/delay=3": 8e-4}

    def league(agents, names, seeds, *_):
        vibration = louder.get(names[0].removeprefix(str(folder)), 1e-4)
        found = [row._replace(seed=seed) for seed in seeds for row in episodes(vibration)]
        return SimpleNamespace(cells={}, rows={(names[0], agents[0], row.seed): row for row in found})

    monkeypatch.setattr(certificate, "run_league", league)
    result = json.loads(certify(str(folder), SEEDS, 1, tmp_path, log=list).read_text())
    assert result["fails"] == [f"{folder}{each}" for each in ("@finer", "/method=midpoint_2", "/delay=3+given")]


def test_another_method_takes_a_quarter_of_the_step():
    usual, other = find_scenario("FlexPlanar-v0").environment, find_scenario("FlexPlanar-v0/method=gauss_2")
    batch = FlexManEnv(name=usual.id).episodes.batch
    assert other.given == other.environment and other.environment.method == "gauss_2"
    assert 4.0 * batch.substeps * other.environment.step == pytest.approx(batch.control_period)


def test_what_the_training_drew_is_left(folder):
    """A policy that learned with payloads and stiffness is run beyond them."""
    about, arrays = made_up()
    drawn = {"payload_mass": [0.0, 0.2], "joint_stiffness_factor": [0.7, 1.3], "link_stiffness_factor": [0.8, 1.3]}
    about["recipe"]["settings"]["environment"] = {**DESCRIBED.to_plain(), "randomisation": drawn}
    write_policy(folder, about, arrays)
    names = certificate._certificate_scenarios(str(folder))
    assert {f"{folder}/payload=0.2:0.25+given", f"{folder}/stiffness=0.55:0.7"} <= {*names}
    changed = find_scenario("FlexRRR-v0/unknown/delay=3")
    assert changed.environment.randomisation.given["delay"] == [3, 3]
    assert changed.environment.disturbances.payload_mass == (0.0, 20.0)


def test_friction_is_that_of_the_named_arm_and_no_other_arm_is_run_with_it(tmp_path):
    named, own = find_scenario("FlexRRR-v0/friction"), find_scenario("FlexRRR-v0/nominal/friction=1")
    assert own.environment.arm == named.environment.arm and own.given == Configuration()
    half = find_scenario("FlexRRR-v0/unknown/friction=0.5").environment
    assert [joint.coulomb_friction for joint in half.arm.joints] == [53.0, 11.4, 14.25]
    data = DESCRIBED.to_plain()
    data["arm"] = {**data["arm"], "payload": {"mass": 0.15}}
    about, arrays = made_up(Configuration.from_plain(data))
    about["recipe"]["settings"]["environment"] = data
    write_policy(tmp_path / "own", about, arrays)
    write_still(tmp_path / "still")
    assert [any("/friction=" in each for each in certificate._certificate_scenarios(str(tmp_path / name)))
            for name in ("still", "own")] == [True, False]  # fmt: skip


@pytest.mark.parametrize(
    ("flexible", "stiffness", "stiffnesses"),
    [(True, None, ["stiffness=0.7:1.3"]), (False, 900.0, ["stiffness=0.7:1.3"]), (False, None, [])],
)
def test_ranges_beyond_the_training_are_those_of_the_arm(flexible, stiffness, stiffnesses):
    """An arm is run with 0 to 2 times its own payload, and with the stiffness of what bends."""
    link = fm.Link.tube(0.5, 0.03, 0.002, material="aluminium")
    link = link if flexible else replace(link, flexible=False)
    joint = fm.Joint((0.0, 0.0, 1.0), torque_limit=5.0, stiffness=stiffness, rotor_inertia=0.02)
    arm = fm.Arm([link, link], [joint, joint], fm.Payload(0.3), gravity=(0.0, 0.0, 0.0))
    own = Configuration("FlexRRR-v0", {"arm": arm})
    changes = certificate._changes_beyond_training(own, own)
    assert changes == ["payload=0:0.6", *stiffnesses]
    assert CHANGES["payload"].settings(own, "0:0.6")["randomisation"]["payload_mass"] == [0, 0.6]
    names = {"joint_stiffness_factor"} if stiffness else {"link_stiffness_factor"} if flexible else set()
    if names:
        assert CHANGES["stiffness"].settings(own, "0.7:1.3")["randomisation"].keys() == names
    else:
        assert "one with a spring or a flexible link" in refusal(CHANGES["stiffness"].settings, own, "0.7:1.3")


@pytest.mark.parametrize(("end", "delay"), [("+given", (3, 3)), ("", (1, 1))])
def test_a_controller_is_designed_for_the_delay_that_is_given_and_else_for_its_own(end, delay, monkeypatch):
    """Torques come 3 periods late in both; the observer of `lab-flexrrr` fits its own simulations at `delay`."""
    plants, made = [], base_and_mode.make_action_mode
    monkeypatch.setattr(
        base_and_mode, "make_action_mode",
        lambda value, plant, base: plants.append(plant) or made(value, plant, base),
    )  # fmt: skip

    def stop(agent, environment, *_, **__):
        assert environment.randomisation.given["delay"] == [3, 3]
        raise ValueError("that is enough")

    monkeypatch.setattr(rows, "rollout", stop)
    EpisodeBlock("", "lab-flexrrr", f"FlexRRR-v0/unknown-lab/delay=3{end}", 9000, 9001).run()
    assert plants[-1].delay == delay


def test_only_policies_of_tasks_in_which_something_settles(tmp_path):
    allowed = "an exported policy, by its name or folder (flexman export policy)"
    assert refusal(certify, "pd") == f"agent: 'pd' is not allowed; give {allowed}"
    path = Configuration.from_plain({"id": "FlexPlanar-Track-v0", "base": "pd", "sensors": "full", "horizon": 1.0})
    write_policy(tmp_path, *made_up(path))
    assert "a policy for a task with the metric settling_time" in refusal(certify, str(tmp_path))


def test_shipped_certificates_have_the_scenarios_of_a_league():
    for name in POLICIES:
        *known, search = read_certificate(FOLDER / name)["rows"]
        assert [row["scenario"] for row in known] == certificate._certificate_scenarios(name)
        assert search["scenario"] == known[0]["scenario"] and len(search["worst"]) == 5


def test_certificates_and_the_league_have_the_same_numbers():
    """Of each shipped policy and scenario whose episodes stand in both."""
    with LEAGUE.open(newline="") as file:
        found = [row for row in csv.DictReader(file) if row["agent"] in POLICIES]
    compared = 0
    for name in POLICIES:
        for row in read_certificate(FOLDER / name)["rows"]:
            episodes = {int(each["seed"]): each for each in found
                        if each["agent"] == name and each["scenario"] == row["scenario"]}  # fmt: skip
            seeds = range(*row["seeds"])
            if not set(seeds) <= episodes.keys():
                continue
            compared += 1
            for metric in METRIC_NAMES:
                value = METRICS[metric].aggregate(np.array([float(episodes[seed][metric]) for seed in seeds]))
                assert row[metric] == pytest.approx(value, rel=1e-3, abs=1e-8), (name, row["scenario"], metric)
    assert compared >= 2 * len(POLICIES) - 1, "the environment of each, and MuJoCo"


@pytest.mark.slow
@pytest.mark.parametrize("number", range(10))
def test_a_cell_of_a_certificate_is_the_episode_of_the_policy_in_its_own_changed_environment(number):
    """Ten cells by seed; the expected environment is that in the file of the policy, changed without a name.

    A named environment has the default method, the files have that of the training.
    """
    random = np.random.default_rng(number)
    name = str(random.choice(POLICIES))
    scenario = str(random.choice([each for each in certificate._certificate_scenarios(name) if "mujoco" not in each]))
    agent, seed = find_agent(name), int(random.integers(9000, 9100))
    change = scenario.removesuffix("+given").partition("@")[0].rpartition("/")[2]
    own = changed = agent.environment.without(["method"])
    if "=" in change:
        known, _, value = change.partition("=")
        span = [float(each) if "." in each or known != "delay" else int(each) for each in (value.split(":") * 2)[:2]]
        ranges = {"payload": ("payload_mass",), "delay": ("delay",), "noise": ("sensor_noise",),
                  "stiffness": ("joint_stiffness_factor", "link_stiffness_factor")}  # fmt: skip
        settings = {"friction": lambda: {"arm": Configuration.find(f"{own.id}/friction").given["arm"]},
                    "method": lambda: {"method": value, "step": find_scenario(scenario).environment.step},
                    }.get(known, lambda: {"randomisation":
                        own.randomised_ranges | dict.fromkeys(ranges[known], span)})()  # fmt: skip
        changed = own.replace(**settings)
    given = changed if scenario.endswith("+given") or "method" in change else own
    set_plant = PLANTS[scenario.partition("@")[2] or "usual"][1]
    (record,) = rollout(agent.timed(given)[0], changed, [seed], set_plant=set_plant).records
    _, (row,) = EpisodeBlock("", name, scenario, seed, seed + 1).run()
    values = dict(zip(VALUES, row.values, strict=True))
    assert {each: values[each] for each in METRIC_NAMES} == {
        each: METRICS[each].function(record) for each in METRIC_NAMES
    }
