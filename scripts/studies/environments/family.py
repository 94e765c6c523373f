"""Page of the environments of a family of arms."""

import json
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common import files
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.envs.foundation import find_foundation
from flexman_gym.envs.sensors.ideal import NEARNESS_LENGTH
from flexman_gym.envs.tasks import Slew
from studies.environments.measure import AGENTS, DURATION, SHAPED, SPREAD, Baseline, ModelError, baselines_of, travels
from studies.environments.rewards import reward_lines
from studies.environments.text import (
    arm_facts,
    baseline_table,
    docstring_sections,
    episodes_text,
    is_slew,
    length,
    make,
    observation_rows,
    paragraph,
    settled_text,
)
from studies.files import read_rows
from studies.machine.measure import SCORE, SHEET, FitRow

ROOT = Path(__file__).parents[3]
RECIPES, EVIDENCE = ROOT / "agents" / "recipes", ROOT / "docs" / "evidence"
RECIPE = {
    "FlexRRR-v0": "ppo_on_pd", "FlexRRR-Track-v0": "track_ppo_on_pd", "FlexRRR-Hold-v0": "hold_ppo_on_pd",
    "FlexRRR-Gravity-v0": "gravity_ppo_on_pd", "FlexPlanar-v0": "planar_ppo_on_pd",
    "FlexPlanar-Track-v0": "planar_track_ppo_on_pd", "FlexPlanar-Hold-v0": "planar_hold_ppo_on_pd",
}  # fmt: skip
"""Environment -> its recipe."""
TRAINED_REWARD = "distance"  # reward of a slew in trainings, whose slope reaches from metres to millimetres
SLOW = "The PD reads motor angles only: [why it is slow](../questions.md#why-does-the-pd-of-flexrrr-v0-settle-0).", ""
ACTION_SECONDS, ARMS = 0.1, 256  # s, 1; duration of an action without a recipe; number of arms of a training


class Family(NamedTuple):
    """Environments that share a page.

    Attributes:
        file: name of the page without suffix.
        title: title of the page.
        text: introduction.
        environments: ids of the environments, the first of which is the plainest.
    """

    file: str
    title: str
    text: str
    environments: tuple[str, ...]


