"""Evaluate a model of scripts/train.py on 100 test episodes of FlexRRR-v0: python scripts/evaluate.py [ppo | sac]

No training uses the seeds of the test episodes. A slew is settled if the tip stays within 20 mm of its target until the
end of its ten seconds.
"""

import sys

from stable_baselines3 import PPO, SAC
from train import environment

import flexman_gym as fm

TEST_SEEDS = range(9000, 9100)

if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "ppo"
    episodes = TEST_SEEDS[: int(sys.argv[2])] if len(sys.argv) > 2 else TEST_SEEDS
    algorithm = SAC if name == "sac" else PPO
    model = algorithm.load(f"runs/{name}", env=environment(1), device="cpu")
    for agent in (model, "pd", "lqr-tracking"):
        result = fm.evaluate(agent, "FlexRRR-v0", episodes)
        print(f"{agent if isinstance(agent, str) else name:<14}settled {result['settled']:>4.0%}, "
              f"in {result['settling_time']:.2f} s (median), vibration {1e3 * result['vibration']:.2f} mm")  # fmt: skip
