"""Co-design of arms: closed forms, conditions of an optimum, an independent optimum, and arms that settle sooner."""

import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, minimize

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.model.beam import element_stiffness
from flexman_gym.model.state_space import natural_modes
from flexman_gym.toolbox.sensitivity.arm_design import optimise_arm

from oracles.assertions import refusal

LENGTH, WIDTH, THICKNESS = 0.8, 0.05, 0.004  # m
SPRING = 300.0  # N m/rad


def strip_arm(stiffness=None, payload=0.0):
    """Environment with a strip on a motor, with or without spring."""
    joint = fm.Joint((0, 0, 1), rotor_inertia=0.01, torque_limit=1.0, stiffness=stiffness)
    arm = fm.Arm([fm.Link.strip(LENGTH, WIDTH, THICKNESS)], [joint], fm.Payload(payload) if payload else None)
    return Configuration("FlexOne-v0", {"arm": arm})


def bending_integrals(sections):
    """Integrals of the squared distance from the tip over equal sections of a beam of unit length, base to tip."""
    ends = np.linspace(1.0, 0.0, sections + 1)
    return (ends[:-1] ** 3 - ends[1:] ** 3) / 3.0


def test_the_lightest_cantilever_under_a_tip_force_has_uniform_strength():
    """Thickness as the root of the distance from the tip: mass 2/3 2^(1/3) of the uniform strip with its deflection.

    Of N sections: t as the fourth root of the mean squared moment, as the deflection is sum(a / t^3).
    """
    masses = {}
    for sections in (4, 12):
        found = optimise_arm(strip_arm(), "mass", sections, thickness=(0.1, 2.0), tip_force=(0.0, 1.0, 0.0))
        roots = bending_integrals(sections) ** 0.25
        scale = (3.0 * roots.sum()) ** (1.0 / 3.0)
        assert found.converged and found.thickness[0] == pytest.approx(scale * roots, rel=1e-4)
        masses[sections] = found.after / found.before
        assert masses[sections] == pytest.approx(scale * roots.mean(), rel=1e-8)
    limit = 2.0 ** (4.0 / 3.0) / 3.0
    assert 0.0 < masses[12] - limit < 0.35 * (masses[4] - limit) < 0.01


@pytest.mark.filterwarnings("ignore:Arm.payload.mass:UserWarning")
def test_a_strip_with_a_heavy_tip_has_the_frequency_of_its_closed_form():
    """Compliance (sum a^(1/4))^4 / N^3, for which the mass of the strip is negligible; 27 / 16 stiffer for large N."""
    found = optimise_arm(strip_arm(payload=4320.0), "frequency", 8, thickness=(0.1, 3.0))
    compliance = (bending_integrals(8) ** 0.25).sum() ** 4 / 8**3
    assert (found.after / found.before) ** 2 == pytest.approx(1.0 / (3.0 * compliance), rel=1e-4)
    assert 1.6 < 1.0 / (3.0 * compliance) < 27.0 / 16.0


def energy_densities(arm):
    """Differences (S,) of 3 x strain energy and kinetic energy per mass of an arm of one strip, in its first mode."""
    model = fm.build_model(arm, elements=1)
    free = np.setdiff1d(np.arange(model.n_dof), model.motor_columns)
    block = np.ix_(free, free)
    mass = fm.mass_matrix(model, np.zeros(2 * model.n_dof))
    squares, shapes = natural_modes(mass[block], fm.stiffness_matrix(model)[block])
    mode = np.zeros(model.n_dof)
    mode[free] = shapes[:, 0]
    nodes, result = np.concatenate([np.zeros(6), mode[model.elastic_columns(0)]]), []
    points, weights = np.polynomial.legendre.leggauss(6)
    for element in model.elements(0):
        section, start, length, place = element
        own, kinetic = nodes[place], 0.0
        for xi, weight in zip((1.0 + points) / 2.0, weights / 2.0, strict=True):
            sideways = mode[0] * (start + xi * length) + element.shapes(xi)[1] @ own
            turn = mode[0] + element.slopes(xi)[0] @ own
            # the second moment of area grows with the cube of the thickness
            rotary = 3.0 * section.second_moment_z / section.area * turn**2
            kinetic += weight * section.mass * (sideways**2 + rotary)
        strain = own @ element_stiffness(section, length) @ own
        result.append((3.0 * strain - squares[0] * kinetic) / section.mass)
    return np.array(result)