FAMILIES = (
    Family(
        "FlexRRR",
        "FlexRRR: a spatial arm with three joints",
        "An arm after Table 1 of [the paper](../the_paper.md) moves in space. All links and joints are flexible, and "
        "its reach is 8.5 m. Three environments have no gravity. In the fourth the arm carries a payload on earth, "
        "with stiffer joints and stronger motors.",
        ("FlexRRR-v0", "FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexRRR-Gravity-v0"),
    ),
    Family(
        "FlexPlanar",
        "FlexPlanar: two strips in a vertical plane",
        "Two aluminium strips on elastic joints lift a payload in a vertical plane. Gravity deforms the arm at rest, "
        "and the motors have to hold its weight.",
        ("FlexPlanar-v0", "FlexPlanar-Track-v0", "FlexPlanar-Hold-v0"),
    ),
    Family(
        "FlexOne-FlexQuanser",
        "FlexOne and FlexQuanser: one joint, and a laboratory arm",
        "FlexOne is the textbook case: one strip on one elastic joint in a horizontal plane. FlexQuanser is a model of "
        "a laboratory arm that can be bought, with its motors, encoders and strain gauges.",
        ("FlexOne-v0", "FlexQuanser-v0"),
    ),
    Family(
        "FlexRotary",
        "FlexRotary: a strip on a motor driven by its voltage",
        "A steel strip on the hub of a geared motor, the rotary flexible link of Quanser that many laboratories have. "
        "An action is a voltage, and encoder and strain gauge are read at 500 Hz.",
        ("FlexRotary-v0",),
    ),
    Family(
        "FlexCrane",
        "FlexCrane: a loader crane with a load on a rope",
        "A small loader crane slews and lifts a load that hangs below its second boom. The motors of column, lift and "
        "knuckle have elastic drives, both booms bend, and the two joints of the hook have no motor. The load is "
        "the tip of the arm, so that its swing is part of the tip error.",
        ("FlexCrane-v0",),
    ),
    Family(
        "FlexTwoMass",
        "FlexTwoMass: two masses and a spring",
        "The benchmark of Wie and Bernstein (1992): rotor and rigid link have an inertia of 1 kg m^2 each, the joint "
        "is a spring of 1 N m/rad between 0.5 and 2, and the torque is at most 1 N m. Only the position of mass 2, the "
        "angle of the link, is measured. `lqg` and `hinf` are designed with this sensor. A PD of the angle of mass 2 "
        "does not stabilise the masses, so that `pd` reads the encoder of the motor, which the benchmark lacks. "
        "[Probabilities of instability](../evidence/two_masses.md) for random springs.",
        ("FlexTwoMass-v0",),
    ),
    Family(
        "FlexGantry",
        "FlexGantry: a portal that travels with a load on a rope",
        "The portal of a gantry crane travels on rails, a flexible bridge of 6 m stands out from it, and a load of "
        "500 kg hangs from a rope of 4 m at the tip of the bridge. No joint has a motor: the only command is the "
        "travel of the portal, see [foundations](../moving_foundations.md). The load is the tip of the arm, so that "
        "its swing, 4.1 s a period, is part of the tip error. With a rigid bridge it is the trolley and pendulum of "
        "textbooks, on which ZV shaping (Singer and Seering, 1990) leaves the residual that theory predicts. A shaper "
        "that is designed for the rope of 4 m and meets another one has the mode of its design, 0.246 Hz: "
        '`fm.evaluate({"kind": "pd-shaped", "shaper": "zv", "modes": [[0.246, 0.002]]}, "FlexGantry-v0/long-rope")`.',
        ("FlexGantry-v0",),
    ),
    Family(
        "FlexDeck",
        "FlexDeck: an arm on the deck of a ship",
        "The deck rolls, pitches, yaws and heaves in a seaway of 8 s, a sum of sines of a JONSWAP spectrum drawn for "
        "each episode, see [foundations](../moving_foundations.md). An arm with two flexible links holds "
        "a load of 10 kg still in the world. In the base frame the target moves; the goals of the motors follow it by "
        "inverse kinematics, and controllers of moving goals know them in advance. The sensor `foundation` reads roll, "
        "pitch and yaw (`base_angles`), angular velocity and acceleration of the deck.",
        ("FlexDeck-v0",),
    ),
)


def family_page(family: Family, baselines: Sequence[Baseline], errors: Sequence[ModelError]) -> str:
    """Return the page of a family of environments as Markdown.

    Args:
        family: the family.
        baselines: metrics of the baselines of all environments.
        errors: errors of the default models of all environments.
    """
    first = family.environments[0]
    lines = [
        f"# {family.title}", "", *paragraph(family.text), "",
        "```python", "import gymnasium as gym", "import flexman_gym", "", f'env = gym.make("{first}")', "```", "",
        "## Actions", "", *_actions(family), "",
        "## Observations", "", *_observations(family),
        *(["## Reward", "", *reward_lines(first), ""] if is_slew(first) else []),
        "## Arm", "", *_arms(family), "", *_differences(first),
    ]  # fmt: skip
    for name in family.environments:
        lines += [f"## {name}", "", *_environment(name, baselines, errors, name == first), ""]
    if "FlexQuanser-v0" in family.environments:
        lines += ["### The real machine", "", *_machine(), ""]
    lines += paragraph(
        "Rewards and ends: [tasks](tasks.md); sensors, conditions and metrics: [all environments](index.md).",
    )
    return "\n".join(lines) + "\n"


def _actions(family: Family) -> list[str]:
    """Return the table of the actions, with the torque limits of each environment."""
    if family.environments == ("FlexRotary-v0",):
        return _voltages(family.environments[0])
    if travels(family.environments[0]):
        return _travel(family.environments[0])
    limits = {
        name: tuple(each for each in make(name).configuration.torque_limit if each) for name in family.environments
    }
    groups = _groups(limits)
    rows = []
    for i in range(max(map(len, groups))):
        cells = [f"{limit[i]:g} N m" if i < len(limit) else "-" for limit in groups]
        rows.append((i, f"torque of motor {i + 1} / its limit", "-1 to 1", *cells))
    rates = [f"{1.0 / NAMED_ENVIRONMENTS[name].control_period:g} Hz in {name}" for name in family.environments]
    heads = ("entry", "meaning", "range", *(f"limit in {_short(names)}" for names in groups.values()))
    text = paragraph(f"A torque is constant during a control period: {', '.join(rates)}.")
    return [*markdown_table(heads, rows), "", *text]


