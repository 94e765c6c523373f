"""Verification cases without motion: beams, stepped links, elastic joints, the paper's arm and other published arms."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import inverse, layout
from flexman_gym.model.beam import build_beam
from flexman_gym.model.dynamics import acceleration, frequencies, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.simulation.scenes import simulate
from flexman_gym.simulation.simulator import Simulator
from flexman_gym.verification.closed_forms import (
    bar_eigenvalues,
    beam_eigenvalues,
    hub_eigenvalues,
    joint_eigenvalues,
    rayleigh_eigenvalues,
    stepped_eigenvalues,
)
from flexman_gym.verification.table import VerificationRow, printed_row, series_rows

UNIT_LOAD = "integrals of M m / EI (Gere and Timoshenko, Mechanics of Materials)"
STEPPED = "closed form: two Euler-Bernoulli segments"


def stepped_link(place: float, thickness_ratio: float) -> NonUniformLink:
    """A strip of 1 m that bends in x-y with EI 1 N m^2 and has 1 kg/m up to a place, and is thinner from there on.

    EI goes with the cube of its thickness, the mass with the thickness; across it is 100 times as high as thick.
    """
    sections = []
    for length, thickness in ((place, 1e-5), (1.0 - place, 1e-5 * thickness_ratio)):
        height, modulus, density = 1e-3, 12e18, 1e8
        area, about_y, about_z = height * thickness, thickness * height**3 / 12.0, height * thickness**3 / 12.0
        sections.append(Link(length, area, about_y, about_z, about_y, modulus, modulus, density))
    return NonUniformLink(sections)


def _stepped_rows() -> Iterator[VerificationRow]:
    """Tip under a unit load, and lambda = omega sqrt(rho A L^4 / EI) of the inboard segment, 16 elements a segment."""
    for place, ratio in ((0.5, 0.5), (0.3, 0.7)):
        link, rigidity, outboard = stepped_link(place, ratio), ratio**3, 1.0 - place
        beam = build_beam(link, 1)
        bent = np.linalg.solve(beam.stiffness, beam.tip_translation[1])
        name = f"cantilever stepped at {place:g} L to {ratio:g} of its thickness"
        deflection = (1.0 - outboard**3 + outboard**3 / rigidity) / 3.0
        slope = (1.0 - outboard**2 + outboard**2 / rigidity) / 2.0
        yield VerificationRow(
            f"{name}, tip under load, m/N", UNIT_LOAD, deflection, beam.tip_translation[1] @ bent, 1e-9
        )
        yield VerificationRow(f"{name}, slope of the tip, rad/N", UNIT_LOAD, slope, beam.tip_rotation[2] @ bent, 1e-9)
        model = build_model(Arm([link], [Joint((0.0, 0.0, 1.0))]), 16, rotary_inertia=False)
        result = 2.0 * np.pi * frequencies(model, lock_joints=True)[:3]
        expected = stepped_eigenvalues(3, place, rigidity, ratio)
        yield from series_rows(f"{name}, lambda_{{}}", STEPPED, expected, result, 2e-5)


DE_LUCA = "De Luca and Siciliano, IEEE Trans. SMC 21 (1991)"
NASA, ROME = "NASA JSC, ASME DETC2007-35511", "De Luca et al., IEEE CDC (1990), measured"
GIFU = "Gifu University, ROBOMECH J. 5:28 (2018), usual moduli"


def published_rows() -> Iterator[VerificationRow]:
    """Arms of the catalog that others have published, Hz.

    De Luca and Siciliano take each link as clamped, with what it carries at its tip, and leave out the mass moment of
    link 2 about the tip of link 1.
    """
    arm = catalog.de_luca_siciliano()
    second, tool = arm.links[1].sections[0], arm.payload
    assert tool is not None
    behind = 0.1 + second.mass * second.length**2 / 3.0 + tool.mass * second.length**2 + 0.0005
    loads = {1: (1.0 + second.mass + tool.mass, behind, ("0.48", "1.80")), 2: (tool.mass, 0.0005, ("2.18", "15.91"))}
    for number, (mass, inertia, texts) in loads.items():
        result = _clamped(second, Payload(mass, (inertia * np.eye(3)).tolist()))
        for i, text in enumerate(texts):
            yield printed_row(f"two links, link {number} clamped, f_{i + 1}, Hz", DE_LUCA, text, result[i])
    result = 2.0 * np.pi * frequencies(build_model(catalog.nasa_beam(), 12))
    for i, (column, known) in enumerate(zip((1, 2, 4, 5), (5.28, 20.9, 46.7, 83.4), strict=True)):
        yield VerificationRow(
            f"pinned beam with tip mass, w_{i + 1} in its plane, rad/s", NASA, known, result[column], 5e-3
        )
    result = frequencies(build_model(catalog.flexarm_rome(), 4, flexible_links=(False, True)))
    yield VerificationRow("FLEXARM, motors free, f_1, Hz, to which EI is fitted", ROME, 4.716, result[2], 1e-3)
    yield VerificationRow("FLEXARM, motors free, f_2, Hz", ROME, 14.395, result[3], None)
    for link, text in zip(catalog.gifu_2link().links[1:], ("35.6", "29.4"), strict=True):
        bare = replace(link.sections[0], masses=())
        case = f"rod of {bare.youngs_modulus / 1e9:g} GPa, clamped and bare, f_1, Hz"
        yield printed_row(case, GIFU, text, _clamped(bare)[0])


def _clamped(link: Link, payload: Payload | None = None) -> Array:
    """Frequencies (Hz) of a link that is clamped."""
    return frequencies(build_model(Arm([link], [Joint((0.0, 0.0, 1.0))], payload), 8), lock_joints=True)


AXIAL, TWIST, BENDING_Y, BENDING_Z = (0,), (3,), (1, 5), (2, 4)  # coordinates of a node that move together
BEAM = "closed form: Euler-Bernoulli beam"
HERMITE = "known of cubic elements with consistent mass"
MECHANICS = "Gere and Timoshenko, Mechanics of Materials"
WRIGHT = "Wright et al., J. Applied Mechanics 49 (1982)"
SPONG = "closed form: Spong, J. Dynamic Systems 109 (1987)"
THREE_CODES = "three independent codes"
TABLE_1 = "closed form with the paper's Table 1"
IDENTITY = "identity"
FLAP = {1.0: 3.6816, 2.0: 4.1373, 4.0: 5.5850, 6.0: 7.3604}  # eta: lambda_1, hub radius 0


def _slender_link(
    length: float = 1.0, mass_per_length: float = 1.0, rigidity: float = 1.0, across: float = 1e4
) -> Link:
    """A link that bends in x-y with EI = rigidity, and across that plane with so many times more.

    Its radius of gyration is 1e-4 of its length, so that rotary inertia takes less than 1e-5 of a frequency.
    """
    area = 1e-8 * length**2
    moment = area**2
    modulus = rigidity / moment
    return Link(length, area, across * moment, moment, across * moment, modulus, modulus, mass_per_length / area)


def _link_frequencies(link: Link, elements: int, columns: Sequence[int], tip_mass: float = 0.0) -> Array:
    """Frequencies in Hz of a clamped link in some of its node coordinates."""
    model = build_model(Arm([link], [Joint((0.0, 0.0, 1.0))], Payload(tip_mass)), elements)
    kept = _columns(elements, columns)
    mass, stiffness = mass_matrix(model, np.zeros(2 * model.n_dof)), stiffness_matrix(model)
    flexibility = np.linalg.solve(stiffness[np.ix_(kept, kept)], mass[np.ix_(kept, kept)])
    return np.sort(1.0 / np.sqrt(np.linalg.eigvals(flexibility).real)) / (2.0 * np.pi)


def _cantilever_rows() -> Iterator[VerificationRow]:
    """lambda = omega sqrt(rho A L^4 / EI) without and with a mass at the tip, 24 elements."""
    link = _slender_link()
    for ratio in (0.0, 0.1, 0.5, 1.0, 5.0):
        result = 2.0 * np.pi * _link_frequencies(link, 24, BENDING_Y, ratio)[:3]
        name = f"cantilever, tip mass / beam mass {ratio:g}" if ratio else "cantilever"
        yield from series_rows(name + ", lambda_{}", BEAM, beam_eigenvalues(3, ratio), result, 2e-5)


def _hub_rows() -> Iterator[VerificationRow]:
    """Elastic lambda of a beam that turns freely with a hub, 32 elements."""
    for ratio in (0.0, 0.1, 1.0):
        model = build_model(Arm([_slender_link()], [Joint((0.0, 0.0, 1.0), ratio)]), 32)
        result = 2.0 * np.pi * frequencies(model)[1:4]
        name = f"free hub, J / (rho A L^3) {ratio:g}, lambda_{{}}"
        yield from series_rows(name, BEAM, hub_eigenvalues(3, ratio), result, 2e-5)


def _convergence_rows() -> Iterator[VerificationRow]:
    """Error of f_1 with Hermite elements and consistent mass, and the slope at which it falls."""
    exact, counts = beam_eigenvalues(1)[0], (1, 2, 4, 8)
    errors = [2.0 * np.pi * _link_frequencies(_slender_link(), n, BENDING_Y)[0] / exact - 1.0 for n in counts]
    for count, text, error in zip(counts, ("0.475", "0.0483", "0.0033", "0.0002"), errors, strict=True):
        yield printed_row(f"cantilever f_1, elements: {count}, error in percent", HERMITE, text, 100.0 * error)
    slope = np.log2(errors[-2] / errors[-1])
    yield VerificationRow("cantilever f_1, order of convergence, 4 to 8 elements", HERMITE, 4.0, slope, 0.02)


def _static_rows() -> Iterator[VerificationRow]:
    """Tip of link 2 of the paper's arm as a cantilever of two elements under unit loads and its own weight."""
    link = _paper_links()[1]
    beam, length, mass = build_beam(link, 2), link.length, link.mass
    bending, twisting = link.youngs_modulus * link.second_moment_z, link.shear_modulus * link.torsion_constant
    weight = sum(m * shape[1] for m, shape in zip(beam.masses, beam.shapes, strict=True)) / mass  # 1 N along the link
    deflection, rotation = beam.tip_translation[1], beam.tip_rotation
    cases = (
        ("P L^3 / 3 EI, m/N", deflection, deflection, length**3 / (3.0 * bending)),
        ("P L^2 / 2 EI, rad/N", rotation[2], deflection, length**2 / (2.0 * bending)),
        ("M L^2 / 2 EI, 1/N", deflection, rotation[2], length**2 / (2.0 * bending)),
        ("w L^4 / 8 EI with w L = 1 N, m/N", deflection, weight, length**3 / (8.0 * bending)),
        ("T L / G J, rad/(N m)", rotation[0], rotation[0], length / twisting),
    )
    for name, answer, load, expected in cases:
        yield VerificationRow(
            f"tip under load, {name}", MECHANICS, expected, answer @ np.linalg.solve(beam.stiffness, load), 1e-9
        )


