"""Helpers of all folders: arrays, checks, files, snapshots, run folders, grids of computations."""