def _travel(name: str) -> list[str]:
    """Return the table of the action of an environment whose only command is the travel of the foundation."""
    named = NAMED_ENVIRONMENTS[name]
    servo = find_foundation(named.foundation)
    rows = [(0, "`travel`: velocity of the portal / its limit", "-1 to 1", f"{servo.speed:g} m/s")]
    text = paragraph(
        "A stiff servo accelerates the portal uniformly in a control period,",
        f"{1.0 / named.control_period:g} Hz, to the",
        f"commanded velocity, with at most {servo.acceleration:g} m/s^2: it lags by half a period. Rails end",
        f"{servo.travel:g} m from the middle on both sides. Near an end the servo limits the velocity such that the",
        "portal comes to rest before it. The swing of the load does not move the portal.",
    )
    more = paragraph(
        'With `base="pd"` an action is added to the velocity from which half of the largest acceleration stops',
        'the portal at its goal, with `base="pd-shaped"` to a trapezoid of the velocity, convolved with an input',
        "shaper for the swing. Start and goal of the travel are drawn between the ends, or given by the options",
        "`travel_start` and `travel_goal` of the reset, m. The picture shows the portal where it is; the replay page",
        "and the live view show the arm in the frame of the portal, in which the target moves.",
    )
    heads = ("entry", "meaning", "range", f"limit in {_short([name])}")
    return [*markdown_table(heads, rows), "", *text, "", *more]


def _voltages(name: str) -> list[str]:
    """Return the table of the actions of an environment whose motors are driven by their voltage."""
    configuration = make(name).configuration
    motors = [joint.motor for joint in configuration.arm.joints]
    rows = [(i, f"voltage of motor {i + 1} / its limit", "-1 to 1", f"{motor.voltage_limit:g} V", f"{limit:.2g} N m")
            for i, (motor, limit) in enumerate(zip(motors, configuration.torque_limit, strict=True))]  # fmt: skip
    heads = ("entry", "meaning", "range", "limit", "torque at standstill")
    rate = 1.0 / configuration.control_period
    text = paragraph(
        f"A voltage is constant during a control period, {rate:g} Hz. The back-EMF of the motor acts as a damper; a PD",
        "and other controllers command the torque at standstill.",
    )
    return [*markdown_table(heads, rows), "", *text]


def _groups(values: dict[str, tuple]) -> dict[tuple, list[str]]:
    """Return the names of equal values: value -> names."""
    result: dict[tuple, list[str]] = {}
    for name, value in values.items():
        result.setdefault(value, []).append(name)
    return result


def _short(names: Sequence[str]) -> str:
    """Return environments as text without their versions; a family's first three names share a start."""
    return ", ".join(name.removesuffix("-v0") for name in names)


def _observations(family: Family) -> list[str]:
    """Return the tables of the observations: those of the first environment, then what the others add or change."""
    first, *others = family.environments
    heads = ("slice", "entries", "unit", "largest")
    known = observation_rows(first)
    lines = [f"{first}, Box ({_size(known)},):", "", *markdown_table(heads, known), "", *_components(known), ""]
    different = {name: rows for name in others if (rows := observation_rows(name)) != known}
    if len(different) < len(others):
        lines += [f"The same in {', '.join(name for name in others if name not in different)}.", ""]
    for name, rows in different.items():
        more = [row for row in rows if row not in known]
        added = set(known) <= set(rows)
        lines += [f"{name}, Box ({_size(rows)},){', in addition' if added else ''}:", ""]
        lines += [*markdown_table(heads, more if added else rows), ""]
    rows = observation_rows(first, "lab")
    same = next(i for i, (row, other) in enumerate(zip(rows, known, strict=False)) if row != other)
    start = f" from entry {_size(rows[:same])} on, after those above" if same else ""
    lines += [f'With `sensors="lab"`, the sensors of a laboratory, {first} has Box ({_size(rows)},){start}:', ""]
    return [*lines, *markdown_table(heads, rows[same:]), ""]


