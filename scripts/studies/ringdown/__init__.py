"""Ring-down: what is left of a released vibration, and where the tip goes, by each method and step."""
