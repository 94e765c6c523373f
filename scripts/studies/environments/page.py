"""Page of a named environment, generated from docstrings and from the environment itself."""

import inspect
from collections.abc import Sequence

import gymnasium as gym
import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import CONDITION_FOLDER, CONDITIONS, NAMED_ENVIRONMENTS, NOMINAL
from flexman_gym.envs.sensors import SENSOR_SETS
from flexman_gym.evaluation.metrics import METRICS, SHARE, Metric
from flexman_gym.evaluation.rollout import Rollout
from flexman_gym.metrics import BAND, SETTLING_WINDOW, VIBRATION_WINDOW
from flexman_gym.model.dynamics import frequencies
from studies.environments.measure import BASES, DURATION, FINER, MOTIONS, SEEDS, Accuracy, accuracy, first

SLEW = ("settled", "settling_time", "vibration")  # metrics of a task that declares none
MOVING = "The RMS error is the median over the episodes of the RMS tip error over all control periods."
LEAST = 0.001  # s or mm; smaller numbers are shown as "< 0.001"
STEP = "CPU time of a step of the finer model"
SECTIONS = ("Description", "Actions", "Observations", "Reward", "Start", "End", "Arguments", "Version history")


def page(name: str, runs: dict[str | None, Rollout]) -> str:
    """Return the page of a named environment as Markdown, including the results of its baselines."""
    sections = docstring_sections(type(NAMED_ENVIRONMENTS[name].task))
    lines = [f"# {name}", "", f"![{name} under a tracking LQR]({name}.gif)", "", *_head(name), ""]
    for title in SECTIONS:
        lines += [f"## {title}", "", *sections[title], ""]
        lines += {"Description": _arm, "Observations": _observations, "Arguments": _arguments}.get(title, _nothing)(
            name
        )
    lines += ["## Settings for a first training", "", *first(name), ""]
    lines += ["## Accuracy", "", *_left_out(accuracy(name)), ""]
    lines += ["## Baselines", "", f"![Tip error and torques of {name}]({name}.png)", "", *baselines(name, runs), ""]
    lines += ["## Conditions", "", *_conditions(name)]
    return "\n".join(lines).rstrip() + "\n"


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


def _head(name: str) -> list[str]:
    named = NAMED_ENVIRONMENTS[name]
    return [
        "```python",
        "import gymnasium as gym",
        "import flexman_gym",
        "",
        f'env = gym.make("{name}")',
        "```",
        "",
        f"Task `{type(named.task).__name__}`, control period {named.control_period:g} s, "
        f"episodes of {named.horizon:g} s.",
    ]


def _arm(name: str) -> list[str]:
    env = gym.make(name).unwrapped
    arm, model = env.configuration.arm, env.simulator.model  # type: ignore[attr-defined]
    first = frequencies(model, lock_joints=True)[0]
    step = env.simulator.control_period / env.simulator.substeps  # type: ignore[attr-defined]
    load = f"{arm.payload.mass:g} kg" if arm.payload else "none"
    weight = "none" if not any(arm.gravity) else f"{np.linalg.norm(arm.gravity):g} m/s^2"
    facts = {
        "links (m)": ", ".join(f"{link.length:g}" for link in arm.links),
        "mass of the links (kg)": ", ".join(f"{link.mass:.3g}" for link in arm.links),
        "joint stiffness (N m/rad)": ", ".join(
            f"{joint.stiffness:g}" if joint.stiffness else "rigid" for joint in arm.joints
        ),
        "rotor inertia (kg m^2)": ", ".join(f"{joint.rotor_inertia:g}" for joint in arm.joints),
        "torque limits (N m)": ", ".join(f"{limit:g}" for limit in env.configuration.torque_limit),  # type: ignore[attr-defined]
        "payload": load,
        "gravity": weight,
        "first mode at zero angles, motors held": f"{first:.2f} Hz",
        "coordinates of the model": f"{model.n_dof}: {model.n_joints} joints, {model.n_motors} motors, "
        f"{model.n_elastic} elastic",
        "method": f"`{env.configuration.method}`, {1e3 * step:.3g} ms",  # type: ignore[attr-defined]
    }
    return ["The arm:", "", *markdown_table(("", ""), facts.items()), ""]


