"""Other simulators: models of an arm in MuJoCo, Exudyn and Pinocchio."""
