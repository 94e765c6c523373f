"""Refusals: the one line with which something is refused."""

import pytest


def refusal(action, *arguments) -> str:
    """Return the one line with which `action` refuses."""
    with pytest.raises(ValueError) as error:
        action(*arguments)
    assert "\n" not in str(error.value) and len(str(error.value)) < 420
    return str(error.value)