def test_the_optimum_has_equal_differences_of_energy_densities_and_no_bound_is_passed():
    """Of strain and kinetic energy per mass in all sections between the bounds; less in sections at the least."""
    given = strip_arm(SPRING, 0.05)
    found = optimise_arm(given, sections=8, thickness=(0.6, 2.0))
    factors, densities = np.array(found.thickness[0]), energy_densities(found.environment.arm)
    assert factors.min() == pytest.approx(0.6) and (factors >= 0.6 - 1e-12).all()
    inner = factors > 0.6 + 1e-6
    level = densities[inner].mean()
    assert 4 <= inner.sum() < 8 and np.abs(densities[inner] - level).max() < 1e-4 * level
    assert (densities[~inner] < level).all()
    assert sum(found.masses) == pytest.approx(given.arm.links[0].mass, rel=1e-9)


def test_an_optimum_without_these_gradients_is_the_same():
    """By trust-constr with differences, on frequencies of arms built anew; thickness in metres, mass as equality."""
    given = strip_arm(SPRING, 0.05)
    found, arm = optimise_arm(given, sections=3, thickness=(0.6, 2.0)), given.arm

    def slowness(sizes):
        parts = [fm.Link.strip(LENGTH / 3, WIDTH, THICKNESS * size) for size in sizes]
        stepped = fm.Arm([fm.NonUniformLink(parts)], arm.joints, arm.payload)
        return -fm.frequencies(fm.build_model(stepped, elements=1), lock_joints=True)[0]

    equal_mass = NonlinearConstraint(np.mean, 1.0, 1.0)
    other = minimize(slowness, np.ones(3), method="trust-constr", bounds=[(0.6, 2.0)] * 3,
                     constraints=equal_mass, options={"gtol": 1e-6, "maxiter": 60})  # fmt: skip
    assert -other.fun == pytest.approx(found.after, rel=1e-4)
    assert other.x == pytest.approx(found.thickness[0], rel=1e-2)


def test_the_mass_of_every_link_is_kept_where_it_is_asked_for():
    given = Configuration("FlexPlanar-v0").arm
    found = optimise_arm("FlexPlanar-v0", sections=3, keep="links")
    assert found.masses == pytest.approx([link.mass for link in given.links], rel=1e-8)
    assert found.after > 1.1 * found.before and len({len(each) for each in found.thickness}) == 1


def test_a_design_for_settling_settles_sooner_when_it_is_simulated(tmp_path, capsys):
    """Gains, gears and thickness by the command, at equal mass of each link; the same 20 episodes."""
    file = tmp_path / "arm.yaml"
    command = [
        "optimise",
        "arm",
        "FlexPlanar-v0",
        "--metric",
        "settling",
        "--sections",
        "2",
        "--keep",
        "links",
        "--gears",
        "0.5",
        "2",
    ]
    assert main([*command, "--out", str(file)]) == 0
    said = capsys.readouterr().out
    assert "thickness of link 2" in said and "gear ratios" in said and said.startswith("settling: ")
    given, found = Configuration("FlexPlanar-v0"), Configuration.load(file)
    masses = [[link.mass for link in each.arm.links] for each in (given, found)]
    assert masses[0] == pytest.approx(masses[1], rel=1e-6)
    before, after = (fm.evaluate("pd", each, range(9000, 9020)) for each in (given, found))
    assert after["settled"] == 1.0 and after["settling_time"] < 0.9 * before["settling_time"]


@pytest.mark.parametrize(
    ("environment", "keywords", "line"),
    [
        ("FlexRotary-v0", {}, "environment: 'FlexRotary-v0' is not allowed; give one whose links are flexible"),
        ("FlexOne-v0", {"metric": "stress"}, "metric: 'stress' is not allowed"),
        ("FlexOne-v0", {"sections": 0}, "sections: 0 is not allowed"),
        ("FlexOne-v0", {"thickness": (0.5, 0.9)}, "thickness: (0.5, 0.9) is not allowed; give the smallest factor"),
        ("FlexOne-v0", {"gears": (1.1, 2.0)}, "gears: (1.1, 2.0) is not allowed; give the smallest factor"),
        ("FlexOne-v0", {"keep": "joints"}, "keep: 'joints' is not allowed"),
        ("FlexOne-v0", {"metric": "mass"}, "tip_force: (0.0, 0.0, 0.0) is not allowed; give a force (N)"),
        ("FlexPlanar-Track-v0", {"metric": "settling"}, "metric: 'settling' is not allowed; give frequency or mass"),
    ],
)
def test_what_cannot_be_optimised_is_refused(environment, keywords, line):
    assert line in refusal(lambda: optimise_arm(environment, **keywords))
