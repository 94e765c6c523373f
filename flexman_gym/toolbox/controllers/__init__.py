"""Controllers, observers, reference trajectories and input shaping."""
