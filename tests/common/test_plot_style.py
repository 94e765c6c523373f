"""Colours of lines are legible on a white and on a dark page, and transparent charts have no colour of a page."""

import pytest

from flexman_gym.common.plot_style import DARK, LINK_COLOURS, SLATE, rgb, save_figure
from studies.charts import new_chart

DARK_PAGE = "#1e2129"  # background of the dark scheme of the site


def luminance(colour):
    """Return the relative luminance of a colour, 0 to 1 (WCAG 2.2)."""
    parts = rgb(colour) / 255.0
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True)))


def contrast(first, second):
    """Return the contrast of two colours, 1 to 21."""
    dark, bright = sorted((luminance(first), luminance(second)))
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("page", ["#ffffff", DARK_PAGE])
def test_every_colour_of_a_line_has_a_contrast_of_three(page):
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0) and len(set(LINK_COLOURS)) == 6
    for colour in LINK_COLOURS:
        assert contrast(colour, page) > 3.0, colour


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
