"""Command arm: description of files and URDFs, trial, and the saved environment."""

import gymnasium as gym
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.common import files
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.scene.serialization import find_arm
from flexman_gym.toolbox.league import arm_trial

from oracles.files import ROOT

URDF = str(ROOT / "docs" / "examples" / "two_links.urdf")
FOUR_LINKS = str(ROOT / "docs" / "examples" / "four_link_arm.yaml")


def test_a_description_has_frequencies_holding_torques_and_settings(capsys):
    assert main(["arm", URDF, "--set", "torque_limit=200.0"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [line[:28].strip() for line in lines]
    assert {"arm", "frequencies, motors held", "joint 2 holds", "slews", "control_period", "horizon", "PD"} <= {*names}
    assert lines[names.index("frequencies, motors held")].endswith("none: rigid")


def test_a_urdf_is_an_arm_by_its_path_and_by_a_mapping():
    arm = fm.Arm.from_urdf(URDF, held="rest")
    assert find_arm(URDF) == arm == find_arm({"urdf": URDF})
    sidecar = {"joints": {"shoulder": {"rotor_inertia": 0.05, "stiffness": 2000.0}}}
    stiff = find_arm({"urdf": URDF, "sidecar": sidecar})
    assert stiff.joints[0].stiffness == 2000.0 and arm.joints[0].stiffness is None
    own = Configuration("FlexPlanar-v0", {"arm": URDF, "torque_limit": 200.0})
    assert own.arm == arm and Configuration.from_plain(own.to_plain()) == own


def test_the_file_of_an_environment_is_described_with_its_settings(tmp_path, capsys):
    path = str(tmp_path / "own.yaml")
    Configuration("FlexOne-v0", {"arm": FOUR_LINKS, "control_period": 0.004, "sensors": "lab"}).save(path)
    assert main(["arm", path]) == 0
    assert "control_period               0.004 s" in capsys.readouterr().out.splitlines()
    assert fm.describe(path, horizon=3.0).configuration == Configuration.load(path).replace(horizon=3.0)
    assert main(["arm", path, "--env", "FlexRRR-v0"]) == 2
    assert f"none: {path} is the file of an environment" in capsys.readouterr().err


def test_changes_concern_the_described_arm(capsys):
    """Torque limits of four joints, in an environment whose own arm has three."""
    assert main(["arm", FOUR_LINKS, "--set", "torque_limit=[41.0, 61.0, 31.0, 11.0]"]) == 0
    assert "of its torque limit, 11 N m" in capsys.readouterr().out
    assert main(["arm", "none.urdf", "--set", f"arm={{urdf: {URDF}}}", "--set", "torque_limit=[201.0, 101.0]"]) == 0
    assert "of its torque limit, 201 N m" in capsys.readouterr().out


def test_a_stored_environment_without_gains_has_the_designed_ones(tmp_path):
    own = Configuration("FlexRRR-v0", {"arm": FOUR_LINKS})
    own.save(tmp_path / "own.yaml")
    assert Configuration.of_file(tmp_path / "own.yaml").pd_gains == own.pd_gains


def test_a_file_with_a_urdf_and_its_arguments_is_an_arm(tmp_path):
    (tmp_path / "two_links.urdf").write_text((ROOT / "docs" / "examples" / "two_links.urdf").read_text())
    files.write_data(tmp_path / "arm.yaml", {"urdf": "two_links.urdf"})
    files.write_data(tmp_path / "scene.yaml", {"arm": {"urdf": "two_links.urdf"}})
    for name in ("arm.yaml", "scene.yaml"):
        assert find_arm(name, tmp_path) == fm.Arm.from_urdf(URDF, held="rest")


@pytest.mark.slow
def test_a_trial_prints_a_row_for_each_controller_and_saves_the_recommended_one(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(arm_trial, "EPISODES", 2)
    monkeypatch.setattr(arm_trial, "TRIAL_AGENTS", {"pd-torque": arm_trial.KNOWN, "pd": arm_trial.KNOWN})
    saved = tmp_path / "own.yaml"
    assert main(["arm", FOUR_LINKS, "--try", "--save", str(saved)]) == 0
    printed = capsys.readouterr().out
    (chosen,) = (line.split()[1].rstrip(":") for line in printed.splitlines() if line.startswith("recommended"))
    assert chosen in ("pd", "pd-torque") and printed.count(" of 2") >= 1
    configuration = Configuration.load(saved)
    assert configuration.base == chosen and configuration.gains
    gym.make(configuration.id, **configuration.keywords()).reset(seed=0)
