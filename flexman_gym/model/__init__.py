"""Models of arms: discretisation, equations of motion at a state, linearisation, vibration and deformation."""
