"""Common: arrays, checks of arguments, files, snapshots, run folders and parallel computation."""