def _components(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the order of the numbers within the slices of a table of observations."""
    names = {row[0].strip("`") for row in rows}
    parts = ["Motors, joints and links are counted from the base."]
    if "link_deflections" in names:
        parts += ["Deflections are those of the tip of each link along y and z of its beam frame."]
    if "target_error" in names:
        parts += ["`target_error` e is the target minus the tip in the base frame (x, y, z)."]
    if "target_nearness" in names:
        parts += [f"`target_nearness` is e / (|e| + {NEARNESS_LENGTH:.3g} R) for a reach R: it resolves millimetres."]
    return paragraph(*parts)


def _size(rows: Sequence[tuple[str, ...]]) -> int:
    return 1 + int(rows[-1][1].split("-")[-1])


def _arms(family: Family) -> list[str]:
    """Return the table of the arms of a family, a column for each different arm."""
    groups = _groups({name: tuple(arm_facts(name).items()) for name in family.environments})
    facts = [dict(group) for group in groups]
    rows = [(key, *(each[key] for each in facts)) for key in facts[0]]
    return markdown_table(("property", *(_short(names) for names in groups.values())), rows)


def _differences(name: str) -> list[str]:
    """Return a link to the differences between the arm of FlexRRR-v0 and that of the paper."""
    text = paragraph(
        "Rotors and damping [differ from the paper](../the_paper.md#what-flexrrr-v0-changes-and-why), whose area of",
        "link 1 is ten times too large for its polar moment.",
    )
    return [*text, ""] if name == DEFAULT_ID else []


def _environment(name: str, baselines: Sequence[Baseline], errors: Sequence[ModelError], code: bool) -> list[str]:
    """Return the section of an environment: picture, task, baselines, error of the model, first training.

    Args:
        name: environment.
        baselines: metrics of the baselines.
        errors: errors of the default models.
        code: True for example code of the first training.
    """
    named = NAMED_ENVIRONMENTS[name]
    kind, own = type(named.task).__name__, [row for row in errors if row.environment == name]
    values = {"kind": kind.lower()} | {key: value for key, value in vars(named.task).items() if not key.startswith("_")}
    shown = textwrap.wrap(f"task = {json.dumps(values)}", 100, subsequent_indent=8 * " ")
    description = docstring_sections(type(named.task))["Description"]
    others = [each for each in ("tracking LQR", SHAPED) if each in baselines_of(name)]
    seen = f"PD controller at the left, {others[0]} at the right, tip errors below" if others else "PD controller"
    picture = f"{name}: {seen}"
    controllers = f"with the PD, and with the {others[0]}" if others else "and with the PD"
    quantity = "speed of the portal" if travels(name) else "largest torque"
    chart = f"{name}: tip error and {quantity} of an episode without torque, {controllers}"
    task = f"Task [{kind}](tasks.md#{kind.lower()}), control period {named.control_period:g} s, episodes of "
    return [
        f"![{picture}]({name}.gif){{ width=432 }}", "", *description, "",
        f"{task}{named.horizon:g} s:", "", "```python", *shown, "```", "",
        *baseline_table(name, baselines), "", *(SLOW if name == DEFAULT_ID else ()),
        f"![{chart}]({name}.svg){{ width=464 }}", "",
        *_under_conditions(name, baselines), *(_model_error(own[0]) if own else []), *_first_training(name, code),
    ]  # fmt: skip


def _under_conditions(name: str, baselines: Sequence[Baseline]) -> list[str]:
    """Return the table of the baselines that were measured under conditions of an environment; [] without such rows."""
    rows = [row for row in baselines if row.environment.startswith(f"{name}/")]
    conditions = list(dict.fromkeys(row.environment.partition("/")[2] for row in rows))
    names = list(dict.fromkeys(row.baseline for row in rows))
    found = {(row.baseline, row.environment.partition("/")[2]): settled_text(row) for row in rows}
    cells = [(each, *(found.get((each, condition), "-") for condition in conditions)) for each in names]
    if not rows:
        return []
    text = paragraph(
        f"Settled episodes and median settling time under conditions, {episodes_text(rows)}; one column by",
        f"`flexman league --agents {' '.join(AGENTS[each] for each in names)} --scenarios {name}/{conditions[0]}`.",
        "Controllers are designed for the arm of a condition, also for its rope, and for the middle of drawn payloads:",
    )
    return [*text, "", *markdown_table(("baseline", *(f"`{each}`" for each in conditions)), cells), ""]


def _model_error(row: ModelError) -> list[str]:
    """Return the error of the default model in a sentence."""
    motors = any(not joint.passive for joint in NAMED_ENVIRONMENTS[row.environment].arm.joints)
    motion = "Random torques of up to half the limits" if motors else f"Swing from up to {SPREAD:g} rad"
    return paragraph(
        f"{motion}: largest model error of the tip within {DURATION:g} s",
        f"{length(row.model_largest)}, by the steps {length(row.steps_largest)}.",
    )


def _first_training(name: str, code: bool) -> list[str]:
    """Return the recommended settings for a first training: the recipe, and example code if `code` is True."""
    named, recipe = NAMED_ENVIRONMENTS[name], RECIPE.get(name)
    given = files.read_data(RECIPES / f"{recipe}.yaml")["environment"] if recipe else {}
    settings = {"base": "pd", "action_repeat": given.get("action_repeat", round(ACTION_SECONDS / named.control_period)),
                "sensors": ("full", "fine")}  # fmt: skip
    if is_slew(name):
        settings["task"] = {"kind": "slew", "reward": TRAINED_REWARD, **_drawn(named.task)}
    words = ", ".join(f"{key}={value!r}" for key, value in settings.items()).replace("'", '"')
    made = [f'arms = gym.make_vec("{name}", {ARMS}, autoreset_mode="SameStep",', f"    {words})"]
    known = f"the recipe `{recipe}` has them" if recipe else "there is no recipe for this environment"
    text = "[Settings](index.md#settings-for-a-first-training) for a first training"
    if not code:
        return paragraph(f"{text}: an action lasts {settings['action_repeat']} control periods, and {known}.")
    reward = getattr(named.task, "reward", TRAINED_REWARD)
    differs = "" if reward == TRAINED_REWARD else f" (the environment alone has the reward `{reward}`)"
    return [*paragraph(f"{text}; {known}{differs}:"), "", "```python", *made, "```"]


def _drawn(task: Any) -> dict[str, float]:
    """Return the initial conditions of a slew task that differ from the default slew."""
    plain = Slew()
    return {name: getattr(task, name) for name in ("start", "slew") if getattr(task, name) != getattr(plain, name)}


def _machine() -> list[str]:
    """Return what is known of the arm of FlexQuanser-v0 as a machine, with numbers of the study of its records."""
    rows = read_rows(EVIDENCE / "machine.csv", FitRow)
    held_out, sheet = ([row.value for row in rows if row.part == part] for part in (SCORE, SHEET))
    items = (
        "Quanser's 2-DoF Serial Flexible Link: two steel strips in a horizontal plane on geared DC motors.",
        "An aluminium block between the strips carries the second motor; a load is fixed to the end of strip 2.",
        "Each motor has an encoder, and each strip a strain gauge at its root. The tip is not measured.",
        "Lengths, sections, inertias and torque limits of the model are those of the manufacturer's data file.",
        "The Czech Technical University in Prague published records of its machine; "
        f"{len(held_out)} runs are compared. Given the measured hub angle, the model with two fitted parameters "
        f"explains {np.median(held_out):.3f} of the variance of the deflection in held-out runs (median), with the "
        f"data sheet alone {np.median(sheet):.3f}.",
        "Friction of the gears dominates small steps: from motor currents alone the angle of the second hub drifts.",
        "The environment has no friction by default; the setting `randomisation` adds it.",
        "[Comparison with the records](../evidence/machine.md); the arm itself is `fm.catalog.quanser_2dsfl()`.",
    )
    return [line for item in items for line in paragraph(f"- {item}", indent="  ")]
