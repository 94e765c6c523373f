"""Train shipped policies again, export them, and write their certificates: python scripts/policy.py ppo-flexrrr

With --certify, certificates alone: python scripts/policy.py --certify
"""

import argparse
import shutil
from pathlib import Path

from flexman_agents.settings import find_recipe
from flexman_agents.training import train_or_resume
from flexman_gym.evaluation.policy_files import ARRAYS, FOLDER, METADATA, POLICIES, read_policy
from flexman_gym.toolbox.interchange.policy_export import export_policy
from flexman_gym.toolbox.league.certificate import certify


def main() -> None:
    """Replace the certificate of each policy, after a training with its recipe and seed unless --certify is given."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ", ".join(POLICIES)
    parser.add_argument("policy", nargs="*", help=f"names, from {names}; with --certify also none, for all")
    parser.add_argument("--certify", action="store_true", help="write the certificate only, without training")
    parser.add_argument("--folder", type=Path, default="out/policies", help="folder of run, export and episodes")
    options = parser.parse_args()
    for name in options.policy:
        if name not in POLICIES:
            parser.error(f"policy: {name} is not allowed; give one of {names}")
    if not options.policy and not options.certify:
        parser.error(f"policy: none is not allowed; give one of {names}, or --certify for all")
    for name in options.policy or POLICIES:
        if not options.certify:
            _train(name, options.folder / name)
        certify(name, folder=options.folder / "episodes")


def _train(name: str, folder: Path) -> None:
    """Replace the files of a policy by those of a run in a folder."""
    about, run, export = read_policy(FOLDER / name).metadata, folder / "run", folder / "policy"
    recipe = about["recipe"]
    settings = find_recipe(recipe["name"]).with_seed(recipe["settings"]["seed"])
    train_or_resume((settings, str(run), {}))
    shutil.rmtree(export, ignore_errors=True)
    export_policy(run, export, about["words"], recipe["name"], licence=about["licence"])
    for file in (ARRAYS, METADATA):
        shutil.copy(export / file, FOLDER / name / file)


if __name__ == "__main__":
    main()
