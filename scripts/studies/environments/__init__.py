"""Pages of the named environments, generated from their docstrings, with plots of episodes."""
