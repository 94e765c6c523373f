"""Study of the import of URDF files: comparison with Pinocchio."""
