"""Guard of a training run: its result is the base controller if the trained policy settles less often."""

import json
from pathlib import Path

from flexman_agents.own_arm import ACTIONS_PER_SLEW, action_time, base_alone
from flexman_agents.settings import Settings
from flexman_gym.common.files import write_file
from flexman_gym.common.run_folder import BASE, RESULT
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, rollout

UNSUITED = 2.0  # ratio of the time of an action to that, beyond which the guard names it


def guard(folder: str | Path, keep_worse: bool = False) -> str:
    """Compare the policy of a finished run with its base controller on the selection episodes.

    If the policy settles less often, the result of the run is the base: the folder gets result.json, and
    `flexman evaluate` and `find_agent` take the base. Otherwise the file is removed.

    Args:
        folder: folder of the run.
        keep_worse: True to keep the policy even then.

    Returns:
        Report in one or two lines; "" for a run without base controller, or over random arms.
    """
    folder = Path(folder)
    settings, result = Settings.load(folder), folder / RESULT
    environment, base = settings.environment, settings.base_in_use or settings.environment.base
    result.unlink(missing_ok=True)
    if base is None or settings.arms is not None:
        return ""
    bare, agent = base_alone(environment, base)
    own, of_base = _settled(find_agent(folder), bare), _settled(agent, bare)
    name = (
        base if isinstance(base, str) else base.get("kind", "base") if isinstance(base, dict) else type(base).__name__
    )
    report = f"the policy settles {own:.0%} of {len(SELECTION_SEEDS)} selection episodes, its base {name} {of_base:.0%}"
    if own >= of_base:
        return report
    if reason := _reason(environment):
        report = f"{report}\n{reason}"
    if keep_worse:
        return f"{report}\nThe policy is kept (--keep-worse)"
    data = {"result": BASE, "policy_settled": own, "base_settled": of_base, "reason": reason}
    write_file(result, json.dumps(data, indent=2) + "\n")
    keeps = f"flexman train --resume --keep-worse --folder {folder} keeps the policy"
    return f"{report}\nThe result of the run is the base {name}; {keeps}"


def _settled(agent: AgentSpec, environment: Configuration) -> float:
    """Return the share of the selection episodes that an agent settles."""
    return METRICS["settled"].evaluate(rollout(agent, environment, SELECTION_SEEDS).records)


def _reason(environment: Configuration) -> str:
    """Return a possible reason of a bad policy: actions that are too short or too long for the slews of the arm."""
    wanted, time = action_time(environment), environment.action_repeat * environment.control_period
    if 1.0 / UNSUITED <= time / wanted <= UNSUITED:
        return ""
    repeat = max(1, round(wanted / environment.control_period))
    slew = ACTIONS_PER_SLEW * wanted
    return (
        f"An action lasts {1e3 * time:.3g} ms, and a slew of {slew:.3g} s has {slew / time:.3g} of them; "
        f"action_repeat={repeat} gives {ACTIONS_PER_SLEW}"
    )
