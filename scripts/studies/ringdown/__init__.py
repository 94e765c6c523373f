"""Ring-down study: remaining energy and tip position after a released vibration, for each method and step."""
