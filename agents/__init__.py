"""Agents: training and evaluation of policies on the environments, with Stable-Baselines3."""
