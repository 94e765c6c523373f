"""Plot and formulas of the two rewards of a slew: the default, and the one that trains better."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.plot_style import BLUE, RED, save_figure
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.envs.tasks.rewards import FAR, LOOK_AHEAD, NEAR, REWARDS, VIBRATION_SCALE
from studies.charts import new_chart
from studies.environments.text import make, paragraph

PICTURE = "reward.svg"
ALTERNATIVE = (
    f"{DEFAULT_ID}: rewards bells and distance over the tip error at rest, and over the tip speed at the target"
)
SHOWN = {"bells": RED, "distance": BLUE}  # reward -> colour
ERRORS, SPEEDS = np.geomspace(1e-3, 10.0, 200), np.geomspace(1e-3, 10.0, 200)  # m, m/s
BELLS = "bells:    0.7 mean(1 / (1 + (e / w)^2)) + 0.2 / (1 + (u / q)^2) + 0.1 (1 - effort)"
FORMULA = "distance: 1 - ln(1 + (e^2 + (T v / 32)^2) / n^2) / ln(1 + (f / n)^2)"


def reward(kind: str, errors: Array, speeds: Array, reach: float, slew_time: float) -> Array:
    """Return the reward of a control period without torque, (b,).

    Args:
        kind: name of the reward.
        errors: (b,) tip errors, m.
        speeds: (b,) speeds of the tip, m/s, all of them vibration.
        reach: sum of the lengths of the links, m.
        slew_time: time of a usual slew, s.
    """
    view: Any = SimpleNamespace(
        tip_error=errors, tip_vibration=speeds, effort=np.zeros(len(errors)), reach=reach, slew_time=slew_time
    )
    velocities = speeds[:, None] * np.array([1.0, 0.0, 0.0]) if kind == "distance" else None
    return np.sum([*REWARDS[kind].terms(view, velocities).values()], axis=0)


def draw_rewards(folder: Path) -> Path:
    """Plot the rewards over the tip error at rest, and over the speed of the tip at the target; return the file."""
    scales = _scales(DEFAULT_ID)
    figure, ((left, right),) = new_chart((7.6, 2.5), columns=2)
    for kind, colour in SHOWN.items():
        left.semilogx(1e3 * ERRORS, reward(kind, ERRORS, np.zeros_like(ERRORS), *scales), color=colour, label=kind)
        right.semilogx(1e3 * SPEEDS, reward(kind, np.zeros_like(SPEEDS), SPEEDS, *scales), color=colour, label=kind)
    left.set(xlabel="tip error at rest (mm)", ylabel="reward of a control period", ylim=(-0.2, 1.05))
    right.set(xlabel="tip speed at the target (mm/s)", ylim=(-0.2, 1.05))
    left.legend(frameon=False, loc="lower left")
    return save_figure(figure, folder / PICTURE)


def reward_lines(name: str) -> list[str]:
    """Return the text on the rewards of an environment with slews, with the numbers of its arm."""
    reach, slew_time = _scales(name)
    scales = f"T / 32 = {LOOK_AHEAD * slew_time:.2g} s, n = {1e3 * NEAR * reach:.2g} mm, f = {FAR * reach:.2g} m"
    bells = "bell curves of tip error and vibration, flat far from the target"
    logarithm = "a logarithm of tip error and speed, with a slope from metres to millimetres"
    default = getattr(NAMED_ENVIRONMENTS[name].task, "reward", None)
    text = f'The reward is `{default}`: {logarithm}. `reward="bells"` gives {bells}:'
    if default == "bells":
        text = (
            f'The default is `bells`: {bells}. With `gym.make("{name}", reward="distance")`, {logarithm}, PPO and SAC '
            "[train better](../learn.md#the-settings-of-a-recipe):"
        )
    more = paragraph(
        f"for a tip error e, a tip speed v, its vibration u (relative to a rigid arm); here {scales},",
        f"q = {VIBRATION_SCALE * reach:.2g} m/s. The mean is that of three widths w ([all terms](tasks.md#slew)); the",
        f"effort is the mean square torque. The plot has the numbers of {DEFAULT_ID}.",
    )
    return [
        *paragraph(text),
        "",
        "```",
        FORMULA,
        BELLS,
        "```",
        "",
        *more,
        "",
        f"![{ALTERNATIVE}]({PICTURE}){{ width=464 }}",
    ]


def _scales(name: str) -> tuple[float, float]:
    """Return the reach (m) of the arm of an environment, and its slew time (s)."""
    configuration = make(name).configuration
    return sum(link.length for link in configuration.arm.links), configuration.slew_time
