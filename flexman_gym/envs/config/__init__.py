"""Configuration of environments: settings, conditions, named environments, randomisation."""
