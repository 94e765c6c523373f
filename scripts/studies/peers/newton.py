"""Newton's cables: frequency of the clamped link 3 after an impulse, on a GPU."""

import time
from importlib import import_module

import numpy as np

import flexman_gym as fm

SKIPPED, PIECES, STEP, ITERATIONS, DURATION = "skipped: no GPU", 20, 1e-3, 10, 2.0  # s


def cables() -> str:
    """Return the result of the cable on a GPU, or a note that it was skipped."""
    try:
        found = import_module("warp").is_cuda_available() and import_module("newton")
    except ModuleNotFoundError:
        found = False
    return clamped("cuda:0") if found else SKIPPED


def clamped(device: str) -> str:
    """Return frequency and cost of the clamped link on a device, with the frequency of beam theory, as text."""
    newton, link = import_module("newton"), fm.catalog.paper_rrr().links[2]
    section, whole = link.sections[0], link.length / PIECES
    bending, line = section.youngs_modulus * section.second_moment_y, section.density * section.area
    radius, stretch = (4 * section.second_moment_y / np.pi) ** 0.25, section.youngs_modulus * section.area / whole
    shape = newton.ModelBuilder.ShapeConfig(density=line * whole / (np.pi * radius**2 * (whole + 4 * radius / 3)))
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    rod = newton.Rod.create_straight((0, 0, 0), (1, 0, 0), link.length, segment_count=PIECES, radius=radius)
    bodies, _ = builder.add_rod(rod=rod, cfg=shape, stretch_stiffness=stretch, bend_stiffness=bending / whole)
    builder.body_mass[bodies[0]] = builder.body_inv_mass[bodies[0]] = 0.0
    builder.color()
    model, heights = builder.finalize(device=device), []
    solver, states = newton.solvers.SolverVBD(model, iterations=ITERATIONS), [model.state(), model.state()]
    speeds = states[0].body_qd.numpy()
    speeds[1:, 2] = 0.3 * np.linspace(0.0, 1.0, PIECES - 1) ** 2
    states[0].body_qd.assign(speeds)
    started = time.perf_counter()
    for _ in range(round(DURATION / STEP)):
        solver.step(*states, model.control(), None, STEP)
        states.reverse()
        heights.append(states[0].body_q.numpy()[-1, 2])
    cost, crossings = (time.perf_counter() - started) / DURATION, np.flatnonzero(np.diff(np.sign(heights)))
    measured = (len(crossings) - 1) / (2.0 * STEP * np.ptp(crossings))
    true = 1.875**2 / (2.0 * np.pi) * np.sqrt(bending / line) / link.length**2
    return f"clamped link 3: {measured:.3g} Hz ({true:.3g} Hz by beam theory), {cost:.3g} s per simulated second"
