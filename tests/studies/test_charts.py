"""Tests of the charts of studies: transparent, with one colour of text, and the same in each run."""

import pytest

from flexman_gym.common.plot_style import DARK, LINK_COLOURS, SLATE, save_figure
from studies.charts import new_chart


def test_a_chart_has_no_background_and_one_colour_of_text_and_is_the_same_again(tmp_path):
    pytest.importorskip("matplotlib")
    texts = []
    for name in ("a", "b"):
        figure, ((axes,),) = new_chart((3.0, 2.0))
        axes.plot([0.0, 1.0], [0.0, 1.0], color=LINK_COLOURS[0], label="line")
        axes.set(xlabel="time (s)", title="title")
        axes.axhline(0.5, color=DARK)
        axes.annotate("limit", (0.1, 0.5), color="black")
        axes.legend()
        texts.append(save_figure(figure, tmp_path / name / "chart.svg").read_text())
    assert texts[0] == texts[1]
    lower = texts[0].lower()
    assert "#ffffff" not in lower and "#000000" not in lower and DARK not in lower and lower.count(SLATE) > 3
