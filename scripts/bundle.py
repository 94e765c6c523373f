"""Build the replay page from `scripts/web` with three.js and uPlot into toolbox/view, or check the built files."""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
WEB, VIEW = ROOT / "scripts" / "web", ROOT / "flexman_gym" / "toolbox" / "view"
FILES = ("replay.js", "replay.css")


def main() -> int:
    """Build the bundle and write or compare it; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="write nothing; list the files that differ from a new build"
    )
    options = parser.parse_args()
    if not (WEB / "node_modules").is_dir():
        subprocess.run(["npm", "ci", "--no-audit", "--no-fund"], cwd=WEB, check=True)
    with tempfile.TemporaryDirectory() as folder:
        built = build(Path(folder))
    if not options.check:
        for name, content in built.items():
            (VIEW / name).write_bytes(content)
        return 0
    different = [name for name, content in built.items() if (VIEW / name).read_bytes() != content]
    print(f"different: {', '.join(different)}" if different else "up to date")
    return int(bool(different))


def build(folder: Path) -> dict[str, bytes]:
    """Return the files of the bundle, name -> content, including the licences of the bundled libraries."""
    command = ["node_modules/.bin/esbuild", "start.js", "--bundle", "--minify", "--legal-comments=eof",
               "--charset=utf8", "--log-level=warning", f"--outfile={folder / FILES[0]}"]  # fmt: skip
    subprocess.run(command, cwd=WEB, check=True)
    return {name: (folder / name).read_bytes() for name in FILES}


if __name__ == "__main__":
    sys.exit(main())
