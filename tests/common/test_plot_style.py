"""Tests of the colours of lines: contrast on a white and on a dark page."""

import pytest

from flexman_gym.common.plot_style import LINK_COLOURS, rgb

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
