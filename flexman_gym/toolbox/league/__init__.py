"""League: benchmark table of agents, evaluated in the same episodes of several scenarios."""
