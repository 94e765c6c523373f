"""Train a shipped policy again, export it, and write its certificate: python scripts/policy.py ppo-flexrrr"""

import argparse
import shutil
from pathlib import Path

from flexman_agents.settings import find_recipe
from flexman_agents.training import train_or_resume
from flexman_gym.evaluation.policy_files import ARRAYS, FOLDER, METADATA, POLICIES, read_policy
from flexman_gym.toolbox.interchange.policy_export import export_policy
from flexman_gym.toolbox.league.certificate import certify


def main() -> None:
    """Train with the recipe and the seed of the policy; replace its files and its certificate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policy", choices=POLICIES)
    parser.add_argument("--folder", type=Path, default="out/policies", help="folder of run, export and episodes")
    options = parser.parse_args()
    about, run, export = (
        read_policy(FOLDER / options.policy).metadata,
        options.folder / "run",
        options.folder / "policy",
    )
    recipe = about["recipe"]
    settings = find_recipe(recipe["name"]).with_seed(recipe["settings"]["seed"])
    train_or_resume((settings, str(run), {}))
    shutil.rmtree(export, ignore_errors=True)
    export_policy(run, export, about["words"], recipe["name"], licence=about["licence"])
    for name in (ARRAYS, METADATA):
        shutil.copy(export / name, FOLDER / options.policy / name)
    certify(options.policy, folder=options.folder / "episodes")


if __name__ == "__main__":
    main()
