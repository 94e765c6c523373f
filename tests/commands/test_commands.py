"""Commands: each does what its help says, in few lines, and says what is wrong in one."""

import ast
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import COMMAND_GROUPS, main
from flexman_gym.agent.base_controllers import BASES
from flexman_gym.commands import load_scene, name_unused
from flexman_gym.commands.list import KINDS
from flexman_gym.commands.optimise import PURPOSES
from flexman_gym.common.registry import REGISTERED
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.settings import SETTINGS
from flexman_gym.envs.registration import CONDITIONS
from flexman_gym.envs.sensors import SENSOR_NAMES
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.trained_agents import AGENTS
from flexman_gym.toolbox.diagnosis.diagnosis import REMEDIES, RINGING, TRAINING_REMEDIES, Diagnosis, diagnose
from flexman_gym.toolbox.league import certificate, page, rows
from flexman_gym.toolbox.league.rows import EpisodeBlock, LeagueRows
from flexman_gym.toolbox.league.scenarios import PLANT_SCENARIOS, USUAL_SCENARIOS
from flexman_gym.toolbox.league.standings import SWEPT_AGENTS, Standings

from oracles.files import REFERENCE, ROOT

COMMANDS = sorted(path.stem for path in (ROOT / "flexman_gym" / "commands").glob("[a-z]*.py"))
SCENE = str(REFERENCE / "pendulum_1.json")
SCREEN = 40  # lines
# The reference scenes hold the section of `one_link`, which no section can have.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


def _docstring(command):
    """Return the docstring of the file of a command."""
    text = (ROOT / "flexman_gym" / "commands" / f"{command}.py").read_text(encoding="utf-8")
    return ast.get_docstring(ast.parse(text))


@pytest.mark.slow
def test_help_names_every_command_and_fits_a_screen(capsys):
    for given in [["--help"], *([name, "--help"] for name in COMMANDS if name != "demo")]:
        with pytest.raises(SystemExit) as stop:
            main(given)
        said = capsys.readouterr().out
        assert stop.value.code == 0 and len(said.splitlines()) <= SCREEN, given
        if given == ["--help"]:
            assert all(f"    {name} " in said or f"    {name}\n" in said for name in COMMANDS)
    for name in COMMANDS:
        assert _docstring(name).splitlines()[0].endswith(".")


def test_help_has_every_command_in_one_group_and_a_line(capsys):
    """For who begins, learns, evaluates, simulates, controls, or wants data; on a screen of 80 columns."""
    assert sorted(name for names in COMMAND_GROUPS.values() for name in names) == COMMANDS
    assert [*COMMAND_GROUPS] == ["start", "learn", "evaluate", "simulate", "control", "data"]
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    text = " ".join("\n".join(lines).split())
    for group, names in COMMAND_GROUPS.items():
        within = text.partition(f" {group}: ")[2]
        summaries = [f"{name} {_docstring(name).splitlines()[0].rstrip('.')}" for name in names]
        assert within.startswith(" ".join(summaries)), "each summary as a whole"


def test_program_alone_prints_its_help(capsys):
    helps = []
    for given in ([], ["--help"]):
        with pytest.raises(SystemExit) as stop:
            main(given)
        assert stop.value.code == 0
        helps.append(capsys.readouterr().out)
    assert helps[0] == helps[1] and helps[0].startswith("usage: flexman COMMAND [options]")


@pytest.mark.parametrize(("typed", "meant"), [("trian", "train"), ("eval", "evaluate"), ("sim", "simulate"),
                                              ("optimize", "optimise"), ("shappe", "shape")])  # fmt: skip
def test_a_misspelt_command_is_answered_with_the_nearest(typed, meant, capsys):
    with pytest.raises(SystemExit) as stop:
        main([typed, "--help"])
    line = capsys.readouterr().err.splitlines()[-1]
    assert stop.value.code == 2 and line.startswith("flexman: error: command: ")
    assert f"the nearest is {meant}" in line and typed in line


@pytest.mark.parametrize("kind", PURPOSES)
def test_each_kind_of_optimisation_has_its_help(kind, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["optimise", kind, "--help"])
    assert stop.value.code == 0 and len(capsys.readouterr().out.splitlines()) <= SCREEN


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_the_version_is_that_of_the_package(option, capsys):
    with pytest.raises(SystemExit) as stop:
        main([option])
    assert stop.value.code == 0 and capsys.readouterr().out == f"{fm.__version__}\n"


