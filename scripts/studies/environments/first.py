"""First: the settings that matter most for an agent that is to learn in a named environment."""

from pathlib import Path

from flexman_gym.envs.catalog import NAMED
from flexman_gym.envs.tasks import Slew
from flexman_gym.scene import file
from flexman_gym.verification.markdown import markdown_table

ROOT = Path(__file__).parents[3]
RECIPES, DOCS = ROOT / "agents" / "recipes", ROOT / "docs"
RECIPE = {
    "FlexRRR-v0": "ppo_on_pd", "FlexRRR-Track-v0": "track_ppo_on_pd", "FlexRRR-Hold-v0": "hold_ppo_on_pd",
    "FlexRRR-Gravity-v0": "gravity_ppo_on_pd", "FlexPlanar-v0": "planar_ppo_on_pd",
    "FlexPlanar-Track-v0": "planar_track_ppo_on_pd", "FlexPlanar-Hold-v0": "planar_hold_ppo_on_pd",
}  # fmt: skip
"""Environment -> its recipe."""
LASTS, GAMMA, ARMS = 0.1, 0.95, 256  # s, of an action, where no recipe says so; discount and arms of all recipes


def first(name: str) -> list[str]:
    """Lines in Markdown: what to set, why, and the environment that has it."""
    named = NAMED[name]
    recipe = RECIPE.get(name)
    given = file.read(RECIPES / f"{recipe}.yaml")["environment"] if recipe else {}
    hold = given.get("hold", round(LASTS / named.control_period))
    seconds = hold * named.control_period
    settings = {"base": "pd", "hold": hold, "sensors": ("full", "fine")}
    rows = [
        ("`base`", '`"pd"`', "the agent adds to a controller that brings the arm near its goal"),
        ("`hold`", f"`{hold}`", f"an action lasts {seconds:g} s, so that exploration shakes the arm less"),
        ("`sensors`", '`("full", "fine")`', "the state, and again on a scale that tells millimetres"),
    ]
    if isinstance(named.task, Slew):
        settings["task"] = {"kind": "slew", "reward": "distance", **_drawn(named.task)}
        rows.append(("`task`", '`"reward": "distance"`', "a slope at every scale, from metres to millimetres"))
    horizon = seconds / (1.0 - GAMMA)
    rows += [
        ("discount of PPO or SAC", f"`{GAMMA}`", f"looks {horizon:g} s ahead, about as long as a motion lasts"),
        (
            "`log_std_init`",
            "`-1.6`, or `-1.3` that falls to `-3.5`",
            "quiet exploration: an arm that shakes learns nothing",
        ),
        ("arms side by side", f"`{ARMS}`", "they cost little more than one"),
    ]
    known = "No recipe has been measured here; those of [learning.md](../learning.md) have these settings."
    if recipe:
        known = f"The recipe `{recipe}` has these settings, and "
        known += "[learning.md](../learning.md) what it reaches."
    words = "".join(f"    {key}={value!r},\n" for key, value in settings.items()).replace("'", '"').splitlines()
    made = [f'arms = gym.make_vec("{name}", {ARMS}, "vector_entry_point", autoreset_mode="SameStep",', *words, ")"]
    return [
        *markdown_table(("setting", "value", "why"), rows), "", "```python", *made, "```", "",
        f"{known} The README trains on such arms in a few lines of Stable-Baselines3.",
        *(["", *_curve(name)] if (DOCS / f"learning_{name}.png").is_file() else []),
    ]  # fmt: skip


def _curve(name: str) -> list[str]:
    """How the recipes of an environment learn, see `studies.learning.curves`."""
    return [
        f"![Reward while the recipes of {name} train](../learning_{name}.png)", "",
        "A line is the middle of the seeds, and where there are several its band goes from the worst to the best.",
    ]  # fmt: skip


def _drawn(task: Slew) -> dict[str, float]:
    """What a task draws otherwise than a plain slew."""
    plain = Slew()
    return {name: getattr(task, name) for name in ("start", "slew") if getattr(task, name) != getattr(plain, name)}