def _bar_rows() -> Iterator[VerificationRow]:
    """Axial and torsional cantilever frequencies in Hz of link 3 of the paper's arm, 24 linear elements."""
    link = _paper_links()[2]
    for name, columns in (("axial", AXIAL), ("torsional", TWIST)):
        scale = _bar_scale(link, columns)
        result = _link_frequencies(link, 24, columns)
        yield from series_rows(
            f"{name} f_{{}}, link 3, Hz", "closed form: bar", scale * bar_eigenvalues(2), result[:2], 2e-3
        )


def _elastic_joint_rows() -> Iterator[VerificationRow]:
    """A flexible link on a spring and a rotor, Hz: L 0.7 m, 4 kg/m, EI 0.6 N m^2, K 100 N m/rad, J 1 kg m^2."""
    length, density, rigidity, stiffness, rotor = 0.7, 4.0, 0.6, 100.0, 1.0
    scale = np.sqrt(rigidity / density) / (2.0 * np.pi * length**2)
    link, joint = _slender_link(length, density, rigidity), Joint((0.0, 0.0, 1.0), rotor, stiffness)
    for tip in (0.0, 2.0):
        model = build_model(Arm([link], [joint], Payload(tip)), 32)
        for name, ratio in (("free", rotor / (density * length**3)), ("clamped", None)):
            clamped = ratio is None
            result = frequencies(model, lock_joints=clamped)[0 if clamped else 1 :][:3]
            lambdas = joint_eigenvalues(3, stiffness * length / rigidity, ratio, tip / (density * length))
            case = f"flexible link on elastic joint, rotor {name}, tip {tip:g} kg, f_{{}}, Hz"
            yield from series_rows(case, "closed form: beam, spring, rotor", scale * lambdas, result, 2e-5)


