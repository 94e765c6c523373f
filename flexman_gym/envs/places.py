"""Places: the posture of an arm whose tip rests at a place that was asked for."""

from collections.abc import Mapping

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.simulation.view import View

TIPS = {"start_tip": "start", "goal_tip": "goal_angles"}  # option with a place of the tip -> the posture that it sets
STARTS, ROUNDS = 24, 20  # of the search for postures, and of that for the place beside which a heavy arm rests
REACHED = 1e-8  # of the reach


def postures_of(plan: Mapping[str, Array], view: View) -> dict[str, Array]:
    """Gives plans, name -> (r, ...), with postures (r, n) rad in place of the places (r, 3) m of TIPS.

    A goal is sought from the start, and a start from zero angles; see `posture_at`.

    Raises:
        ValueError: for a place that the tip cannot reach.
    """
    result = dict(plan)
    for name, posture in TIPS.items():
        if name in plan:
            near = result["start"] if posture != "start" else np.zeros((len(plan[name]), view.n_joints))
            pairs = zip(result.pop(name), near, strict=True)
            result[posture] = np.array([posture_at(f"options[{name!r}]", *pair, view) for pair in pairs])
    return result


def posture_at(field: str, place: Array, near: Array, view: View) -> Array:
    """Gives the motor angles (n,) rad with which the tip rests at a place (3,) m of the base frame.

    Where there are several, it is the one from which the joints are turned least (least sum of squares) away from
    `near`, of those that Newton's method finds from `near` and from 24 postures that are always the same.

    Args:
        field: for the error.
        place: m.
        near: (n,) rad.
        view: of the arm, whose nominal weight bends it.

    Raises:
        ValueError: where the tip comes there from none of them.
    """
    others = near + np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, len(near)))
    found = [angles for start in (near, *others) if (angles := _reached(place, start, view)) is not None]
    if not found:
        span = f"{view.reach:.4g} m of links"
        raise refusal(field, place.tolist(), f"a place (m, base frame) that the tip can reach with {span}")
    turned = np.array(found) - near
    turned -= 2.0 * np.pi * np.round(turned / (2.0 * np.pi))
    result: Array = near + turned[np.argmin((turned**2).sum(axis=1))]
    return result


def _reached(place: Array, start: Array, view: View) -> Array | None:
    """The posture that is found from a start; None where it does not lead there."""
    angles, wanted = start, place
    for _ in range(ROUNDS):
        (angles,), _ = view.reaching(wanted[None], angles)
        missed = place - view.rest_tips(angles[None])[0] if np.isfinite(angles).all() else np.full(3, np.inf)
        if not np.linalg.norm(missed) > REACHED * view.reach:
            return angles
        if not np.isfinite(missed).all():
            return None
        wanted = wanted + (missed if view.heavy else 0.0)
    return None
