"""Write the pages of the named environments: python scripts/environments.py --folder docs/environments"""

import argparse

from flexman_gym.envs import NAMED_ENVIRONMENTS
from studies.environments.measure import BASES, draw, run
from studies.environments.page import baselines, page
from studies.files import folder


def main() -> None:
    """Run the baselines and write page, plot and animation of each environment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=sorted(NAMED_ENVIRONMENTS), help="write a single environment")
    parser.add_argument("--folder", type=folder, default="out/environments", help="output folder of pages and plots")
    parser.add_argument("--text", action="store_true", help="write the pages and keep the existing plots")
    options = parser.parse_args()
    for name in [options.only] if options.only else NAMED_ENVIRONMENTS:
        runs = {base: run(name, base) for base in BASES}
        if not options.text:
            draw(runs, options.folder / f"{name}.png")
        (options.folder / f"{name}.md").write_text(page(name, runs), encoding="utf-8")
        print(name, *baselines(name, runs)[2:], sep="\n", flush=True)


if __name__ == "__main__":
    main()
