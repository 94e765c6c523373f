"""Environments: a page for each named environment, made of its docstrings, with a picture of an episode."""
