"""Table of the named environments for the README."""

from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from studies.environments.family import FAMILIES

ARMS = {
    "FlexRRR": "three flexible links, flexible joints, the paper's arm with heavier rotors and damping",
    "FlexRRR-Gravity": "the same under gravity, stiffer joints",
    "FlexPlanar": "two flexible links, flexible joints, vertical plane",
    "FlexOne": "one flexible link, one flexible joint, the textbook case",
    "FlexQuanser": "two flexible links, horizontal plane, a real machine",
    "FlexRotary": "one flexible link, motor driven by its voltage",
    "FlexCrane": "loader crane, two flexible booms, a load on a rope without motors",
    "FlexTwoMass": "two masses and a spring, mass 2 measured",
    "FlexGantry": "portal that travels, flexible bridge, a load on a rope, no motor",
    "FlexDeck": "arm on the deck of a ship in a seaway, two flexible links",
}
TASKS = {
    "Slew": "move to a target and settle",
    "Track": "follow a path",
    "Hold": "stay still under disturbances",
}
PAGES = {name: family.file for family in FAMILIES for name in family.environments}  # environment -> its page


def environments() -> list[str]:
    """Return the table of the named environments."""
    rows = []
    for name, each in NAMED_ENVIRONMENTS.items():
        task = type(each.task).__name__
        arm = name.removesuffix("-v0").removesuffix(f"-{task}")
        reach = sum(link.length for link in each.arm.links)
        rows.append((f"[`{name}`](docs/environments/{PAGES[name]}.md#{name.lower()})", ARMS[arm], f"{reach:.2g} m",
                     f"{each.arm.payload.mass if each.arm.payload else 0:g} kg", f"{1.0 / each.control_period:.0f} Hz",
                     TASKS[task]))  # fmt: skip
    return markdown_table(("environment", "arm", "reach", "payload", "control", "task"), rows)
