"""Showing: planted errors in pictures, in the choice of a model and in the command line."""

from flexman_gym.studies.planted.change import changes

DRAW = (
    *changes(
        "draw", "draw/frames.py", "draw/test_frames.py",
        ("links are painted in the reverse order", "artist.set_zorder(10 + rank)", "artist.set_zorder(20 - rank)"),
        ("the shadow is the arm itself", "lines.reshape(-1, 3) * (1.0, 1.0, 0.0)", "lines.reshape(-1, 3)"),
    ),
    *changes(
        "draw", "draw/figures.py", "draw/test_figures.py",
        ("the rigid arm less the flexible one", "_column(case, column)[:rows] - _column(rigid, column)[:rows]",
         "_column(rigid, column)[:rows] - _column(case, column)[:rows]"),
    ),
    *changes(
        "draw", "draw/trajectories.py", "draw/test_trajectories.py",
        ("joint less motor", "motors[:, i] - joint,", "joint - motors[:, i],"),
        ("a residual in J is called a part", 'return trajectory.energy_residual, "J"',
         'return trajectory.energy_residual, "part of the turnover"'),
    ),
)  # fmt: skip

FIDELITY = (
    *changes(
        "fidelity", "fidelity/mesh.py", "fidelity/test_mesh.py",
        ("a vibration that bends far runs ahead twice as much", "ahead = 0.17 *", "ahead = 0.34 *"),
    ),
)  # fmt: skip

COMMAND = (
    *changes(
        "command", "__main__.py", "test_command.py",
        ("kernels are always compiled", "'compiled' if there else 'not compiled yet'", "'compiled'"),
    ),
)  # fmt: skip
