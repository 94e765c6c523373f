"""Page and chart of the study of arm designs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.plot_style import LINK_COLOURS, save_figure
from studies.arm_design.measure import EPISODES, GIVEN, HORIZON, NAMED, OPTIMISED, SECTIONS, DesignRow, ProfileRow
from studies.charts import new_chart
from studies.screen import picture, screen

PICTURE = "arm_design.svg"
QUESTION = "How much stiffer and faster does the paper's arm become at equal mass if the thickness of its links varies?"
ANSWER = """**With the mass of each link kept, the arm optimised for its first frequency has a frequency {frequency:.0%}
higher and settles {quicker:.0%} sooner: in {after:.1f} s in place of {before:.1f} s (median of {episodes} simulated
slews, gains optimised alike).** If mass may move between the links, the frequency is {free:.0%} higher."""
BODY = """{picture}

{table}

The arm is that of `FlexRRR-v0` with the corrected area of link 1, `link1_area="corrected"`; the printed one is ten
times too large. With the gains of `FlexRRR-v0` it settles in {named:.1f} s. `flexman optimise arm FILE --sections
{sections}` varies the sections between half and twice the given thickness. The arms have at
most its mass. Gears are between half and twice the given ratios and multiply the torque limits.

The claim is that of a linear model: held motors at zero angles for the frequency, two goals for the settling time.
Optima are local. Stress and buckling are not limited, and motors do not saturate in the model. The simulated settling
times, of slews of at most {horizon:g} s, are those of the nonlinear arm with torque limits."""


def page(rows: Sequence[DesignRow], profiles: Sequence[ProfileRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` are the files of both kinds of rows with their comments."""
    known = {row.design: row for row in rows if row.gains == OPTIMISED}
    (named,) = (row for row in rows if row.gains == NAMED)
    heads = ("optimised for", "mass, kg", "first frequency, Hz", "linear model, s", "simulated, s", "settled")
    cells = [
        (name, f"{row.mass:.1f}", f"{row.frequency:.3f}", f"{row.linear_time:.1f}", f"{row.settling_time:.2f}",
         f"{row.settled:.0%}") for name, row in known.items()
    ]  # fmt: skip
    given, stiffest = known[GIVEN], next(row for name, row in known.items() if "each link" in name)
    after, before = stiffest.settling_time, given.settling_time
    free = max(row.frequency for row in known.values()) / given.frequency - 1.0
    answer = ANSWER.format(
        frequency=stiffest.frequency / given.frequency - 1.0, quicker=1.0 - after / before, after=after, before=before,
        episodes=EPISODES, free=free,
    )  # fmt: skip
    chart = picture("Thickness of the sections of each link, as a factor of the given thickness", PICTURE)
    table = "\n".join(markdown_table(heads, cells))
    body = BODY.format(picture=chart, table=table, sections=SECTIONS, horizon=HORIZON, named=named.settling_time)
    return screen("Arms of varying thickness", QUESTION, answer, body, files, "arm_design")


def draw(rows: Sequence[ProfileRow], target: Path) -> None:
    """Draw the thickness along the links of the designs that keep the mass of each link."""
    names = [name for name in dict.fromkeys(row.design for row in rows) if "each link" in name]
    figure, (panels,) = new_chart((7.6, 2.6), columns=len(names))
    for axes, name in zip(panels, names, strict=True):
        for link, colour in zip((1.0, 2.0, 3.0), LINK_COLOURS, strict=False):
            factors = [row.thickness for row in rows if row.design == name and row.link == link]
            axes.stairs(factors, np.linspace(0.0, 1.0, len(factors) + 1), baseline=None, color=colour, linewidth=1.6,
                        zorder=3, label=f"link {link:g}")  # fmt: skip
        axes.set(title=name, xlabel="position / length of the link", ylim=(0.0, 2.1))
    panels[0].set_ylabel("thickness / given thickness")
    panels[0].legend(fontsize=8)
    save_figure(figure, target / PICTURE)
