"""Training of policies on the environments with Stable-Baselines3: settings, runs, imitation, search."""

from importlib.util import find_spec

TRAINING_PACKAGES = ("stable_baselines3", "torch", "rich", "tqdm", "tensorboard")

if _missing := [name for name in TRAINING_PACKAGES if find_spec(name) is None]:
    raise ImportError(f"training needs {', '.join(_missing)}: pip install 'flexman_gym[train]'")