def _spring_rows() -> Iterator[VerificationRow]:
    """Two masses and a spring, Hz, and the limit of stiff springs."""
    stiffness, rotor, link = 100.0, 1.0, _slender_link(0.7, 4.0)
    inertia = link.mass * link.length**2 / 3.0
    model = build_model(Arm([link], [Joint((0.0, 0.0, 1.0), rotor, stiffness)]), flexible_links=False)
    free = np.sqrt(stiffness * (1.0 / rotor + 1.0 / inertia)) / (2.0 * np.pi)
    locked = np.sqrt(stiffness / inertia) / (2.0 * np.pi)
    yield VerificationRow("two masses and a spring, free, Hz", SPONG, free, frequencies(model)[1], 1e-6)
    yield VerificationRow(
        "two masses and a spring, motor locked, Hz", SPONG, locked, frequencies(model, lock_joints=True)[0], 1e-6
    )
    rigid = build_model(model.arm, flexible_links=False, flexible_joints=False)
    result = mass_matrix(rigid, np.zeros(2))[0, 0]
    yield VerificationRow("spring of infinite stiffness, J_m + J_l, kg m^2", SPONG, rotor + inertia, result, 1e-6)
    arms = [catalog.paper_rrr(joint_stiffness=each) for each in (1e8, 1e9, None)]
    first, second, limit = (frequencies(build_model(arm), (0.0, 0.3, -0.5))[3:8] for arm in arms)
    ratio = np.abs(first / limit - 1.0).max() / np.abs(second / limit - 1.0).max()
    yield VerificationRow(
        "paper's arm, distance to rigid joints, K 1e8 / K 1e9", "first order in 1/K: 10", 10.0, ratio, 0.1
    )


