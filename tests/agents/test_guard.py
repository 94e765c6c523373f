"""Guard: the result of a run is the base controller if the policy settles less often."""

import pytest

from flexman_agents import guard as module
from flexman_agents.guard import guard
from flexman_agents.settings import Settings
from flexman_agents.training import resume, train
from flexman_gym.__main__ import main
from flexman_gym.common.run_folder import RESULT
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.toolbox.interchange.policy_export import export_policy

from oracles.assertions import refusal

pytest.importorskip("stable_baselines3")

BASED = {"id": "FlexOne-v0", "base": "pd", "action_repeat": 5, "sensors": ["full", "fine"], "horizon": 4.0}
SHORT = Settings(
    environment=BASED, steps=64, envs=2, hyperparameters={"net_arch": [8], "n_steps": 32, "batch_size": 64}
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a run that has learned nothing."""
    result = tmp_path_factory.mktemp("runs") / "ppo"
    train(SHORT, result, progress=False)
    return result


@pytest.fixture
def shares(monkeypatch):
    """Return a function that sets the shares of settled episodes of policy and base."""

    def set_shares(policy, base):
        monkeypatch.setattr(module, "_settled", lambda agent, _: base if agent.name == "base" else policy)

    return set_shares


@pytest.mark.slow
@pytest.mark.parametrize(("policy", "base", "taken"), [(0.2, 0.9, "base"), (0.9, 0.9, "policy"), (1.0, 0.9, "policy")])
def test_the_agent_of_a_run_is_the_better_one(folder, shares, policy, base, taken):
    shares(policy, base)
    report = guard(folder)
    found = find_agent(str(folder))
    assert f"{policy:.0%}" in report and f"{base:.0%}" in report
    assert (found.law is None) == (taken == "base") == (folder / RESULT).is_file()
    assert ("its base" in found.name) == (taken == "base")


@pytest.mark.slow
def test_a_worse_policy_is_kept_on_request_and_a_resumed_run_is_compared_anew(folder, shares):
    shares(0.1, 0.9)
    assert "kept" in guard(folder, keep_worse=True) and find_agent(str(folder)).law is not None
    guard(folder)
    assert find_agent(str(folder)).law is None
    resume(folder, steps=64, progress=False)
    assert find_agent(str(folder)).law is not None


@pytest.mark.slow
def test_a_base_as_result_stays_until_the_policy_is_kept_and_is_not_exported(folder, shares, tmp_path, capsys):
    shares(0.1, 0.9)
    guard(folder)
    assert "steps: None" in refusal(lambda: resume(folder, progress=False)) and (folder / RESULT).is_file()
    line = refusal(lambda: export_policy(folder, tmp_path / "policy", "Untrained.", "none"))
    assert line.startswith("run: ") and "--keep-worse" in line and not (tmp_path / "policy").exists()
    assert main(["train", "--resume", "--keep-worse", "--folder", str(folder)]) == 0
    assert "The policy is kept" in capsys.readouterr().out and not (folder / RESULT).exists()


@pytest.mark.slow
def test_an_untrained_policy_with_loud_actions_settles_less_than_its_base(folder):
    """Measured, not given: the episodes of the selection."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SELECTION_SEEDS", range(5000, 5004))
        report = guard(folder)
    assert "its base pd 100%" in report


@pytest.mark.slow
def test_a_damaged_result_is_told_in_one_line(folder):
    (folder / RESULT).write_text("{}")
    assert RESULT in refusal(lambda: find_agent(str(folder)))
    (folder / RESULT).unlink()
