"""Safety filter: violations, settling time and CPU time of agents with and without it."""
