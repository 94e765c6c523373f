"""Reference trajectories: slews, paths, time-optimal motions, optimised slews."""
