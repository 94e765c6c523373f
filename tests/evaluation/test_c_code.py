"""Controllers in C: torques equal to those in Python, no warnings of a compiler, and refusals in one line."""

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest
from scipy.io import loadmat

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.control import EpisodeInfo, KalmanFilter, OutputFeedback, Tracking
from flexman_gym.control.network import Network
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.specification import make_plant
from flexman_gym.evaluation import AgentSpec
from flexman_gym.evaluation.c_code import begin_agent, write_c

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed: the C code is not compiled")
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
ONE, PLANAR = "FlexOne-v0", "FlexPlanar-v0"


def network(algo, **settings):
    """Return a policy with random weights and these settings of an agent, on FlexPlanar-v0."""
    environment, random = Configuration(PLANAR, {"sensors": ["motor_encoders"], **settings}), np.random.default_rng(3)
    history = settings.get("history", 1)
    size = 4 * (history if isinstance(history, int) else 1 + len(history))
    prefix, last = {"ppo": ("mlp_extractor.policy_net.", "action_net"), "sac": ("actor.latent_pi.", "actor.mu")}[algo]
    parameters = {}
    for name, (m, k) in {f"{prefix}0": (7, size), f"{prefix}2": (6, 7), last: (2, 6)}.items():
        parameters |= {f"{name}.weight": random.normal(0.0, 0.4, (m, k)), f"{name}.bias": random.normal(0.0, 0.1, m)}
    moments = {"mean": random.normal(0.0, 0.3, size), "var": random.uniform(0.1, 1.0, size)}
    return AgentSpec.from_network(f"net-{algo}", Network(algo, None, parameters, moments), environment)


AGENTS = {
    "pd": ("pd", "FlexRRR-v0"),
    "pd with gravity": ("pd", PLANAR),
    "pd of a path": ("pd", "FlexRRR-Track-v0"),
    "lqr": ("lqr", PLANAR),
    "lqr-tracking": ("lqr-tracking", PLANAR),
    "pd-shaped": ("pd-shaped", PLANAR),
    "lqg": ("lqg", PLANAR),
    "shipped policy": ("ppo-flexplanar", ""),
    "history": (lambda: network("ppo", history=3, action_repeat=2), ""),
    "averages": (lambda: network("sac", history=(0.05, 0.4), base="pd"), ""),
}


@pytest.fixture(scope="module", params=AGENTS)
def exported(request, tmp_path_factory):
    """Return the session of an agent, and the folder of its files."""
    agent, environment = AGENTS[request.param]
    session = begin_agent(agent() if callable(agent) else agent, environment)
    folder = tmp_path_factory.mktemp("c")
    write_c(session, folder)
    return session, folder


class Compiled:
    """Controller in C as a shared library."""

    def __init__(self, folder, joints):
        (self.source,) = (path for path in folder.glob("*.c") if path.name != "main.c")
        library = folder / "controller.so"
        subprocess.run(
            ["gcc", *FLAGS, "-O1", "-shared", "-fPIC", self.source, "-o", library, "-lm"], cwd=folder, check=True
        )
        loaded, name = ctypes.CDLL(str(library)), self.source.stem
        self._step, self._state = getattr(loaded, f"{name}_step"), (ctypes.c_double * 4096)()
        self._torque, self._pointer = np.zeros(joints), ctypes.POINTER(ctypes.c_double)
        move = ctypes.byref(ctypes.c_char.in_dll(loaded, f"{name}_exported"))
        getattr(loaded, f"{name}_reset")(self._state, move)

    def step(self, readings):
        arrays = (np.ascontiguousarray(each).ctypes.data_as(self._pointer) for each in (readings, self._torque))
        self._step(self._state, *arrays)
        return self._torque.copy()


def difference(session, folder, steps):
    """Return the largest difference of torques for random readings, as a fraction of the torque limits.

    Readings scatter by up to 30 % about those at the start, so that torques are at their limits and between them.
    """
    agent, (start, goal), random = session.episodes.agent, session.move, np.random.default_rng(0)
    limits, period = np.array(session.environment.torque_limit), session.environment.control_period
    first, agent.law = session.readings(), session.spec.law
    agent.reset(np.zeros(1, dtype=np.int64), EpisodeInfo(start[None], goal[None], period), 1)
    compiled, applied, worst, inside = Compiled(folder, len(limits)), np.zeros((1, len(limits))), 0.0, 0
    for _ in range(steps):
        row = first + (0.02 + 0.3 * np.abs(first)) * 10.0 ** random.uniform(-4.0, 0.0) * random.normal(size=len(first))
        named = {name: row[None, begin : begin + size] for name, (begin, size, _) in session.layout.items()}
        applied = np.asarray(agent.act(named, applied, np.array([True])), dtype=float)
        worst = max(worst, np.abs(compiled.step(row) / limits - applied[0]).max())
        inside += (np.abs(applied) < 1.0).any()
    assert 0.1 * steps < inside
    return worst


def test_torques_are_those_of_python(exported):
    assert difference(*exported, 300) <= 1e-12


def test_torques_of_many_periods_are_those_of_python(exported):
    assert difference(*exported, 10_000) <= 1e-12


