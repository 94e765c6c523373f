"""Fixtures of drawings: the Matplotlib figures that a test makes."""

import pytest


@pytest.fixture
def drawn(monkeypatch):
    """Return the list of the figures of trajectories and of the paper that are made from now on."""
    pytest.importorskip("matplotlib")
    from flexman_gym.toolbox.view import paper, trajectories

    made, new_figure = [], trajectories.new_figure
    kept = lambda *given, **named: made.append(new_figure(*given, **named)) or made[-1]  # noqa: E731
    for module in (paper, trajectories):
        monkeypatch.setattr(module, "new_figure", kept)
    return made
