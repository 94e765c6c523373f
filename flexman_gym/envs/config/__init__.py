"""Configuration of environments: settings, named environments, conditions, randomisation."""