def _observations(name: str) -> list[str]:
    lines = []
    own = () if NAMED_ENVIRONMENTS[name].sensors == "full" else (None,)
    for kind in (*own, "full", *SENSOR_SETS):
        sensors = gym.make(name, sensors=kind).unwrapped.sensors  # type: ignore[attr-defined]
        rows = []
        for part, place in sensors.slices.items():
            bound = np.unique(sensors.bound[place].round(12))
            span = f"{bound[0]:.3g}" if len(bound) == 1 else f"{bound[0]:.3g} to {bound[-1]:.3g}"
            rows.append((f"`{part}`", f"{place.start}-{place.stop - 1}", sensors.units[part], span))
        with_what = (
            f'With `sensors="{kind}"`' if kind else f"With its own sensors, `{NAMED_ENVIRONMENTS[name].sensors}`"
        )
        lines += [f"{with_what}, Box ({len(sensors.bound)},):", ""]
        lines += [*markdown_table(("slice", "entries", "unit", "largest"), rows), ""]
    return lines


def _arguments(name: str) -> list[str]:
    task = NAMED_ENVIRONMENTS[name].task
    lines = inspect.cleandoc(type(task).__doc__ or "").splitlines()
    first = lines.index("Attributes:") + 1
    last = next((i for i, line in enumerate(lines) if i > first and line in ("Examples:", "Raises:")), len(lines))
    kind = type(task).__name__.lower()
    text = " ".join(line.strip() if line.startswith("        ") else "\n" + line.strip() for line in lines[first:last])
    given = [f"- `{each.strip().replace(':', '`:', 1)}" for each in text.split("\n") if each.strip()]
    shown = ", ".join(f'"{key}": {value!r}' for key, value in vars(task).items() if not key.startswith("_"))
    return [*given, "", f'This environment has `task={{"kind": "{kind}", {shown}}}`.', ""]


def baselines(name: str, runs: dict[str | None, Rollout]) -> list[str]:
    """Return the table of the baselines of an environment as Markdown lines."""
    own = getattr(NAMED_ENVIRONMENTS[name].task, "metrics", SLEW)
    shown = [METRICS[figure] for figure in (*own, "failed")]
    rows = [(BASES[base], *(_cell(figure, each) for figure in shown)) for base, each in runs.items()]
    return [
        f"{len(SEEDS)} test episodes (seeds {SEEDS[0]} to {SEEDS[-1]}). The LQR is given the parameters and the full "
        f"state of the arm, the PD only its motors. {_ends(name) if own == SLEW else MOVING}",
        "",
        *markdown_table(("", *(metric.header for metric in shown)), rows),
    ]


def _ends(name: str) -> str:
    """Return the definitions of the metrics of a slew."""
    band = BAND * sum(link.length for link in gym.make(name).unwrapped.configuration.arm.links)  # type: ignore[attr-defined]
    return (
        f"The tip has settled when it stays within {1e3 * band:.3g} mm of its target until the end of the episode, for "
        f"at least {SETTLING_WINDOW:g} s. Settling time and vibration are medians. Vibration is the motion of the tip "
        f"from peak to peak (p-p) in the last {VIBRATION_WINDOW:g} s. The settling time of an episode that does not "
        "settle is infinite."
    )


def _cell(metric: Metric, runs: Rollout) -> str:
    result = metric.evaluate(runs.records)
    if metric.statistic == SHARE:
        return f"{result:.0%}"
    shown = metric.scale * result
    return f"<{LEAST:g}" if 0.0 < shown < LEAST else f"{shown:.3g}" if np.isfinite(shown) else "-"


def _left_out(each: Accuracy) -> list[str]:
    rows = [
        (text, *(f"{1e3 * float(value):.3g} mm" for value in (np.median(far), far.max())))
        for text, far in (("finer steps", each.steps), ("finer steps and model", each.model))
    ]
    return [
        f"{MOTIONS} arms are driven for {DURATION:g} s by random torques of up to half the limits. The default model "
        f"is compared with {FINER} times as many steps, and with a finer model that also has all coordinates and "
        "foreshortening. The largest distances of the tip are:",
        "",
        *markdown_table(("", "median", "largest"), rows),
        "",
        *markdown_table(("", "relative to the default"), [(STEP, f"{each.cost:.2g}")]),
    ]


def _conditions(name: str) -> list[str]:
    folder = NAMED_ENVIRONMENTS[name].conditions
    if not folder:
        return ["This environment has no conditions."]
    rows = [(f"`{NOMINAL}`", "The environment without changes.")]
    for each in CONDITIONS[1:]:
        said = (CONDITION_FOLDER / folder / f"{each}.yaml").read_text(encoding="utf-8").splitlines()[0]
        rows.append((f"`{each}`", said.removeprefix("# ")))
    return [
        f'`gym.make("{name}", condition="unknown")`, and `{name}/unknown` as the environment of a command:',
        "",
        *markdown_table(("", ""), rows),
    ]


def _nothing(name: str) -> list[str]:
    return []