def _rotating_beam_rows() -> Iterator[VerificationRow]:
    """lambda_1 of a beam with foreshortening that spins at eta = Omega sqrt(rho A L^4 / EI), 8 elements.

    A heavy hub keeps the rate. Axial coordinates are in balance with the centrifugal force; the accelerations of the
    bending coordinates are differentiated there. In the plane of rotation lambda^2 is smaller by eta^2.
    """
    arm = Arm([_slender_link(across=1.0)], [Joint((0.0, 0.0, 1.0), 1e9)])
    model = build_model(arm, 8, stiffening=True)
    for eta, flap in FLAP.items():
        state = model.initial_state([0.0], [eta])
        axial = _columns(8, AXIAL)
        state[axial] -= np.linalg.solve(_slopes(model, state, axial), acceleration(model, state, [0.0])[axial])
        chord = np.sqrt(flap**2 - eta**2)
        for name, columns, expected in (("flap", BENDING_Z, flap), ("chord", BENDING_Y, chord)):
            squares = -np.linalg.eigvals(_slopes(model, state, _columns(8, columns))).real
            result = np.sqrt(squares.min()) if squares.min() > 0.0 else np.nan
            yield VerificationRow(f"rotating beam, eta {eta:g}, {name} lambda_1", WRIGHT, expected, result, 1e-3)


def _paper_arm_rows() -> Iterator[VerificationRow]:
    """The paper's links as cantilevers and the paper's arm at its straight pose."""
    corrected, (one, two, three) = _paper_links("corrected")[0], _paper_links()
    known = (
        ("link 1 (area as printed)", one, "231.1"),
        ("link 1 (area 0.0028 m^2)", corrected, "23.1"),
        ("link 2", two, "66.02"),
        ("link 3", three, "23.11"),
    )
    for name, link, mass in known:
        yield printed_row(f"paper's {name}, mass, kg", TABLE_1, mass, build_beam(link, 2).masses.sum())
        rigidity, density = link.youngs_modulus * link.second_moment_z, link.density * link.area
        scale = np.sqrt(rigidity / density) / (2.0 * np.pi * link.length**2)
        expected = scale * rayleigh_eigenvalues(2, link.second_moment_z / (link.area * link.length**2))
        result = _link_frequencies(link, 16, BENDING_Y)[:2]
        yield from series_rows(f"paper's {name}, bending f_{{}}, Hz", TABLE_1, expected, result, 1e-5)
        for kind, columns in (("axial", AXIAL), ("torsional", TWIST)):
            scale = _bar_scale(link, columns)
            first, highest = _link_frequencies(link, 24, columns)[0], _link_frequencies(link, 2, columns)[-1]
            yield VerificationRow(
                f"paper's {name}, {kind} f_1, Hz", TABLE_1, scale * bar_eigenvalues(1)[0], first, 1e-3
            )
            case = f"paper's {name}, highest {kind} f of 2 elements, Hz"
            yield VerificationRow(case, TABLE_1, scale * bar_eigenvalues(2, 2)[-1], highest, 1e-9)
    light = frequencies(build_model(catalog.paper_rrr(rotor_inertia=0.0, joint_stiffness=None)))
    for i, text in enumerate(("4.5", "9.5")):
        case = f"paper's arm, straight, motors free and weightless, f_{i + 1}, Hz"
        yield printed_row(case, "independent modal analysis", text, light[3 + i])


