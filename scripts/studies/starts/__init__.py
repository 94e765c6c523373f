"""Time until a new process has used an environment, many arms, a simulation and an evaluation."""
