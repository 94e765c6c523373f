"""Trains a policy: python scripts/train.py --algo ppo --steps 1000000 --folder runs/first"""

import argparse
import sys
from pathlib import Path

from flexman_agents.training import ALGORITHMS, Settings, resume, train


def main() -> int:
    """Reads the command line and trains; returns the exit code."""
    parser = argparse.ArgumentParser(description="Train PPO or SAC on a flexible arm; the run is kept in a folder.")
    parser.add_argument("--algo", choices=sorted(ALGORITHMS), default="ppo")
    parser.add_argument("--env", default="FlexRRR-v0")
    parser.add_argument("--steps", type=int, default=1_000_000, help="environment steps; more steps with --resume")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--envs", type=int, help="arms side by side; 64 for PPO, 16 for SAC")
    parser.add_argument("--residual", action="store_true", help="the policy adds to a PD controller")
    parser.add_argument("--folder", type=Path, default=Path("runs/latest"))
    parser.add_argument("--resume", action="store_true", help="go on with the run in the folder, with its settings")
    parser.add_argument("--checkpoint-every", type=int, default=100_000, help="environment steps; 0: only at the end")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    options = parser.parse_args()
    try:
        if options.resume:
            resume(options.folder, options.steps, options.checkpoint_every, not options.quiet)
        else:
            settings = Settings(
                options.algo, options.env, options.steps, options.seed, options.envs, residual=options.residual
            )
            train(settings, options.folder, options.checkpoint_every, not options.quiet)
    except (ValueError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"The run is in {options.folder}; see it with: python scripts/evaluate.py {options.folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