@pytest.mark.slow
def test_list_has_all_that_has_a_name(capsys):
    pytest.importorskip("stable_baselines3")
    names = {
        "environments": NAMED_ENVIRONMENTS, "conditions": CONDITIONS, "controllers": BASES, "sensors": SENSOR_NAMES,
        "methods": fm.METHODS, "settings": SETTINGS,
    }  # fmt: skip
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.rstrip(":") for line in lines if not line.startswith(" ")] == list(KINDS)
    assert max(len(line) for line in lines if str(ROOT) not in line) <= 100
    for what, known in names.items():
        assert main(["list", what]) == 0
        said = capsys.readouterr().out.splitlines()
        first = [line.split()[0] for line in said[1:] if line[2] != " "]  # a longer description goes on below
        assert said[0] == f"{what}:" and first == list(known)
        assert all(line in lines for line in said)


def test_examples_are_listed_with_their_paths_and_a_sentence(capsys):
    assert main(["list", "examples"]) == 0
    text = capsys.readouterr().out.partition("\n")[2]
    lines = [each.strip().split(maxsplit=1) for each in re.split(r"\n(?=  /)", text)]
    assert [path for path, _ in lines] == sorted(str(path) for path in (ROOT / "docs/examples").glob("*.*"))
    assert all(len(words.split()) > 3 for _, words in lines)


@pytest.mark.slow
@pytest.mark.parametrize("condition", ["unknown-lab", "friction"])
def test_the_title_of_an_evaluation_has_the_condition(condition, capsys):
    words = ["evaluate", "zero", "--env", f"FlexRRR-v0/{condition}", "--episodes", "1"]
    assert main(words) == 0
    assert capsys.readouterr().out.startswith(f"1 episodes of FlexRRR-v0/{condition}, the same for all")
    assert main([*words, "--set", "horizon=1.0"]) == 0
    assert f"FlexRRR-v0/{condition}," not in capsys.readouterr().out


def test_a_refused_agent_is_left_out_of_the_table(capsys):
    words = ["evaluate", "adaptive-lqr", "zero", "--env", "FlexGantry-v0", "--episodes", "1"]
    assert main(words) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("adaptive-lqr is left out: base: ") and "zero " in printed.out


