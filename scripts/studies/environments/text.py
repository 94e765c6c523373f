"""Texts and tables of the pages of environments, from docstrings, settings and the environments themselves."""

import inspect
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from flexman_gym.common.formatting import millimetres
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.tasks import Slew
from flexman_gym.evaluation.shares import share_text
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model
from flexman_gym.model.vibration import modes
from studies.environments.measure import Baseline

SECTIONS = ("Description", "Actions", "Observations", "Reward", "Start", "End", "Arguments", "Version history")


def make(name: str, **keywords: Any) -> Any:
    """Return the unwrapped environment `name`."""
    return gym.make(name, **keywords).unwrapped


def paragraph(*parts: str, indent: str = "") -> list[str]:
    """Return parts of a text, joined by spaces, as lines of at most 120 characters.

    Args:
        parts: parts of the text.
        indent: start of the second and later lines.
    """
    return textwrap.wrap(" ".join(parts), 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def docstring_sections(task: type) -> dict[str, list[str]]:
    """Return the sections of the docstring of a task by title, as Markdown lines.

    Raises:
        KeyError: for a docstring without one of the SECTIONS.
    """
    lines = inspect.cleandoc(task.__doc__ or "").splitlines()
    titles = [*SECTIONS, "Attributes:", "Examples:", "Raises:"]
    starts = {title: lines.index(title) for title in titles if title in lines}
    result = {}
    for title in SECTIONS:
        first = starts[title] + 1
        last = min((start for start in starts.values() if start >= first), default=len(lines))
        result[title] = _markdown([line[4:] for line in lines[first:last]])
    return result


def _markdown(lines: Sequence[str]) -> list[str]:
    """Return the lines with indented text, formulas and tables as code blocks."""
    result: list[str] = []
    inside = False
    for line in lines:
        code = line.startswith("    ") or (inside and bool(line) and line.count("  ") > 1)
        table = line.count("   ") > 1
        if (code or table) != inside and (line or inside):
            result += ["```"] if inside else ["", "```"]
            inside = not inside
            result += [""] if not inside else []
        result.append(line)
    result += ["```"] if inside else []
    text = "\n".join(result).strip("\n")
    while "\n\n\n" in text:
        text = text.replace("\n\n\n", "\n\n")
    return text.replace("\n\n```\n\n", "\n```\n\n").splitlines()


def task_arguments(task: type) -> list[str]:
    """Return the attributes of a task with their meaning, as a Markdown list."""
    lines = inspect.cleandoc(task.__doc__ or "").splitlines()
    first = lines.index("Attributes:") + 1
    last = next((i for i, line in enumerate(lines) if i > first and line in ("Examples:", "Raises:")), len(lines))
    text = " ".join(line.strip() if line.startswith("        ") else "\n" + line.strip() for line in lines[first:last])
    items = [f"- `{each.strip().replace(':', '`:', 1)}" for each in text.split("\n") if each.strip()]
    return [line for item in items for line in paragraph(item, indent="  ")]


def observation_rows(name: str, sensors: object = None) -> list[tuple[str, ...]]:
    """Return a row for each slice of the observations: name, entries, unit and largest value.

    Args:
        name: environment.
        sensors: sensors of the agent; None for those of the environment.
    """
    found = make(name, **({"sensors": sensors} if sensors else {})).sensors
    rows: list[tuple[str, ...]] = []
    for part, place in found.slices.items():
        bound = np.unique(found.bound[place].round(12))
        span = f"{bound[0]:.3g}" if len(bound) == 1 else f"{bound[0]:.3g} to {bound[-1]:.3g}"
        rows.append((f"`{part}`", f"{place.start}-{place.stop - 1}", found.units[part], span))
    return rows


def arm_facts(name: str) -> dict[str, str]:
    """Return the properties of the arm of an environment, and of its model, by their names."""
    env = make(name)
    arm, model, configuration = env.configuration.arm, env.simulator.model, env.configuration
    step = env.simulator.control_period / env.simulator.substeps
    return {
        "lengths of the links (m)": _numbers(link.length for link in arm.links),
        "masses of the links (kg)": ", ".join(f"{link.mass:.3g}" for link in arm.links),
        "stiffness of the joints (N m/rad)": ", ".join(
            f"{joint.stiffness:g}" if joint.stiffness else "rigid" for joint in arm.joints
        ),
        "inertias of the rotors (kg m^2)": _numbers(joint.rotor_inertia for joint in arm.joints),
        "payload": f"{arm.payload.mass:g} kg" if arm.payload else "none",
        "gravity": f"{np.linalg.norm(arm.gravity):g} m/s^2" if any(arm.gravity) else "none",
        "first mode at zero angles, motors held": f"{_first_frequency(model):.2f} Hz",
        "coordinates of the model": f"{model.n_dof}: {model.n_joints} joints, {model.n_motors} motors, "
        f"{model.n_elastic} elastic",
        "method and step": f"`{configuration.method}`, {1e3 * step:.3g} ms",
    }


def _first_frequency(model: Model) -> float:
    """Return the first frequency at zero angles with motors held, Hz; with passive joints, that of the hanging load."""
    if model.constants.passive.any():
        return float(modes(model, motors="held").frequencies[0])
    return float(frequencies(model, lock_joints=True)[0])


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def is_slew(name: str) -> bool:
    """Return True if the task of an environment is a slew, whose episodes can settle."""
    return isinstance(NAMED_ENVIRONMENTS[name].task, Slew)


def length(value: float) -> str:
    """Return a length as text, in m or mm; "-" for a length that is not finite."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.3g} m" if value >= 1.0 else millimetres(value)


def episodes_text(rows: Sequence[Baseline]) -> str:
    """Return the number of episodes of rows as text."""
    counts = sorted({round(row.episodes) for row in rows})
    return f"{' or '.join(map(str, counts))} test episodes"


def baseline_table(name: str, rows: Sequence[Baseline]) -> list[str]:
    """Return the table of the baselines of an environment with its number of episodes, as Markdown lines."""
    own = [row for row in rows if row.environment == name]
    return [f"Over {episodes_text(own)}, medians and shares (95 % intervals):", "", *_table(name, own)]


def settled_text(row: Baseline) -> str:
    """Return the share of settled episodes with its interval, and the median settling time, s, as text."""
    time = f", {row.settling_time:.3g} s" if np.isfinite(row.settling_time) else ""
    return f"{share_text(row.settled, row.episodes)}{time}"


def _table(name: str, own: Sequence[Baseline]) -> list[str]:
    if not is_slew(name):
        cells = [(row.baseline, length(row.rms_error), share_text(row.failed, row.episodes)) for row in own]
        return markdown_table(("baseline", "RMS tip error", "failed"), cells)
    heads = ("baseline", "settled", "settling time", "vibration at the end", "failed")
    return markdown_table(heads, [
        (row.baseline, share_text(row.settled, row.episodes),
         f"{row.settling_time:.3g} s" if np.isfinite(row.settling_time) else "-",
         length(row.vibration), share_text(row.failed, row.episodes)) for row in own
    ])  # fmt: skip
