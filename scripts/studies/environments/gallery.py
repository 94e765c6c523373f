"""Page of all environments: gallery, table, and the text that they share."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.common.formatting import percent
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS, condition_names
from flexman_gym.envs.registration import CONDITION_FOLDER, CONDITIONS, NOMINAL
from flexman_gym.envs.sensors import SENSOR_NAMES
from flexman_gym.envs.tasks import TASKS, Slew
from flexman_gym.evaluation.shares import intervals_text
from flexman_gym.metrics import BAND, SETTLING_WINDOW, VIBRATION_WINDOW
from studies.environments.family import ACTION_SECONDS, ARMS, FAMILIES, RECIPE
from studies.environments.measure import DURATION, FINER, LONG, MOTIONS, SEEDS, SHAPED, SPEED, Baseline, baselines_of
from studies.environments.rewards import ALTERNATIVE, PICTURE
from studies.environments.text import (
    docstring_sections,
    episodes_text,
    is_slew,
    length,
    make,
    paragraph,
    task_arguments,
)
from studies.markdown import number_word

DISCOUNT = 0.95  # discount factor of all recipes
ARMS_TEXT = {
    "FlexRRR": "three links in space, 8.5 m",
    "FlexPlanar": "two strips in a vertical plane, 1 m",
    "FlexOne": "one strip, 0.8 m, in a horizontal plane",
    "FlexQuanser": "laboratory arm with two strips, 0.56 m",
    "FlexRotary": "strip on a motor driven by its voltage, 0.38 m",
    "FlexCrane": "loader crane with a load on a rope, booms of 3.2 m",
    "FlexTwoMass": "two masses and a spring, horizontal",
    "FlexGantry": "portal that travels, bridge of 6 m, load on a rope of 4 m",
    "FlexDeck": "arm on the deck of a ship in a seaway, 8.5 m",
}
TASKS_TEXT = {
    "Slew": "move the tip to a target and stop it there",
    "Track": "follow a closed path",
    "Hold": "keep the tip in place under disturbances",
}
HEAD = """---
hide:
  - toc
---

# Environments

{count} environments differ in the arm and in the task. Each is made by `gym.make(id)`;
`gym.make_vec(id, 256)` simulates 256 arms at once. In each picture the PD controller acts at
the left and the tracking LQR at the right, on the same episode; the chart below shows the distance of the tip from its
target. The deflection of the links is magnified by the factor in the picture, a violet dot is the true tip, and the
grey arm is the rigid one. The PD has the gains of the environment. The tracking LQR is the reference with full
information, the true state and parameters; one rule gives its weights in all environments, so the PD of an environment
can be better. FlexGantry-v0 has no motor: the portal travels by the PD at the left and by the PD with input shaper at
the right.
"""

REPLAY = """## An episode in the browser

The episode of the [first picture of the home page](../index.md), to be turned, slowed down and magnified;
`flexman replay` makes such a page of saved episodes ([open it alone](../replay.html)).

