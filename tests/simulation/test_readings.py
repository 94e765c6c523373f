"""Readings: trajectories name what sensors measure, with the same numbers."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.readings import UNITS
from flexman_gym.simulation.readings import Readings


@pytest.fixture(scope="module")
def trajectory():
    """A quarter of a second of the paper's arm."""
    scene = fm.catalog.paper_scene("ff")
    return fm.simulate(fm.Scene(scene.arm, scene.model, scene.torque, scene.initial, 0.25, 0.05), step=0.005)


def test_readings_are_what_the_state_says(trajectory):
    result, states, model = trajectory.readings, trajectory.states, trajectory.model
    n, d = model.n_joints, model.n_dof
    assert result.keys() == UNITS.keys()
    assert result["motor_angles"] == pytest.approx(trajectory.motor_angles, abs=0)
    assert result["motor_rates"] == pytest.approx(states[:, d + model.motor_columns], abs=0)
    assert result["joint_twists"] == pytest.approx(trajectory.motor_angles - states[:, :n], abs=1e-15)
    assert result["joint_twist_rates"] == pytest.approx(result["motor_rates"] - states[:, d : d + n], abs=1e-15)
    speeds = np.hstack([states[:, d:], np.zeros_like(states[:, d:])])  # a reading of a linear quantity's rate
    assert Readings(model).named(speeds)["link_deflections"] == pytest.approx(result["link_deflection_rates"], abs=0)
    for row, state in enumerate(states):
        for link in range(n):
            radius = np.sqrt(model.arm.links[link].second_moment_y / model.arm.links[link].area)
            about_y = fm.curvature(model, state, link, 0.0)[1]
            assert result["root_strains"][row, 3 * link + 1] == pytest.approx(radius * about_y, abs=1e-15)
    assert np.abs(result["root_strains"][-1]).max() > 1e-4


def test_columns_name_all_readings_with_units(trajectory):
    columns = trajectory.columns()
    for link in (1, 2, 3):
        for part, place in (("_y", 0), ("_z", 1)):
            column = columns[f"link_deflection_{link}{part} (m)"]
            assert np.array_equal(column, trajectory.readings["link_deflections"][:, 2 * (link - 1) + place])
        assert np.array_equal(columns[f"motor_rate_{link} (rad/s)"], trajectory.readings["motor_rates"][:, link - 1])
        for part, place in (("_y", 0), ("_z", 1), ("_torsion", 2)):
            column = columns[f"root_strain_{link}{part} (1)"]
            assert np.array_equal(column, trajectory.readings["root_strains"][:, 3 * (link - 1) + place])
    assert len({len(column) for column in columns.values()}) == 1
