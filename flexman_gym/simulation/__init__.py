"""Simulation: time integration of one or many arms, and the table of integration methods."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.simulation.batch import Batch
    from flexman_gym.simulation.differentiation import Sensitivities
    from flexman_gym.simulation.episode import Episode
    from flexman_gym.simulation.linearization import linearize
    from flexman_gym.simulation.methods import METHODS, generalised_alpha
    from flexman_gym.simulation.scene_simulation import simulate, simulate_all
    from flexman_gym.simulation.simulator import Simulator
    from flexman_gym.simulation.trajectory import Trajectory

__all__ = [
    "METHODS", "Batch", "Episode", "Sensitivities", "Simulator", "Trajectory", "generalised_alpha", "linearize",
    "simulate", "simulate_all",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__)