def test_the_test_program_passes_without_warnings_and_undefined_behaviour(exported):
    _, folder = exported
    sources = sorted(folder.glob("*.c"))
    sanitize = ["-fsanitize=undefined,address", "-fno-sanitize-recover=all"]
    subprocess.run(["gcc", *FLAGS, *sanitize, *sources, "-o", folder / "test", "-lm"], check=True)
    done = subprocess.run([folder / "test"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""
    assert float(done.stdout.split("difference ")[1].split()[0]) <= 1e-12


def test_the_test_program_prints_durations_of_steps_by_both_clocks(tmp_path):
    write_c(begin_agent("pd", ONE), tmp_path)
    subprocess.run(["gcc", *FLAGS, "-O2", "main.c", "pd.c", "-o", "test", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "test", "time"], capture_output=True, text=True, check=True)
    clocks = []
    for line in done.stdout.splitlines():
        clock, *numbers = re.fullmatch(
            r"(\w+) time of a step: longest (\d+) ns, 99\.9 % (\d+) ns, median (\d+) ns", line
        ).groups()
        assert sorted(map(int, numbers), reverse=True) == list(map(int, numbers))
        clocks.append(clock)
    assert clocks == ["wall", "CPU"]


def test_a_linear_filter_and_regulator_are_those_of_the_nonlinear_ones_to_first_order(tmp_path):
    """The difference from the extended filter with a fixed gain falls with the square of the deviation."""
    session = begin_agent("lqg", PLANAR)
    write_c(session, tmp_path)
    goal, bare, model = session.move[1], session.environment, session.episodes.batch.model
    plant, here, active = make_plant(bare, model), np.zeros(1, dtype=np.int64), np.array([True])
    matrix = session.episodes.agent.base.move_tables()
    differences = []
    for size in (0.02, 0.01):
        agent = OutputFeedback(KalmanFilter(plant, fixed=True), Tracking(plant))
        agent.reset(here, EpisodeInfo(goal[None], goal[None], plant.period), 1)
        compiled, applied, worst = Compiled(tmp_path, 2), np.zeros((1, 2)), 0.0
        direction, omega = matrix["from_angles"] @ [size, -size], 3.0  # rad/s
        for phase in omega * plant.period * np.arange(30):
            moved = np.cos(phase) * direction - omega * np.sin(phase) * np.roll(direction, len(direction) // 2)
            row = matrix["C"] @ (matrix["rest"] + moved)
            named = {name: row[None, begin : begin + count] for name, (begin, count, _) in session.layout.items()}
            applied = agent.act(named, applied, active)
            assert np.abs(applied).max() < 1.0
            worst = max(worst, np.abs(compiled.step(row) / plant.torque_limit - applied[0]).max())
        differences.append(worst)
    assert 3.0 < differences[0] / differences[1] < 5.0


@pytest.mark.parametrize(("agent", "environment", "line"), [
    ("adaptive-lqr", ONE, "agent: 'adaptive-lqr' is not allowed; give pd, pd-shaped, "),
    ("mpc", ONE, "others simulate arms while they run"),
    ("lab-flexrrr", "", "a policy on one of the first four"),
    ("lqr", f"{PLANAR}/friction", "a model without friction"),
    ("lqg", f"{PLANAR}/delay", "lqg: 'a filter with a delay, disturbed or biased' is not allowed"),
])  # fmt: skip
def test_agents_that_simulate_are_refused_in_one_line(agent, environment, line, tmp_path, capsys):
    words = ["export", "c", agent, "--out", str(tmp_path / "c"), *(["--env", environment] if environment else [])]
    assert main(words) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert line in said and not (tmp_path / "c").exists()


def test_a_mat_file_has_linear_model_names_and_gains(tmp_path, capsys):
    """The sampled model is that of `discrete`; gains are those of the agent; an environment has no gains."""
    path, posture = tmp_path / "arm.mat", [0.3, -0.5]
    assert main(["export", "matlab", "lqr", "--env", PLANAR, "--goal=0.3,-0.5", "--out", str(path)]) == 0
    assert "Ad" in capsys.readouterr().out
    data = loadmat(path, simplify_cells=True)
    session = begin_agent("lqr", PLANAR, goal_angles=posture)
    model = session.episodes.batch.model
    state, torque = fm.rest_state(model, posture), fm.holding_torques(model, posture)
    linear = fm.linearize(model, state=state, torque=torque)
    sampled = linear.discrete(session.environment.control_period)
    for name, expected in {"A": linear.A, "B": linear.B, "Ad": sampled.A, "Bd": sampled.B}.items():
        assert np.array_equal(data[name], expected)
    assert np.array_equal(data["C"][:3], linear.C) and tuple(data["states"]) == linear.states
    assert np.array_equal(data["agent"]["gains"], session.episodes.agent.base.gain(np.array(posture)))
    assert np.abs(np.linalg.eigvals(data["Ad"] - data["Bd"] @ data["agent"]["gains"])).max() < 1.0
    assert main(["export", "matlab", ONE, "--out", str(path)]) == 0 and "agent" not in loadmat(path)


def test_a_wrong_goal_is_refused_in_one_line(capsys):
    assert main(["export", "c", "pd", "--env", PLANAR, "--goal", "0.3"]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "goal_angles" in said
