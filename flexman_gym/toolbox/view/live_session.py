"""Live view: episodes that a person changes while they run, on a local web page, and the code that repeats them."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from flexman_gym.agent.pd import PD
from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, flag, mapping, one_of, sequence, text, vector, whole_number
from flexman_gym.common.errors import error_text, value_error
from flexman_gym.common.files import new_folder
from flexman_gym.common.run_folder import SETTINGS as RUN_SETTINGS
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS, condition_names
from flexman_gym.envs.effects import SIGNALS
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.registration import NOMINAL
from flexman_gym.envs.rendering import make_renderer
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.policy_files import METADATA
from flexman_gym.evaluation.rollouts import TEST_SEEDS, RolloutLoop, save_rollouts
from flexman_gym.evaluation.trained_agents import AGENTS
from flexman_gym.simulation.physical_parameters import PARAMETERS
from flexman_gym.toolbox.view.renderer import live_row
from flexman_gym.toolbox.view.sliders import GAIN_SLIDERS, Slider, arm_sliders, checked_positions

FRAME = 0.02  # s; shortest time between two messages to the page
LIVE_HORIZON = 120.0  # s; horizon of episodes with a fixed target, in place of that of the environment
MAX_AGENTS = 2  # number of agents side by side
PULL_LENGTH = 0.25  # fraction of the reach; a pull over this length pushes the tip with torque limit / reach
BEND_SHARE = 0.1  # fraction of the reach; drawn deflection for a quarter of the strains of the colour scale
SPEEDS = (0.1, 0.25, 1.0)  # 1; simulated time / real time


class Events:
    """Changes of running episodes at given control periods: a callback of `rollout`.

    Args:
        rows: rows (period, name, value). The change acts from the control period with this number on, 0 for the first.
            With the name "force" the value is the force (3,) at the tip in the base frame, N; with the name "gains" it
            maps "stiffness" (N m/rad) and "damping" (N m s/rad) of a PD controller of the motors to gains (n,).

    Examples:
        >>> push = Events([(50, "force", [0.0, 1.0, 0.0]), (60, "force", [0.0, 0.0, 0.0])])
        >>> pushed, still = (fm.rollout("zero", "FlexOne-v0", [0], events) for events in (push, None))
        >>> [bool((pushed.tips[0, row] == still.tips[0, row]).all()) for row in (50, 51)]
        [True, False]
    """

    def __init__(self, rows: Iterable[tuple[int, str, Any]] = ()) -> None:
        self.rows = list(rows)

    def __call__(self, episodes: Episodes) -> None:
        """Make the changes that are due at the present time of the first arm."""
        for period, name, value in self.rows:
            if period == _periods(episodes):
                _change(episodes, name, value)

    def add(self, episodes: Episodes, name: str, value: Any) -> None:
        """Make a change now, and add it to the rows, where it replaces an earlier one of this time and name."""
        now = _periods(episodes)
        _change(episodes, name, value)
        self.rows = [row for row in self.rows if row[:2] != (now, name)] + [(now, name, value)]


def _periods(episodes: Episodes) -> int:
    """Return the number of control periods since the reset of the first arm."""
    return round(float(episodes.batch.time[0]) / episodes.view.control_period)


def _change(episodes: Episodes, name: str, value: Any) -> None:
    if one_of("event", name, ("force", "gains")) == "force":
        return episodes.push(np.array(vector("force", value, 3, "N")))
    controller, n = _find_pd(episodes), episodes.view.n_joints
    if controller is None:
        raise value_error("gains", value, "them to an agent with a PD controller of the motors")
    for gain, values in mapping("gains", value, PD.gain_units).items():
        setattr(controller, gain, np.array(vector(f"gains.{gain}", values, n, PD.gain_units[gain])))


def _find_pd(episodes: Episodes) -> PD | None:
    """Return the PD controller of the motors with or without input shaping; None for agents without one."""
    base: Any = episodes.base
    inner = getattr(base, "inner", base)
    return inner if isinstance(inner, PD) else None


class _Setup(NamedTuple):
    """Start of an episode: environment and its changed settings, agents, positions of sliders, reset options, seed."""

    name: str
    settings: dict[str, Any]
    agents: tuple[str, ...]
    values: dict[str, float]
    options: dict[str, Any]
    seed: int


class LiveSession:
    """Episodes in real time on a web page of the local host, see `live`.

    Attributes:
        url: address of the page.
        paused: True if the simulation waits.
        folder: folder of saved episodes.
    """

    def __init__(self, setup: _Setup, agents: dict[str, object], port: int = 0) -> None:
        from flexman_gym.toolbox.view.live_page import LivePage

        self._lock, self._closed = threading.RLock(), False
        self._setup, self._known = setup, agents
        self._loops: list[RolloutLoop] = []
        self._gains, self._sliders = dict.fromkeys(GAIN_SLIDERS, 1.0), dict[str, Slider]()
        self.paused, self._speed, self._message, self.folder = False, 1.0, "", Path("out/live")
        self._acting = ""  # name of the agent that acts
        self._death: BaseException | None = None  # error that ended the simulation
        self._commands: dict[str, Callable[[Any], Any]] = {
            "pause": self._pause, "step": self._step, "speed": self._set_speed, "environment": self._set_environment,
            "agents": self._set_agents, "values": self._set_values, "gains": self._set_gains, "push": self._push,
            "target": self._set_target, "again": self._again, "save": self._save, "code": self._code,
        }  # fmt: skip
        self._page = LivePage(self.command, port)
        self.url, self._thread = self._page.url, threading.Thread(target=self._run, daemon=True)
        try:
            self._start()
            self._thread.start()
        except BaseException:  # Ctrl+C too
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="760" style="border: 0"></iframe>'

    def close(self) -> None:
        """Stop the simulation and the server of the page."""
        if not self._closed:
            self._closed = True
            if self._thread.is_alive():
                self._thread.join()
            self._page.close()

    def wait(self) -> None:
        """Wait until the session is closed.

        Raises:
            RuntimeError: if the simulation has ended by itself, as after an agent that exits.
        """
        self._thread.join()
        if self._death is not None:
            raise RuntimeError(f"the simulation has ended: {error_text(self._death)}") from self._death

    def command(self, message: dict[str, Any]) -> dict[str, Any]:
        """Execute a message of the page, a mapping with one command and its value, and return the answer.

        Raises:
            ValueError, OSError: for a message that is not allowed, with a one-line message; nothing changes. An error
                of an agent that starts anew is raised as it is, and the episodes before go on.
        """
        with self._lock:
            if self._death is not None:
                raise ValueError(f"the simulation has ended: {error_text(self._death)}; start a new session")
            given = mapping("message", message, self._commands)
            if len(given) != 1:
                raise value_error("message", given, f"one of {', '.join(self._commands)} with its value")
            ((name, value),) = given.items()
            answer = self._commands[name](value) or {}
            self._send_state()
            return answer

    def state(self) -> dict[str, Any]:
        """Return the state of the controls, JSON-compatible."""
        episodes = self._loops[0].episodes
        drawn = episodes.effects.drawn_for(0) if episodes.effects else {}
        actual = {**episodes.batch.nominal, **dict.fromkeys(SIGNALS, 0.0), **drawn}
        positions = {name: row.position(actual[name]) for name, row in self._sliders.items()}
        return {"paused": self.paused, "speed": self._speed, "message": self._message, "seed": self._setup.seed,
                "values": positions | self._setup.values, "gains": self._gains}  # fmt: skip

    def _send_state(self) -> None:
        self._page.set_state(self.state())

    # Simulation

    def _start(self, **changes: Any) -> None:
        """Start new episodes with changes of the setup; an error leaves the running episodes as they are."""
        setup = self._setup._replace(**changes)
        configuration = Configuration.find(setup.name).replace(**self._settings(setup))
        options = self._options(setup)
        events, rows = [Events() for _ in setup.agents], [list[Array]() for _ in setup.agents]
        loops = [
            RolloutLoop(self._known[agent], configuration, [setup.seed], partial(_watch, *both), options=options)  # type: ignore[arg-type]
            for agent, *both in zip(setup.agents, events, rows, strict=True)
        ]
        controllers = [_find_pd(loop.episodes) for loop in loops]
        self._tuned = [{name: getattr(each, name).copy() for name in GAIN_SLIDERS} if each else {}
                       for each in controllers]  # fmt: skip
        self._setup, self._loops, self._events, self._rows, self._shown = setup, loops, events, rows, 0
        self._sliders, self._message, self._period = arm_sliders(loops[0].episodes), "", configuration.control_period
        if any(gain != 1.0 for gain in self._gains.values()):
            self._apply_gains()
        self._page.begin(self._scene())
        self._advance(1)
        self._send_state()

    def _settings(self, setup: _Setup, horizon: float = LIVE_HORIZON) -> dict[str, Any]:
        """Return the changed settings of the environment; the horizon, s, if its target does not move."""
        found = Configuration.find(setup.name).replace(**setup.settings)
        signals = {name: self._sliders[name].value(x) for name, x in setup.values.items() if name in SIGNALS}
        ranges = {name: [value, value] for name, value in signals.items()}
        result = dict(setup.settings)
        if ranges:
            result["randomisation"] = found.randomised_ranges | ranges
        if not found.task.moves:
            result["horizon"] = horizon
        return result

    def _options(self, setup: _Setup) -> dict[str, Any]:
        """Return the options of the reset of a setup."""
        chosen = {name: self._sliders[name].value(x) for name, x in setup.values.items() if name in PARAMETERS}
        return setup.options | ({"parameters": chosen} if chosen else {})

    def _scene(self) -> Any:
        """Return the scene of the page."""
        from flexman_gym.toolbox.view.comparison import rounded_gain

        setup, episodes, view = self._setup, self._loops[0].episodes, self._loops[0].episodes.view
        id, condition = _split(setup.name)
        tables = {"values": self._sliders, "gains": GAIN_SLIDERS if any(self._tuned) else {}}
        controls = {
            name: [[key, row.label, row.low, row.high, row.step] for key, row in rows.items()]
            for name, rows in tables.items()
        } | {
            "environments": list(dict.fromkeys([*NAMED_ENVIRONMENTS, id])), "environment": id, "speeds": SPEEDS,
            "conditions": condition_names(id) if id in NAMED_ENVIRONMENTS else [NOMINAL], "condition": condition,
            "agents": [*self._known], "chosen": setup.agents, "movable": "goal_angles" in view.episode_parameters,
            "pull": float(episodes.motors.limits[0].max()) / (PULL_LENGTH * view.reach**2),
        }  # fmt: skip
        renderer: Any = make_renderer("rgb_array", episodes, setup.name, ((480, 360), None, 1.0, False))
        scene = renderer.scene(setup.agents, self._period, controls=controls)
        radii = np.maximum(view.gauge_radii[:, :2].min(axis=1), 1e-9 * view.reach)
        bend = 0.25 * scene.strain * float(np.sum(view.lengths**2 / (3.0 * radii)))
        return scene._replace(gain=rounded_gain(BEND_SHARE * view.reach / bend) if bend else 1.0)

    def _advance(self, count: int) -> None:
        """Simulate and show a number of rows; pause at the end of all episodes."""
        end = self._shown + count
        for name, loop, rows in zip(self._setup.agents, self._loops, self._rows, strict=True):
            self._acting = name
            while len(rows) < end and not loop.over:
                loop.step()
        end = min(end, max(map(len, self._rows)))
        if end > self._shown:
            shown = range(self._shown, end)
            self._page.show(np.array([[rows[min(i, len(rows) - 1)] for rows in self._rows] for i in shown]))
        self._shown = end
        if all(loop.over for loop in self._loops) and end == max(map(len, self._rows)):
            self.paused, causes = True, [loop.episodes.failures.get(0) or "end of the episode" for loop in self._loops]
            self._message = "; ".join(f"{name}: {why}" for name, why in zip(self._setup.agents, causes, strict=True))
            self._send_state()

    def _fail(self, error: BaseException) -> str:
        """Pause after an error of the agent that acts, show its message, and return the message."""
        self.paused, self._message = True, f"{self._acting}: {error_text(error)}"
        self._send_state()
        return self._message

    def _run(self) -> None:
        """Advance the episodes in real time until the session is closed."""
        try:
            while not self._closed:
                with self._lock:
                    count = max(1, round(FRAME * self._speed / self._period))
                    interval = FRAME if self.paused else count * self._period / self._speed
                    try:
                        if not self.paused:
                            self._advance(count)
                    except Exception as error:  # any error of an agent
                        self._fail(error)
                self._page.wait(interval)
        except BaseException as error:  # such as SystemExit of an agent
            self._death = error
            with self._lock:
                self._fail(error)

    # Commands

    def _pause(self, value: object) -> None:
        if all(loop.over for loop in self._loops) and not flag("pause", value):
            return self._start()
        self.paused = flag("pause", value)

    def _step(self, value: object) -> None:
        count, self.paused = whole_number("step", value, 1, 1000), True
        try:
            self._advance(count)
        except Exception as error:
            raise ValueError(self._fail(error)) from error

    def _set_speed(self, value: object) -> None:
        speed = finite("speed", value)
        if speed not in SPEEDS:
            raise value_error("speed", value, f"one of {', '.join(map(str, SPEEDS))}")
        self._speed = speed

    def _set_environment(self, value: object) -> None:
        self._start(name=text("environment", value).removesuffix(f"/{NOMINAL}"), settings={}, values={}, options={})

    def _set_agents(self, value: object) -> None:
        names = tuple(one_of("agents", text("agents", name), self._known) for name in sequence("agents", value))
        self._start(agents=_check_count(names))

    def _set_values(self, value: object) -> None:
        self._start(values=self._setup.values | checked_positions("values", value, self._sliders))

    def _set_gains(self, value: object) -> None:
        self._gains |= checked_positions("gains", value, GAIN_SLIDERS)
        self._apply_gains()

    def _apply_gains(self) -> None:
        for loop, events, tuned in zip(self._loops, self._events, self._tuned, strict=True):
            if tuned:
                gains = {name: (self._gains[name] * values).tolist() for name, values in tuned.items()}
                events.add(loop.episodes, "gains", gains)

    def _push(self, value: object) -> None:
        force = list(vector("push", value, 3, "N"))
        for loop, events in zip(self._loops, self._events, strict=True):
            events.add(loop.episodes, "force", force)

    def _set_target(self, value: object) -> None:
        """Start an episode from the present posture to the reachable position nearest to the given one."""
        from scipy.optimize import least_squares

        view = self._loops[0].episodes.view
        if "goal_angles" not in view.episode_parameters or view.foundation is not None:
            allowed = "it in an environment whose target does not move, on a fixed foundation"
            raise value_error("target", value, allowed)
        start, position = view.motor_angles[0].copy(), np.array(vector("target", value, 3, "m"))
        nearest = least_squares(lambda angles: (view.rest_tips(angles[None])[0] - position) / view.reach, start)
        self._start(options={"start": start.tolist(), "goal_angles": nearest.x.tolist()})

    def _again(self, value: object) -> None:
        """Start the episode again (0), or the episode of the next seed (1)."""
        if whole_number("again", value, 0, 1):
            return self._start(seed=self._setup.seed + 1, options={})
        self._start()

    def _save(self, _: object) -> dict[str, Any]:
        if min(map(len, self._rows)) < 2:
            raise ValueError("save: the episode has no control period yet; give it one")
        folder = new_folder(self.folder / time.strftime("%Y-%m-%d-%H%M%S"))
        paths = [*map(str, save_rollouts([loop.result() for loop in self._loops], folder))]
        self._message = f"saved; flexman replay {' '.join(paths)}"
        return {"paths": paths}

    def _code(self, _: object) -> dict[str, Any]:
        """Return the code that repeats the episodes so far."""
        setup, lines = self._setup, ["import gymnasium as gym", "", "import flexman_gym as fm"]
        id, condition = _split(setup.name)
        start = [f"condition={condition!r}"] if condition != NOMINAL else []
        if id not in NAMED_ENVIRONMENTS:
            lines.append("from flexman_gym.envs.config.configuration import Configuration")
            id, start = Configuration.find(setup.name).id, [f"configuration=Configuration.load({setup.name!r})"]
        lines.append("from flexman_gym.toolbox.view.live_session import Events")
        for agent, events, rows in zip(setup.agents, self._events, self._rows, strict=True):
            horizon = max(len(rows) - 1, 1) * self._period
            settings = [f"{name}={value!r}" for name, value in self._settings(setup, horizon).items()]
            lines += ["", f"env = gym.make({', '.join([repr(id), *start, *settings])})", "events = Events(["]
            lines += [*(f"    {row!r}," for row in events.rows), "])", f"options = {self._options(setup)!r}"]
            lines += [
                f"result = fm.rollout({agent!r}, env.unwrapped.configuration, [{setup.seed}], events, options=options)"
            ]
            lines += ["episode = result.episode(0)", 'print(f"tip error at the end: {episode.errors[-1]:.4g} m")']
        return {"code": "\n".join(lines) + "\n"}


def _split(name: str) -> tuple[str, str]:
    """Return id and condition of the name of an environment; a file has the condition "nominal"."""
    id, _, condition = name.partition("/")
    return (id, condition or NOMINAL) if id in NAMED_ENVIRONMENTS else (name, NOMINAL)


def _watch(events: Events, rows: list[Array], episodes: Episodes) -> None:
    """Make the changes that are due, and keep the row of the page."""
    events(episodes)
    rows.append(live_row(episodes))


def _check_count(names: tuple[str, ...]) -> tuple[str, ...]:
    if not 1 <= len(names) <= MAX_AGENTS:
        raise value_error("agents", names, f"1 or {MAX_AGENTS} of them")
    return names


def live(
    environment: str = DEFAULT_ID,
    agents: str | Sequence[object] = ("pd",),
    seed: int = TEST_SEEDS.start,
    port: int = 0,
    **settings: Any,
) -> LiveSession:
    """Show an arm in real time on a web page of this computer, with sliders, a target to drag and a tip to push.

    The page has the address `url` of the result; a notebook shows it below the cell. It answers this computer only, and
    only who has the random token in the address. An error of an agent pauses the page and is shown on it.
    Sliders of the arm, of noise and of delay start a new episode; gains of a PD controller and pushes act at once.

    Args:
        environment: id, id and condition such as "FlexRRR-v0/delay", or path of a file.
        agents: an agent, or two agents side by side on the same arm with the same target, see `find_agent`.
        seed: seed of the first episode.
        port: port of the page; 0 for a free port.
        **settings: further keyword arguments of `gym.make`.

    Returns:
        Running session, with `url`, `close()` and `paused`.

    Examples:
        >>> session = fm.live("FlexOne-v0", ["pd", "pd-shaped"])
        >>> session.command({"push": [0.0, 0.5, 0.0]})
        {}
        >>> session.close()
    """
    given = [agents] if isinstance(agents, str) or not isinstance(agents, Sequence) else agents
    specs = [find_agent(each) for each in given]
    names = tuple(each if isinstance(each, str) else spec.name for each, spec in zip(given, specs, strict=True))
    if len(names) == 2 and names[0] == names[1] and given[0] is not given[1] and {*map(type, given)} != {str}:
        names = names[0], f"{names[1]} 2"  # two agents of one name
    Configuration.find(environment).replace(**settings)  # checks them
    runs = sorted(str(path.parent) for name in (RUN_SETTINGS, METADATA) for path in Path("runs").glob(f"*/{name}"))
    known = {name: name for name in (*AGENTS, *runs)} | dict(zip(names, given, strict=True))
    seed, port = whole_number("seed", seed, 0, 2**63), whole_number("port", port, 0, 65535)
    return LiveSession(_Setup(environment, settings, _check_count(names), {}, {}, seed), known, port)
