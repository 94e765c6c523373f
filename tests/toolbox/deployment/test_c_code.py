"""Controllers in C: torques equal to those in Python, for bad readings too, no warnings, and refusals in one line."""

import ctypes
import re
import resource
import shutil
import signal
import subprocess

import numpy as np
import pytest
from scipy.io import loadmat

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.agent.controller import EpisodeInfo, torque_scales
from flexman_gym.agent.network import Network
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.model.statics import rigid_holding_torques
from flexman_gym.toolbox.controllers.observers.kalman_filter import KalmanFilter
from flexman_gym.toolbox.controllers.output_feedback import OutputFeedback
from flexman_gym.toolbox.controllers.range_check import GOOD, NOT_FINITE, OUT_OF_RANGE, holding_periods
from flexman_gym.toolbox.controllers.tracking import Tracking
from flexman_gym.toolbox.deployment.c_code import begin_agent, write_c
from flexman_gym.toolbox.deployment.matlab import write_matlab

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed: the C code is not compiled")
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow", "-Wundef"]
SANITIZE = ["-fsanitize=undefined,address", "-fno-sanitize-recover=all"]
ONE, PLANAR = "FlexOne-v0", "FlexPlanar-v0"


def network(algo, title="", **settings):
    """Return a policy with random weights and these settings of an agent, on FlexPlanar-v0."""
    environment, random = Configuration(PLANAR, {"sensors": ["motor_encoders"], **settings}), np.random.default_rng(3)
    history = settings.get("history", 1)
    size = 4 * (history if isinstance(history, int) else 1 + len(history))
    prefix, last = {"ppo": ("mlp_extractor.policy_net.", "action_net"), "sac": ("actor.latent_pi.", "actor.mu")}[algo]
    parameters = {}
    for name, (m, k) in {f"{prefix}0": (7, size), f"{prefix}2": (6, 7), last: (2, 6)}.items():
        parameters |= {f"{name}.weight": random.normal(0.0, 0.4, (m, k)), f"{name}.bias": random.normal(0.0, 0.1, m)}
    moments = {"mean": random.normal(0.0, 0.3, size), "var": random.uniform(0.1, 1.0, size)}
    return AgentSpec.from_network(title or f"net-{algo}", Network(algo, None, parameters, moments), environment)


