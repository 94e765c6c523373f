"""Showing: planted errors in pictures, in the choice of a model and in the command line."""

from studies.planted.change import changes

DRAW = (
    *changes(
        "draw", "draw/frames.py", "draw/test_frames.py",
        ("links are painted in the reverse order", "artist.set_zorder(10 + rank)", "artist.set_zorder(20 - rank)"),
        ("the shadow is the arm itself", "lines.reshape(-1, 3) * (1.0, 1.0, 0.0)", "lines.reshape(-1, 3)"),
        ("the thin line is at the joint angles", "np.asarray(state, dtype=float)[self.model.motor_columns]",
         "np.asarray(state, dtype=float)[: self.model.n_joints]"),
        ("the line below the target leads to the base", "place * [[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]]",
         "place * [[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]"),
        ("what is nearer looks smaller", "(distance / (distance - seen[:, 2:]))",
         "(distance / (distance + seen[:, 2:]))"),
        ("circles are nearer than the note says", "circles every {spacing:g} m", "circles every {2.0 * spacing:g} m"),
        ("the axes have each other's name", '"x"), (np.array([0.0, 1.0, 0.0]), "y")',
         '"y"), (np.array([0.0, 1.0, 0.0]), "x")'),
        ("foreshortening grows evenly along a link", "tip * drawn / drawn[-1] if",
         "tip * np.linspace(0.0, 1.0, len(drawn)) if"),
    ),
    *changes(
        "draw", "draw/figures.py", "draw/test_figures.py",
        ("the rigid arm less the flexible one", "_column(case, column)[:rows] - _column(rigid, column)[:rows]",
         "_column(rigid, column)[:rows] - _column(case, column)[:rows]"),
        ("a case ends when the rigid one does", "after {case.time[-1]:g} s", "after {rigid.time[-1]:g} s"),
    ),
    *changes(
        "draw", "draw/trajectories.py", "draw/test_trajectories.py",
        ("joint less motor", "motors[:, i] - joint,", "joint - motors[:, i],"),
        ("a residual in J is called a part", 'return trajectory.energy_residual, "J"',
         'return trajectory.energy_residual, "part of the turnover"'),
        ("an early end is told as its beginning", "after {time[-1]:g} s", "after {time[0]:g} s"),
        ("joints are counted from zero", 'f"joint {i + 1}"', 'f"joint {i}"'),
    ),
    *changes(
        "draw", "agents/pictures.py", "agents/test_pictures.py",
        ("torques are drawn a period late", 'where="pre"', 'where="post"'),
        ("a line at 20 mm whatever the band", "axes[0].axhline(band,", "axes[0].axhline(0.02,"),
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
        "command", "commands/check.py", "test_command.py",
        ("kernels are always compiled", "'compiled' if there else 'not compiled yet'", "'compiled'"),
    ),
)  # fmt: skip