def test_settings_of_an_agent_in_a_file_are_named_if_unused(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    for settings, unused in (("base: pd\nhistory: 2\n", "base, history"), ("horizon: 0.1\n", "")):
        path.write_text(f"id: FlexOne-v0\n{settings}")
        assert main(["evaluate", "zero", "--env", str(path), "--episodes", "1"]) == 0
        printed = capsys.readouterr().err
        assert f"{path} without {unused}: " in printed if unused else str(path) not in printed
    path.write_text("id: FlexOne-v0\nbase: pd\nhistory: 2\n")
    named = Configuration.find(str(path))
    used = AgentSpec("policy of a zip", interface={"base": "pd"})
    name_unused(str(path), named, named.without(["base", "history"]), [used])
    assert capsys.readouterr().err.startswith(f"{path} without history: ")
    assert main(["why", "zero", "--env", str(path), "--episodes", "1", "--set", "horizon=0.5"]) == 0
    assert f"{path} without base, history: " in capsys.readouterr().err


def test_an_agent_without_its_package_is_left_out_of_the_table(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "daqp", None)
    assert main(["evaluate", "zero", "mpc", "--env", "FlexOne-v0", "--episodes", "1"]) == 2
    printed = capsys.readouterr()
    assert "zero " in printed.out and "mpc " not in printed.out
    assert printed.err.splitlines()[-1].startswith("mpc is left out: ") and "pip install" in printed.err
    assert main(["evaluate", "mpc", "--env", "FlexOne-v0", "--episodes", "1"]) == 2
    assert "left out" not in capsys.readouterr().err


def test_an_error_in_a_file_of_the_user_has_its_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(REGISTERED, "{}")  # restored afterwards: the file is registered for later processes
    path = tmp_path / "mine.py"
    path.write_text("import numpy as np\n\n\ndef make(plant):\n    return np.linalg.inv(np.zeros((2, 2)))\n")
    assert main(["evaluate", str(path), "--env", "FlexOne-v0", "--episodes", "1"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "mine.py, line 5: LinAlgError: Singular matrix"
    assert main(["evaluate", "pd", "--env", "FlexOne-v9"]) == 2
    assert "line" not in capsys.readouterr().err


def test_agents_are_listed_as_controllers_and_policies(capsys):
    assert main(["list", "agents"]) == 0
    together = capsys.readouterr().out
    assert main(["list", "controllers", "policies"]) == 0
    assert together == capsys.readouterr().out


def test_simulate_keeps_the_motion_as_a_table(tmp_path, capsys):
    out = tmp_path / "motion.csv"
    assert main(["simulate", SCENE, "--method", "dop853", "--rtol", "1e-8", "--out", str(out)]) == 0
    expected = fm.simulate(fm.Scene.load(SCENE), method="dop853", rtol=1e-8)
    with out.open() as file:
        heads = file.readline().strip().split(",")
        rows = np.loadtxt(file, delimiter=",")
    assert heads == ["time", "tip_1", "tip_2", "tip_3", "joint_angle_1", "motor_angle_1", "energy"]
    assert rows[:, 0] == pytest.approx(expected.time) and rows[:, 1:4] == pytest.approx(expected.tip, abs=1e-11)
    assert rows[:, -1] == pytest.approx(expected.energy, rel=1e-10, abs=1e-10)
    said = capsys.readouterr().out
    assert said.startswith(f"status: ok, to {expected.time[-1]:g} s") and "largest residual" in said


def test_simulate_warns_of_large_bending_and_of_a_residual_of_the_energy(tmp_path, capsys):
    """Aluminium links under the torques of the paper bend by a third of their length."""
    scene = fm.catalog.paper_scene("ff")
    soft = [replace(link, youngs_modulus=70e9, shear_modulus=26e9, density=2700.0) for link in scene.arm.links]
    path = tmp_path / "soft.yaml"
    replace(scene, arm=replace(scene.arm, links=soft)).save(path)
    assert main(["simulate", str(path)]) == 0
    (line,) = capsys.readouterr().err.splitlines()[-1:]
    assert re.match(r"! link 2 bends by up to 3\d% of its length; .*Try stiffening=True", line)
    assert main(["simulate", str(path), "--method", "midpoint_corrected_3", "--step", "0.005"]) == 0
    lines = capsys.readouterr().err.splitlines()[-2:]
    assert lines[0].startswith("! the energy residual exceeds 1 %") and " bends by up to " in lines[1]
    assert main(["simulate", "paper_rr"]) == 0 and capsys.readouterr().err == ""


@pytest.mark.parametrize("case", ["rr", "fr", "ff"])
def test_scenes_of_the_paper_have_names(case):
    assert load_scene(f"paper_{case}") == fm.catalog.paper_scene(case)
    assert load_scene(str(REFERENCE / f"paper_{case}.json")) == fm.Scene.load(REFERENCE / f"paper_{case}.json")


def test_a_simulation_that_diverges_ends_with_1(capsys):
    assert main(["simulate", str(REFERENCE / "paper_ff.json"), "--method", "rk4", "--step", "0.02"]) == 1
    assert capsys.readouterr().out.startswith("status: diverged")


@pytest.mark.slow
def test_choose_says_model_method_error_and_what_was_left_out(capsys):
    assert main(["choose", str(REFERENCE / "paper_rr.json"), "--tolerance", "0.01"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("method: ") and lines[2] == "coordinates: 3"
    assert lines[1].startswith("model: elements=") and lines[1].endswith("stiffening=False")
    assert 0.0 < float(lines[3].split(": ")[1].split()[0]) <= 10.0


@pytest.mark.slow
def test_precision_charts_a_scene_with_the_default(tmp_path, monkeypatch, capsys):
    """Errors fall until the model decides; the default of the environments is a row, with a ring in the chart."""
    monkeypatch.chdir(tmp_path)
    scene = str(REFERENCE / "paper_ff.json")
    assert main(["precision", scene, "--method", "gauss_3", "--step", "0.02", "--own", "--all"]) == 0
    first, head, *lines, last, picture = capsys.readouterr().out.splitlines()
    assert first.startswith(
        "reference: 4 elements a link, foreshortening, gauss_3; its error of mesh and steps is about 0."
    )
    assert head.split()[:2] == ["model", "method"]
    assert [line.split()[-1] for line in lines].count("default") == 1 and "midpoint_corrected_3" in lines[0]
    mesh = [line.split() for line in lines if line.startswith("2 elements a link, foreshortening gauss_3")]
    errors = [float(words[-2]) for words in mesh]
    assert [float(words[-3]) for words in mesh] == [20.0, 10.0, 5.0, 2.5, 1.25, 0.625, 0.312]
    assert errors[0] > 1.5 * errors[-1] > 0.0
    assert last.startswith("The default: ") and picture == "out/precision.png has the chart"
    assert (tmp_path / "out" / "precision.png").stat().st_size > 10_000


def test_an_arm_is_exported(tmp_path, capsys):
    """Of a named environment, of a file of an arm, and of one of an environment."""
    path = tmp_path / "arm.xml"
    files = [f"{ROOT}/docs/examples/{name}.yaml" for name in ("four_link_arm", "planar_payload")]
    for given, motors in (([], 3), (["FlexOne-v0", "--pieces", "2"], 1), (files[:1], 4), (files[1:], 2)):
        assert main(["export", "mujoco", *given, "--out", str(path)]) == 0
        root = ElementTree.parse(path).getroot()
        assert len(root.findall("actuator/motor")) == motors
    assert root.find(".//body[@name='payload']/inertial").get("mass") == "0.3"
    assert "2 links of 8 pieces" in capsys.readouterr().out.splitlines()[-1]


@pytest.mark.slow
def test_the_league_is_played_and_grows(tmp_path, capsys):
    """By one entrant more, where the others have played, and by no run that is not there."""
    where = ["--folder", str(tmp_path)]
    assert (
        main(
            [
                "league",
                *where,
                "--episodes",
                "2",
                "--agents",
                "zero",
                "privileged-lqr",
                "--scenarios",
                "FlexOne-v0",
            ]
        )
        == 0
    )
    assert main(["league", *where, "--add", "pd"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(",")[0] for line in lines if " of " in line] == [
        "1 of 2: zero on FlexOne-v0", "2 of 2: privileged-lqr on FlexOne-v0", "1 of 1: pd on FlexOne-v0"
    ]  # fmt: skip
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 1 + 3 * 2, "as many episodes as the others"
    assert all(any(line.startswith(f"{agent} ") for line in lines) for agent in ("zero", "privileged-lqr", "pd"))


def test_a_league_is_redrawn_without_a_run(tmp_path, capsys, monkeypatch):
    chosen = ["--agents", "zero", "--scenarios", "FlexOne-v0"]
    assert main(["league", "--folder", str(tmp_path), "--episodes", "1", *chosen]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:3] == ["agent  FlexOne-v0", "zero          0 %"]
    page = (tmp_path / "league.md").read_bytes()
    (tmp_path / "league.md").write_text(page.decode().partition("Computed")[1] + page.decode().partition("Computed")[2])
    monkeypatch.setattr(rows, "run_league", None)
    assert main(["league", "--folder", str(tmp_path), "--redraw"]) == 0
    assert capsys.readouterr().out.splitlines() == lines[1:] and (tmp_path / "league.md").read_bytes() == page
    assert main(["league", "--folder", str(tmp_path), "--details", "zero", "FlexOne-v0"]) == 0
    assert "information: nothing" in (out := capsys.readouterr().out) and "FlexOne-v0: 1 episodes" in out


def test_a_league_takes_few_episodes_on_other_plants_and_those_of_others_for_one_more(tmp_path, monkeypatch):
    runs, entrants = {}, []

    def run_league(agents, scenarios, seeds, *_):
        runs[len(seeds)] = [*scenarios]
        entrants[:] = agents
        return LeagueRows()

    def found(*options):
        runs.clear()
        assert main(["league", "--folder", str(tmp_path), *options]) == 0
        return dict(runs)

    monkeypatch.setattr(rows, "run_league", run_league)
    monkeypatch.setattr(Standings, "settling_table", lambda *_: [])
    monkeypatch.setattr(page, "write_page", lambda *_: None)
    usual = {100: [each.removesuffix("/nominal") for each in USUAL_SCENARIOS]}
    assert found() == found("--add", "pd") == usual
    assert entrants == ["pd"] and found() == usual and entrants == [*AGENTS]
    assert found("--physical") == {10: [*PLANT_SCENARIOS]} and entrants == [*SWEPT_AGENTS]
    assert len(found("--sweep", "delay")[100]) == 4 and entrants == [*SWEPT_AGENTS], "those of the page"
    cells = [EpisodeBlock("", "pd", *each) for each in (("a", 9000, 9025), ("a", 9025, 9050), ("b@finer", 9000, 9010))]
    LeagueRows(cells=cells).save(tmp_path)
    assert found("--add", "pd") == {50: ["a"], 10: ["b@finer"]}


LEAGUE = ROOT / "docs" / "league"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "line"),
    [
        (["export", "mujoco", "FlexOne-v0", "--pieces", "-1"], "pieces: -1 is not allowed; give a whole number from 0"),
        (["export", "mujoco", "nowhere.yaml"], "nowhere.yaml: there is no such file"),
        (["league", "--episodes", "0"], "--episodes: 0 is not allowed; give a whole number >= 1"),
        (["league", "--redraw"], "--folder: out/league is not allowed; give the folder of a league with rows"),
        (
            ["league", "--folder", str(LEAGUE), "--details", "x"],
            "details: 'x' is not allowed; give overall, or an agent",
        ),
        (["league", "--sweep", "mass"], "sweep: 'mass' is not allowed; give one of payload"),
        (
            ["league", "--add", "nowhere"],
            "agent: nowhere does not exist; give the folder of a training run, or one of ",
        ),
        (["league", "--scenarios", "FlexPlanar-v9"], "environment: FlexPlanar-v9 does not exist"),
        (["simulate", "nowhere.json"], "nowhere.json: there is no such file"),
        (["simulate", "paper_f"], "paper_f does not exist; give a .json or .yaml file, or one of paper_rr, paper_fr, "),
        (["simulate", SCENE, "--method", "rk5"], "method: 'rk5' is not allowed; give one of "),
        (["choose", SCENE, "--tolerance", "0"], "tolerance: 0.0 is not allowed; give a finite number > 0"),
        (["precision", SCENE, "--method", "rk5"], "method: 'rk5' is not allowed; give one of "),
        (
            ["optimise", "gains", "FlexPlanar-v9"],
            "FlexPlanar-v9 does not exist; give the path of a file, or one of ",
        ),
        (["list", "robots"], "what: robots is not allowed; give some of environments, "),
    ],
)
def test_what_is_wrong_is_said_in_one_line(given, line, capsys):
    try:
        code = main(given)
    except SystemExit as stop:
        code = stop.code
    said = capsys.readouterr().err.splitlines()
    assert code == 2 and line in said[-1] and sum(not each.startswith(("usage", " ")) for each in said) == 1


@pytest.mark.slow
def test_a_command_without_its_packages_names_the_extra():
    """A process in which PyTorch cannot be imported."""
    code = "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None; "
    code += "from flexman_gym.__main__ import main; "
    code += "print(*[main(words) for words in (['train', '--steps', '1'], ['list'], ['demo'])])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and "none:  training needs" in done.stdout
    assert done.stdout.splitlines()[-1] == "2 0 2"
    line = "training needs stable_baselines3, torch: pip install 'flexman_gym[train]'"
    # what else the demo needs is said at once
    assert done.stderr.strip().splitlines() == [line, line.replace("[train]", "[train,render]")]


@pytest.mark.parametrize(("fails", "status", "words"), [
    ([], 0, "within all limits"), (["delay 3", "finer"], 1, "beyond its limits in delay 3, finer"),
])  # fmt: skip
def test_the_exit_status_says_whether_a_policy_is_within_its_limits(
    fails, status, words, tmp_path, monkeypatch, capsys
):
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps({"arrays_hash": "", "fails": fails}))
    monkeypatch.setattr(certificate, "certify", lambda *_, **__: path)
    assert main(["league", "--agent", "lab-flexrrr"]) == status
    assert capsys.readouterr().out == f"{path}: {words}\n"
    assert main(["league", "--agent", "lab-flexrrr", "--json"]) == status
    assert json.loads(capsys.readouterr().out) == json.loads(path.read_text())


def drawn(capsys, *words):
    """Files that the command says it has written, once they are pictures."""
    assert main(["draw", *map(str, words)]) == 0
    files = [Path(line) for line in capsys.readouterr().out.splitlines()]
    begins = {".png": b"\x89PNG", ".svg": b"<?xml"}
    assert all(file.read_bytes().startswith(begins[file.suffix]) for file in files)
    return files


@pytest.mark.slow
@pytest.mark.parametrize("what", ["modes", "bode", "campbell"])
def test_a_picture_of_an_environment_is_the_file_that_was_named(what, tmp_path, capsys):
    assert drawn(capsys, what, "FlexOne-v0", "--out", tmp_path / "a.png") == [tmp_path / "a.png"]


@pytest.mark.slow
def test_pictures_of_a_league_go_into_the_folder_that_was_named(tmp_path, capsys):
    before = {file: file.stat().st_mtime_ns for file in LEAGUE.iterdir()}
    assert {file.parent for file in drawn(capsys, "robustness", LEAGUE, "--out", tmp_path / "new")} == {
        tmp_path / "new"
    }
    assert {file: file.stat().st_mtime_ns for file in LEAGUE.iterdir()} == before
    assert main(["draw", "league", str(LEAGUE), "--out", str(tmp_path / "one.png")]) == 2
    assert "one.png is not allowed; give a folder" in capsys.readouterr().err


GIVEN = ["--env", "FlexPlanar-v0", "--episodes", "2", "--seed", "3", "--set", "horizon=1.0"]


def test_it_tells_of_each_entrant_the_shares_the_largest_first(capsys):
    assert main(["why", "pd", "zero", *GIVEN]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" on ")[0] for line in lines if not line.startswith(" ")] == ["pd", "zero"]
    found = diagnose("pd", Configuration("FlexPlanar-v0", {"horizon": 1.0}), [3, 4])
    for cause in REMEDIES:
        line = next(line for line in lines if line.startswith(f"  {cause} "))
        share = 100.0 * sum(each.shares[cause] for each in found) / 2.0
        assert abs(float(line.split("%")[0].split()[-1]) - share) < 0.051
        assert f"the largest share of {sum(each.cause == cause for each in found)} episodes" in line
    shares = [float(line.split("%")[0].split()[-1]) for line in lines[1:7]]
    assert shares == sorted(shares, reverse=True)
    worst = next(cause for cause in REMEDIES if lines[1].startswith(f"  {cause} "))
    assert lines[7] == f"  remedy: {REMEDIES[worst]}"


def test_where_nothing_is_left_nothing_has_to_help(capsys):
    assert main(["why", "lqr-tracking", "--env", "FlexPlanar-v0", "--episodes", "1", "--seed", "9003"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "  remedy: none needed, the error is small"


def test_it_takes_what_evaluate_takes(capsys):
    assert main(["why", "nobody", *GIVEN]) == 2
    assert capsys.readouterr().err.startswith("agent: nobody does not exist; give the folder of a training run")


def test_one_quiet_episode_does_not_hide_one_that_rings(monkeypatch, capsys):
    shares = dict.fromkeys(REMEDIES, 0.0) | {RINGING: 1.0}
    still, ringing = (Diagnosis(rms, quiet, shares, ()) for rms, quiet in ((1e-6, True), (0.05, False)))
    small = "none needed, the error is small"
    for agent, results, remedy in (("pd", [still, ringing], REMEDIES[RINGING]), ("pd", [still, still], small),
                                   ("ppo-flexplanar", [still, ringing], TRAINING_REMEDIES[RINGING])):  # fmt: skip
        monkeypatch.setattr("flexman_gym.toolbox.diagnosis.diagnosis.diagnose", lambda *_, results=results: results)
        assert main(["why", agent, *GIVEN]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == f"  remedy: {remedy}"


@pytest.mark.parametrize(("typed", "near"), [("evaluat", "evaluate"), ("sim", "simulate"), ("bogus", None)])
def test_command_is_suggested_where_it_is_near(typed, near, capsys):
    with pytest.raises(SystemExit):
        main([typed])
    line = capsys.readouterr().err.splitlines()[-1]
    assert (f"; the nearest is {near};" in line) if near else ("nearest" not in line)