<iframe class="replay" src="../replay.html" title="A slew under a PD controller and a policy" loading="lazy"></iframe>
"""


def gallery_page(baselines: Sequence[Baseline]) -> str:
    """Return the page of all environments as Markdown, with the metrics of the baselines."""
    count = number_word(len(NAMED_ENVIRONMENTS)).capitalize()
    lines = [*HEAD.format(count=count).splitlines(), "", '<div class="gallery" markdown>', ""]
    pages = {name: family.file for family in FAMILIES for name in family.environments}
    for name in NAMED_ENVIRONMENTS:
        link = f"{pages[name]}.md#{name.lower()}"
        others = [each for each in ("tracking LQR", SHAPED) if each in baselines_of(name)]
        seen = f"PD and {others[0]} on the same episode" if others else "PD"
        lines += [f"[![{name}: {seen}]({name}.gif)]({link})",
                  f"[**{name}**]({link}): {_task(name)}{_caption(name, baselines)}", ""]  # fmt: skip
    lines += ["</div>", "", *_table(pages, baselines), "", *_definitions(baselines), "", *REPLAY.splitlines(), ""]
    lines += ["## Sensors", "", *_sensors(), "", "## Conditions", "", *_conditions(), ""]
    lines += ["## Settings for a first training", "", *_first_training(), "", "## Further settings", ""]
    lines += ["[Tasks](tasks.md): rewards, starts, ends and arguments.", ""]
    lines += ["All [keywords of `gym.make`](keywords.md): arm, task, sensors, base controller, model, randomisation."]
    return "\n".join(lines) + "\n"


def tasks_page() -> str:
    """Return the page of the tasks as Markdown: descriptions, rewards, starts, ends and arguments."""
    lines = ["# Tasks", "", "Each environment has one of these tasks; the setting `task` changes it.", ""]
    for kind, task in TASKS.items():
        if any(type(named.task) is task for named in NAMED_ENVIRONMENTS.values()):
            lines += [f"## {kind.capitalize()}", "", *_task_text(task), ""]
            lines += [f"![{ALTERNATIVE}]({PICTURE})", ""] if task is Slew else []
    return "\n".join(lines).rstrip() + "\n"


def _task(name: str) -> str:
    return TASKS_TEXT[type(NAMED_ENVIRONMENTS[name].task).__name__]


def _caption(name: str, baselines: Sequence[Baseline]) -> str:
    """Return the end of a caption: speed of the picture, and results where the PD is better than the tracking LQR."""
    speed = SPEED.get(name, 1.0)
    times = f"{1.0 / speed:g} times slower" if speed < 1.0 else f"{speed:g} times faster"
    text = f"; shown {times}" * (speed != 1.0)
    found = {row.baseline: row for row in baselines if row.environment == name}
    if "tracking LQR" not in found:
        return text
    pd, lqr = found["PD"], found["tracking LQR"]
    if is_slew(name) and pd.settling_time < lqr.settling_time:
        return f"{text}. The PD settles first, after {pd.settling_time:.3g} s, the LQR after {lqr.settling_time:.3g} s"
    if not is_slew(name) and pd.rms_error < lqr.rms_error:
        return f"{text}. The PD is closer: RMS error {length(pd.rms_error)}, LQR {length(lqr.rms_error)}"
    return text


def _table(pages: dict[str, str], baselines: Sequence[Baseline]) -> list[str]:
    """Return the table of all environments, with the results of PD and tracking LQR."""
    rows = []
    for name, named in NAMED_ENVIRONMENTS.items():
        sizes = f"{len(make(name).sensors.bound)} / {make(name).action_space.shape[0]}"
        arm = ARMS_TEXT[name.split("-")[0]] + (", on earth" if "Gravity" in name else "")
        found = {row.baseline: _result(row) for row in baselines if row.environment == name}
        results = [found.get(each, "-") for each in ("PD", "tracking LQR")]
        rate = f"{1.0 / named.control_period:g} Hz"
        rows.append((f"[{name}]({pages[name]}.md#{name.lower()})", arm, type(named.task).__name__.lower(), rate, sizes,
                     *results))  # fmt: skip
    heads = ("id", "arm", "task", "rate", "observations / actions", "PD", "tracking LQR")
    return markdown_table(heads, rows)


def _result(row: Baseline) -> str:
    """Return the result of a baseline in a few words."""
    if not is_slew(row.environment):
        return f"RMS error {length(row.rms_error)}"
    time = f" after {row.settling_time:.3g} s" if np.isfinite(row.settling_time) else ""
    return f"settles in {percent(row.settled)}{time}"


def _definitions(baselines: Sequence[Baseline]) -> list[str]:
    """Return the definitions of the metrics and of the baselines."""
    results = paragraph(
        f"The results are those of {episodes_text(baselines)} (seeds from {SEEDS[0]}). {intervals_text(len(SEEDS))}",
        "The PD reads the motor angles only; the tracking LQR is given the parameters and the full state of the arm.",
        f"The tip has **settled** when it stays within {BAND:.3g} of the reach of its target until the end of the",
        f"episode, for at least {SETTLING_WINDOW:g} s. Settling time and vibration are medians over the episodes; the",
        "settling time of an episode that does not settle is infinite. **Vibration** is the motion of the tip from",
        f"peak to peak in the last {VIBRATION_WINDOW:g} s. The tuned PD of FlexRRR-v0 is too slow for episodes of 10 s",
        f"and settles in episodes of {LONG:g} s. In the tasks track and hold the target starts at the tip, and the",
        "metric is the RMS tip error over the episode (median).",
    )
    error = paragraph(
        f"The **error of the model** is measured with {MOTIONS} arms under random torques of up to half the limits for",
        f"{DURATION:g} s, as the largest distance of the tip from that of a finer model, which has {FINER} times as",
        "many steps, all coordinates of the elements, and foreshortening.",
    )
    return [*results, "", *error]


def _task_text(task: type) -> list[str]:
    """Return the sections of a task that all its environments share."""
    sections = docstring_sections(task)
    lines = [*sections["Description"], ""]
    for title in ("Reward", "Start", "End"):
        lines += [f"**{title}.** {sections[title][0]}", *sections[title][1:], ""]
    extra = [] if sections["Arguments"] == ["The attributes below."] else sections["Arguments"]
    return [*lines, "**Arguments.**", *extra, "", *task_arguments(task)]


def _sensors() -> list[str]:
    """Return the table of the sensors of FlexRRR-v0, and of the foundation of FlexGantry-v0."""
    rows = []
    for name in SENSOR_NAMES:
        where = "FlexGantry-v0" if name == "foundation" else "FlexRRR-v0"
        places = make(where, sensors=name).sensors.slices
        slices = {part: place for part, place in places.items() if name != "foundation" or part.startswith("travel")}
        size = sum(place.stop - place.start for place in slices.values())
        rows.append((f"`{name}`", size, ", ".join(f"`{part}`" for part in slices)))
    text = paragraph(
        "The agent reads the sensors named by the setting `sensors`, one name or several:",
        '`sensors=("lab", "action")`. A mapping adds flaws to a sensor, for example',
        '`{"kind": "strain", "noise": 1e-6}`. Sizes are those of FlexRRR-v0; `foundation` is one of FlexGantry-v0.',
    )
    return [*text, "", *markdown_table(("name", "entries", "slices"), rows)]


def _conditions() -> list[str]:
    """Return the table of the conditions."""
    without = [name for name, named in NAMED_ENVIRONMENTS.items() if not named.conditions]
    rows = [(f"`{NOMINAL}`", "The environment without changes.")]
    for each in CONDITIONS[1:]:
        path = CONDITION_FOLDER / NAMED_ENVIRONMENTS[DEFAULT_ID].conditions / f"{each}.yaml"
        own = [name for name, named in NAMED_ENVIRONMENTS.items() if each in condition_names(name)]
        if not path.exists():
            path = CONDITION_FOLDER / NAMED_ENVIRONMENTS[own[0]].conditions / f"{each}.yaml"
        about = path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
        rows.append(
            (f"`{each}`", about if path.parent.name not in ("gantry", "deck") else f"{about} Only {', '.join(own)}.")
        )
    text = paragraph(
        'A condition makes an environment harder: `gym.make("FlexRRR-v0", condition="unknown")`, or',
        f"`FlexRRR-v0/unknown` as the environment of a command. {' and '.join(without)} have none.",
    )
    return [*text, "", *markdown_table(("condition", "change"), rows)]


def _first_training() -> list[str]:
    """Return the recommended settings for a first training, with reasons."""
    rows = [
        ("`base`", '`"pd"`', "the agent adds to a controller that moves the arm close to its goal"),
        ("`action_repeat`", f"{ACTION_SECONDS:g} s", "exploration excites less vibration"),
        ("`sensors`", '`("full", "fine")`', "the state, and the state scaled to millimetres"),
        ("`task` of a slew", '`"reward": "distance"`', "a gradient at every scale, from metres to millimetres"),
        ("discount of PPO or SAC", f"`{DISCOUNT}`", "the horizon is about the duration of a motion"),
        ("`log_std_init`", "`-1.6`, or `-1.3` decreasing to `-3.5`", "strong vibration prevents learning"),
        ("number of arms", f"`{ARMS}`", "a batch costs little more than one arm"),
    ]
    recipes = ", ".join(f"`{recipe}` for {name}" for name, recipe in RECIPE.items())
    text = paragraph(
        f"Recipes have these settings: {recipes}. Their results are on the page of [results](../results.md)."
    )
    return [*markdown_table(("setting", "value", "reason"), rows), "", *text]