def _rigid_paper_rows() -> Iterator[VerificationRow]:
    """Tip of the paper's rigid arm without rotors at 2 s, m, with the rotary inertia of the sections."""
    arm = catalog.paper_rrr(rotor_inertia=0.0, joint_stiffness=None)
    result = simulate(replace(catalog.paper_scene("rr"), arm=arm), rtol=1e-9).tip[-1]
    for axis, expected, value in zip("xyz", (1.041793, 2.982679, -0.804536), result, strict=True):
        yield VerificationRow(f"paper RR without rotors, tip {axis} at 2 s, m", THREE_CODES, expected, value, 2e-6)


def _identity_rows() -> Iterator[VerificationRow]:
    """Identities of the paper's arm, everything flexible, at ten bent and moving states."""
    rng, model = np.random.default_rng(0), build_model(catalog.paper_rrr())
    simulator, d, kinetic, inertial = Simulator(model), model.n_dof, [0.0], [0.0]
    stiffness, work = stiffness_matrix(model), layout.make_work(model.constants)
    for _ in range(10):
        state, torque = rng.normal(0.0, 0.01, 2 * d), rng.uniform(-400.0, 400.0, 3)
        state[:3] = state[model.motor_columns] = rng.uniform(-np.pi, np.pi, 3)
        x, v = state[:d], state[d:]
        simulator.reset(state=state)
        matrix = mass_matrix(model, state)
        energy = simulator.outputs[layout.KINETIC]
        kinetic.append(abs(v @ matrix @ v / 2.0 - energy) / energy)
        forward, demanded, applied = acceleration(model, state, torque), np.zeros(d), -stiffness @ x
        applied[model.motor_columns] += torque
        inverse.inertial_forces(model.constants, work, x, v, forward, demanded)
        scale = np.sqrt(np.diag(matrix))
        inertial.append(np.abs((demanded - applied) / scale).max() / np.abs(scale * forward).max())
    yield VerificationRow("half v M v against kinetic energy, largest relative gap", IDENTITY, 0.0, max(kinetic), 1e-9)
    yield VerificationRow("inverse of forward dynamics, largest relative gap", IDENTITY, 0.0, max(inertial), 1e-9)


CASES: tuple[Callable[[], Iterator[VerificationRow]], ...] = (
    _cantilever_rows,
    _hub_rows,
    _convergence_rows,
    _static_rows,
    _stepped_rows,
    _bar_rows,
    _elastic_joint_rows,
    _spring_rows,
    _rotating_beam_rows,
    _paper_arm_rows,
    published_rows,
    _rigid_paper_rows,
    _identity_rows,
)


def _paper_links(link1_area: str = "printed") -> list[Link]:
    """The uniform links of the paper's arm."""
    return [link.sections[0] for link in catalog.paper_rrr(link1_area).links]


def _columns(elements: int, coordinates: Sequence[int]) -> Array:
    """Columns of x that hold some node coordinates of every node of the only link, behind a rigid joint."""
    return np.array([1 + 6 * node + each for node in range(elements) for each in coordinates])


def _bar_scale(link: Link, columns: Sequence[int]) -> float:
    """c / (2 pi L) in Hz: of stretch, or of twist with the polar moment I_y + I_z."""
    modulus, moments = link.youngs_modulus, link.second_moment_y + link.second_moment_z
    if columns == TWIST:
        modulus = link.shear_modulus * link.torsion_constant / moments
    return float(np.sqrt(modulus / link.density) / (2.0 * np.pi * link.length))


def _slopes(model: Model, state: Array, columns: Array, step: float = 1e-5) -> Array:
    """Slopes of the accelerations of some coordinates by the same coordinates, from central differences."""
    slopes = []
    for column in columns:
        shift = step * np.eye(len(state))[column]
        ahead, behind = (acceleration(model, state + sign * shift, [0.0]) for sign in (1.0, -1.0))
        slopes.append((ahead - behind)[columns] / (2.0 * step))
    return np.transpose(slopes)
