"""Safety filter: torques that keep the limits of an arm."""
