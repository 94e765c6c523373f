"""Tests of the core without features: option --core of tests/conftest.py."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from oracles.files import SCRIPTS

MARKED = "import pytest\n\n\n@pytest.mark.feature\ndef test_it():\n    import flexman_gym.toolbox\n"
SWALLOWED = "def test_it():\n    try:\n        import torch\n    except Exception:\n        pass\n"


@pytest.mark.slow
@pytest.mark.parametrize(("folder", "text", "options", "line"), [
    ("model", "import flexman_gym.model.model\n\n\ndef test_it():\n    pass\n", ["--core"], "1 passed"),
    ("model", "import flexman_gym.toolbox.view\n", ["--core"], "flexman_gym.toolbox is a feature, which a test of the"),
    ("model", "def test_it():\n    import flexman_agents.sb3\n", ["--core"], "flexman_agents is a feature"),
    ("model", "def test_it():\n    from flexman_gym.control import LQR\n", ["--core"], "toolbox is a feature"),
    ("model", SWALLOWED, ["--core"], "torch is a feature"),
    ("model", MARKED, ["--core"], "1 deselected"),
    ("model", MARKED, [], "1 passed"),
    ("toolbox", "import flexman_gym.toolbox.view\n\n\ndef test_it():\n    pass\n", ["--core"], "no tests ran"),
    ("toolbox", "import flexman_gym.toolbox.view\n\n\ndef test_it():\n    pass\n", [], "1 passed"),
])  # fmt: skip
def test_import_of_a_feature_fails_in_a_run_of_the_core_only(folder, text, options, line, tmp_path):
    (tmp_path / folder).mkdir()
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / folder / "test_it.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options]
    environment = os.environ | {
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": "", "PYTHONPATH": f"{SCRIPTS}:{SCRIPTS.parent}"
    }  # fmt: skip
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert line in done.stdout, done.stdout + done.stderr
