"""TQC and CrossQ of sb3-contrib, with their default hyperparameters."""

import gymnasium as gym
from report import ENVIRONMENT, SETTINGS, report
from sb3_contrib import TQC, CrossQ

for algorithm in (TQC, CrossQ):
    model = algorithm("MlpPolicy", gym.make(ENVIRONMENT, **SETTINGS), seed=0, device="cpu")
    report(
        f"sb3-contrib {algorithm.__name__}",
        lambda seen, model=model: model.predict(seen, deterministic=True)[0],
        lambda model=model: model.learn(2_000),
    )