AGENTS = {
    "pd": ("pd", "FlexRRR-v0"),
    "pd with gravity": ("pd", PLANAR),
    "pd of three joints with gravity": ("pd", "FlexRRR-Gravity-v0"),
    "pd of a path": ("pd", "FlexRRR-Track-v0"),
    "lqr": ("lqr", PLANAR),
    "lqr-tracking": ("lqr-tracking", PLANAR),
    "lqr-tracking of a path": ("lqr-tracking", "FlexPlanar-Track-v0"),
    "pd-shaped": ("pd-shaped", PLANAR),
    "lqg": ("lqg", PLANAR),
    "pd of a hanging load": ("pd", "FlexCrane-v0"),
    "lqr-tracking of a hanging load": ("lqr-tracking", "FlexCrane-v0"),
    "lqg of a hanging load": ("lqg", "FlexCrane-v0"),
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
    """Controller in C as a shared library, after a reset with the exported move.

    Attributes:
        move: words of the exported move: number of rows, and addresses of its tables.
        torque: torques of the last step, N m.
        status: status of the last step.
    """

    def __init__(self, folder, joints):
        (self.source,) = (path for path in folder.glob("*.c") if path.name != "main.c")
        library = folder / "controller.so"
        subprocess.run(
            ["gcc", *FLAGS, "-O1", "-shared", "-fPIC", self.source, "-o", library, "-lm"], cwd=folder, check=True
        )
        loaded, name = ctypes.CDLL(str(library)), self.source.stem
        self._step, self._reset = getattr(loaded, f"{name}_step"), getattr(loaded, f"{name}_reset")
        self._state, self._pointer = (ctypes.c_double * 4096)(), ctypes.POINTER(ctypes.c_double)
        self.torque, self.status = np.zeros(joints), None
        tables = re.findall(r"const double \*", self.source.with_suffix(".h").read_text())
        self.move = np.array((ctypes.c_uint64 * (1 + len(tables))).in_dll(loaded, f"{name}_exported"))
        self.move[0] &= 0xFFFFFFFF  # an int, followed by padding
        self.reset(self.move)

    def reset(self, move):
        return self._reset(self._state, None if move is None else ctypes.c_void_p(move.ctypes.data))

    def step(self, readings):
        arrays = (np.ascontiguousarray(each).ctypes.data_as(self._pointer) for each in (readings, self.torque))
        self.status = self._step(self._state, *arrays)
        return self.torque.copy()


def difference(session, folder, steps):
    """Return the largest difference of torques for random readings, as a fraction of the torque limits.

    Readings scatter by up to 30 % about those at the start, a state about that of a path, within their ranges, so that
    torques are at their limits and between them.
    """
    agent, random = session.controller().inner, np.random.default_rng(0)
    limits = torque_scales(session.environment.torque_limit)
    along, compiled = session.readings()[None], Compiled(folder, len(limits))
    if session.path is not None and "state" in session.layout:
        along = agent.base.move_tables()["states"]
    applied, worst, inside = np.zeros((1, len(limits))), 0.0, 0
    for period in range(steps):
        first = along[min(period, len(along) - 1)]
        row = first + (0.02 + 0.3 * np.abs(first)) * 10.0 ** random.uniform(-4.0, 0.0) * random.normal(size=len(first))
        row = np.clip(row, -session.ranges, session.ranges)
        named = {name: row[None, begin : begin + size] for name, (begin, size, _) in session.layout.items()}
        applied = np.array(agent.act(named, applied, np.array([True])), dtype=float)
        worst = max(worst, np.abs(compiled.step(row) / limits - applied[0]).max())
        inside += (np.abs(applied) < 1.0).any()
    assert 0.1 * steps < inside
    return worst


def test_torques_are_those_of_python(exported):
    assert difference(*exported, 300) <= 1e-12


@pytest.mark.slow
def test_torques_of_many_periods_are_those_of_python(exported):
    assert difference(*exported, 10_000) <= 1e-12


@pytest.mark.slow
def test_the_test_program_passes_without_warnings_and_undefined_behaviour(exported):
    _, folder = exported
    sources = sorted(folder.glob("*.c"))
    subprocess.run(["gcc", *FLAGS, *SANITIZE, *sources, "-o", folder / "test", "-lm"], check=True)
    done = subprocess.run([folder / "test"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""
    assert float(done.stdout.split("difference ")[1].split()[0]) <= 1e-12
    assert "bad readings: 0 errors" in done.stdout


# Reads rows of doubles from its input, each 1.0 for a reset before the step, else 0.0, then readings; writes the status
# and the torques of each step.
RUNNER = """
#include "NAME.h"
#include <stdio.h>
#include <stdlib.h>

int main(void)
{
    NAME_state state;
    const size_t size = sizeof(double[JOINTS]);
    double first, status, *readings = malloc(sizeof(double[READINGS])), *torque = malloc(size);
    while (fread(&first, sizeof first, 1, stdin) == 1 && fread(readings, sizeof(double[READINGS]), 1, stdin) == 1) {
        if (first > 0.0)
            NAME_reset(&state, &NAME_exported);
        status = NAME_step(&state, readings, torque);
        fwrite(&status, sizeof status, 1, stdout);
        fwrite(torque, size, 1, stdout);
    }
    free(readings);
    free(torque);
    return 0;
}
"""


@pytest.fixture(scope="module")
def runner(exported):
    """Return a function that runs sequences of readings (k, T, size) in C with sanitizers, each after a reset.

    It returns the status (k, T) and the torques (k, T, n) as fractions of the torque limits.
    """
    session, folder = exported
    (source,) = (path for path in folder.glob("*.c") if path.name != "main.c")
    limits, program = np.array(session.environment.torque_limit), folder / "runner.c.txt"
    words = {"NAME": source.stem, "JOINTS": str(len(limits)), "READINGS": str(len(session.ranges))}
    program.write_text(re.sub("|".join(words), lambda found: words[found[0]], RUNNER))
    program, files = folder / "runner", ["-x", "c", program, source]
    subprocess.run(["gcc", *FLAGS, *SANITIZE, *files, "-o", program, "-lm"], cwd=folder, check=True)

    def run(sequences):
        rows = np.zeros((*sequences.shape[:2], 1 + sequences.shape[2]))
        rows[:, 0, 0], rows[:, :, 1:] = 1.0, sequences
        done = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=True)
        assert done.stderr == b""
        result = np.frombuffer(done.stdout).reshape(*sequences.shape[:2], -1)
        return result[..., 0], result[..., 1:] / torque_scales(limits)

    return run


def run_python(session, sequence):
    """Return status (T,) and actions (T, n) of the controller in Python for readings (T, size)."""
    controller, n = session.controller(), len(session.move[0])
    status, actions, applied, active = [], [], np.zeros((1, n)), np.array([True])
    for row in sequence:
        named = {name: row[None, begin : begin + size] for name, (begin, size, _) in session.layout.items()}
        applied = np.asarray(controller.act(named, applied, active), dtype=float)
        status.append(controller.status)
        actions.append(applied[0])
    return np.array(status), np.array(actions)


def good_readings(session, periods):
    """Return readings (T, size) that scatter by up to 5 % of their magnitude about those at the start."""
    first, random = session.readings(), np.random.default_rng(1)
    changes = 0.05 * (0.02 + np.abs(first)) * random.uniform(-1.0, 1.0, (periods, len(first)))
    return np.clip(first + changes, -session.ranges, session.ranges)


def bad_values(most):
    """Return bad values of a reading with a largest magnitude, with their status."""
    beyond = np.nextafter(most, np.inf)
    return {np.nan: NOT_FINITE, np.inf: NOT_FINITE, -np.inf: NOT_FINITE, 1e308: OUT_OF_RANGE, -1e308: OUT_OF_RANGE,
            beyond: OUT_OF_RANGE, -beyond: OUT_OF_RANGE}  # fmt: skip


BEFORE, AFTER = 5, 6  # good control periods before and after a bad one


@pytest.mark.slow
def test_a_bad_value_of_any_reading_for_a_period_is_refused_and_leaves_later_torques_as_documented(exported, runner):
    """Later torques are those of Python; without tables in time they are those of a run without the bad period."""
    session, _ = exported
    good = good_readings(session, BEFORE + 1 + AFTER)
    sequences, expected = [], []
    for place, most in enumerate(session.ranges):
        for value, status in bad_values(most).items():
            sequences.append(good.copy())
            sequences[-1][BEFORE, place] = value
            expected.append(status)
    status, torques = runner(np.array(sequences))
    assert (status[:, BEFORE] == expected).all() and (np.delete(status, BEFORE, axis=1) == GOOD).all()
    assert np.isfinite(torques).all() and (torques == torques[0]).all()
    assert np.abs(torques[0] - run_python(session, sequences[0])[1]).max() <= 1e-12
    if not hasattr(session.episodes.agent.base, "skip"):
        without = runner(np.delete(good, BEFORE, axis=0)[None])[1][0]
        assert np.array_equal(np.delete(torques[0], BEFORE, axis=0), without)


def test_torques_with_bad_readings_in_between_are_those_of_python(exported, runner):
    """Bad readings come first, one by one, and in bursts that are longer than the holding torques."""
    session, _ = exported
    longest = holding_periods(session.gravity_model, session.environment.control_period)
    good, random = good_readings(session, 120 + longest), np.random.default_rng(2)
    bad = random.uniform(size=len(good)) < 0.2
    bad[:2], bad[-longest - 20 : -5] = True, True
    for period in np.flatnonzero(bad):
        place = random.integers(good.shape[1])
        good[period, place] = random.choice(list(bad_values(session.ranges[place])))
    status, torques = runner(good[None])
    in_python, actions = run_python(session, good)
    assert np.array_equal(status[0], in_python) and np.array_equal(status[0] != GOOD, bad)
    assert np.abs(torques[0] - actions).max() <= 1e-12
    assert not torques[0, :2].any() and not torques[0, -6].any()
    assert torques[0][bad].any() == (session.gravity_model is not None)


def test_readings_at_the_end_of_their_ranges_are_good(exported, runner):
    session, _ = exported
    good = good_readings(session, 4)
    good[1], good[2] = session.ranges, -session.ranges
    status, torques = runner(good[None])
    assert not status.any() and (np.abs(torques) <= 1.0).all()


@pytest.mark.slow
def test_the_rows_of_a_path_go_on_in_refused_periods(tmp_path):
    """Readings of the reference itself leave the feed-forward torques: those of the same time after a bad period."""
    session = begin_agent("lqr-tracking", "FlexPlanar-Track-v0")
    write_c(session, tmp_path)
    table, compiled = session.episodes.agent.base.move_tables(), Compiled(tmp_path, 2)
    for period in range(20):
        bad = period in (0, 4, 5, 6, 11)
        compiled.step(np.full_like(table["states"][0], np.nan) if bad else table["states"][period])
        if not bad:
            assert compiled.torque == pytest.approx(table["torques"][period], abs=1e-12)
        assert compiled.status == (NOT_FINITE if bad else GOOD)


@pytest.mark.slow
def test_holding_torques_of_a_refused_period_are_those_of_the_rigid_arm_at_the_last_good_posture(tmp_path):
    """They last as long as a free fall by 5 % of the reach."""
    gravity, load = ("pd", "FlexRRR-Gravity-v0"), ("pd", "FlexCrane-v0")
    for name, environment in (("pd", PLANAR), ("lqr", PLANAR), ("lqg", PLANAR), gravity, load):
        session = begin_agent(name, environment)
        folder = tmp_path / f"{name}-{environment}"
        good, model = session.readings(), session.episodes.batch.model  # at rest at the start
        write_c(session, folder)
        compiled = Compiled(folder, model.n_joints)
        compiled.step(good)
        weight = rigid_holding_torques(model, session.move[0]) * (1 - model.constants.passive)
        fall = np.sqrt(2.0 * 0.05 * model.constants.length.sum() / np.linalg.norm(model.constants.gravity))
        count = int(fall / session.environment.control_period)
        held = [compiled.step(np.full_like(good, np.nan)) for _ in range(count + 1)]
        assert np.abs(np.array(held[:-1]) - weight).max() <= 1e-12 * np.abs(weight).max()
        assert weight.any() and not held[-1].any()


def test_a_step_without_a_good_move_puts_out_zero_and_its_status(tmp_path):
    session = begin_agent("pd", PLANAR)
    write_c(session, tmp_path)
    compiled = Compiled(tmp_path, 2)
    move, none = compiled.move.copy(), np.zeros(0)
    for rows, value, expected in ((1, np.nan, 2), (1, 2e30, 1), (0, 0.0, 1)):
        table = np.full(2, value)
        move[:] = [rows, table.ctypes.data, table.ctypes.data]
        assert compiled.reset(move) == expected
        assert not compiled.step(session.readings()).any() and compiled.status == 3
    assert compiled.reset(None) == 3 and none.size == 0
    assert compiled.reset(compiled.move) == 0 and compiled.step(session.readings()).any()


@pytest.mark.parametrize(("flags", "allowed"), [
    (["-ffast-math"], False), (["-ffinite-math-only"], False), (["-Ofast"], False), (["-O3"], True),
    (["-U__FAST_MATH__", "-U__FINITE_MATH_ONLY__"], True),
])  # fmt: skip
def test_a_compiler_without_nan_is_refused(flags, allowed, tmp_path):
    """A compiler that defines neither macro compiles the controller."""
    write_c(begin_agent("pd", ONE), tmp_path)
    done = subprocess.run(
        ["gcc", *FLAGS, *flags, "-c", "pd.c", "-o", "pd.o"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode == 0) == allowed and ("removes the checks for NaN" in done.stderr) != allowed


@pytest.mark.parametrize("name", [
    "main", "Main", "math", "time", "double", "²x", "3d", "_", "a\nb", "a */ b /* c", "$p ${P}", "x|y", "ü" * 70,
])  # fmt: skip
def test_a_policy_of_any_name_keeps_its_controller(name, tmp_path):
    """Four files; the compiler finds those of its own headers, and no text of the name outside the comments."""
    files = write_c(begin_agent(network("ppo", title=name)), tmp_path)
    assert len({*files}) == 4 == len([*tmp_path.iterdir()]) and all(file.read_text() for file in files)
    sources = sorted(tmp_path.glob("*.c"))
    assert len(sources) == 2 and all(re.fullmatch(r"[a-z]\w*", path.stem, re.ASCII) for path in sources)
    subprocess.run(["gcc", *FLAGS, "-I.", *sources, "-o", "test", "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "test"], capture_output=True).returncode == 0


class OddlyNamed:
    """Sensor whose entries have names that are words of the header, or equal names in C."""

    measures = ("motor_angles",)
    names = ("joints", "good", "left-arm", "left arm", "²")

    def entries(self, view, limits):
        return [Entry(name, 1, "*/ 1", limits.angle) for name in self.names]

    def read(self, view, out):
        out[:] = view.motor_angles[:, :1]


def test_readings_of_any_name_have_different_identifiers(tmp_path):
    sensors = [OddlyNamed()]
    random, size = np.random.default_rng(0), len(OddlyNamed.names)
    parameters = {"action_net.weight": random.normal(size=(2, size)), "action_net.bias": np.zeros(2)}
    policy = Network("ppo", None, parameters, {"mean": np.zeros(size), "var": np.ones(size)})
    spec = AgentSpec.from_network("odd", policy, Configuration(PLANAR, {"sensors": sensors}))
    write_c(begin_agent(spec), tmp_path)
    subprocess.run(["gcc", *FLAGS, "main.c", "odd.c", "-o", "test", "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "test"], capture_output=True).returncode == 0


@pytest.mark.parametrize("write", [
    lambda folder: write_c(begin_agent("pd", ONE), folder), lambda folder: write_matlab(ONE, folder / "arm.mat"),
])  # fmt: skip
def test_a_full_disk_leaves_the_earlier_files(write, tmp_path):
    write(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    smallest = min(map(len, before.values()))
    limits, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (smallest - 1, limits[1]))
    try:
        with pytest.raises(OSError):
            write(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.parametrize(("agent", "gains"), [("lqr", "gains"), ("lqg", "K")])
def test_gains_of_a_hanging_load_close_the_loop_of_its_linear_model(agent, gains, tmp_path):
    write_matlab(agent, tmp_path / "arm.mat", "FlexCrane-v0")
    data = loadmat(tmp_path / "arm.mat", simplify_cells=True)
    assert data["Bd"].shape == (38, 3)
    assert np.abs(np.linalg.eigvals(data["Ad"] - data["Bd"] @ data["agent"][gains])).max() < 1.0


def test_a_wrong_goal_is_refused_in_one_line(capsys):
    assert main(["export", "c", "pd", "--env", PLANAR, "--goal", "0.3"]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "goal_angles" in said
