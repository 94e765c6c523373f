"""Vertical arm of two links with friction of its motors."""

from dataclasses import replace

import flexman_gym as fm


def two_links(coulomb=0.6, viscous=0.3, rate=0.03, rigid=False):
    """Return the model of the arm: Coulomb friction, N m; viscous friction, N m s/rad; width of the law, rad/s."""
    whole = fm.catalog.vertical_2r()
    friction = {"viscous_friction": viscous, "coulomb_friction": coulomb, "coulomb_rate": rate}
    joints = [replace(each, **friction) for each in whole.joints]
    flexible = {"flexible_links": not rigid, "flexible_joints": not rigid}
    return fm.build_model(replace(whole, joints=joints), 1, None if rigid else 1, **flexible)
