"""Refusals: the one line with which something is refused."""

import pytest

from flexman_gym.checks import shown


def refusal(action, *arguments) -> str:
    """Return the one line with which `action` refuses."""
    with pytest.raises(ValueError) as error:
        action(*arguments)
    assert "\n" not in str(error.value) and len(str(error.value)) < 420
    return str(error.value)


def offenders(action, values, good) -> list[str]:
    """Those of many values that an action takes or refuses as it should not, each with its line.

    `good` judges the line of a refusal, which is "" for a value that is taken; another error is never good.
    """
    result = []
    for value in values:
        try:
            action(value)
            line = ""
        except ValueError as error:
            line = str(error) or repr(error)
        except Exception as error:
            result.append(f"{shown(value)} gives {type(error).__name__}: {error}")
            continue
        if not good(line):
            result.append(f"{shown(value)} is refused with {line}" if line else f"{shown(value)} is taken")
    return result
