"""PPO of Stable-Baselines3, with its default hyperparameters."""

import gymnasium as gym
from report import ENVIRONMENT, SETTINGS, report
from stable_baselines3 import PPO

model = PPO("MlpPolicy", gym.make(ENVIRONMENT, **SETTINGS), seed=0, device="cpu")
report("Stable-Baselines3 PPO", lambda seen: model.predict(seen, deterministic=True)[0], lambda: model.learn(20_000))
