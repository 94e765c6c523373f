"""Guesses: keywords that other libraries have are answered in one line, with what is modelled and what to take."""

import inspect
import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm

Z = (0.0, 0.0, 1.0)
JOINT = fm.Joint(Z, 0.01)
LINK = fm.Link.strip(0.5, 0.04, 0.003)
SIZES = {"length": 0.5, "area": 1.2e-4, "second_moment_y": 1.6e-8, "second_moment_z": 9e-11}
MODULI = {"torsion_constant": 3.4e-10, "youngs_modulus": 69e9, "shear_modulus": 26e9, "density": 2700.0}
RUN = {"model": fm.ModelChoice(True, 1), "torque": fm.ConstantTorque([0.0]), "initial": fm.Initial([0.0], [0.0])}
GUESSES = {  # call, and what its error names: the field, what is modelled, what to take
    "prismatic": (lambda: fm.Joint(Z, kind="prismatic"), ("Joint.kind: 'prismatic'", "revolute", "MuJoCo")),
    "type": (lambda: fm.Joint(Z, type="prismatic"), ("Joint.type", "revolute", "Pinocchio")),
    "friction": (lambda: fm.Joint(Z, friction=0.1), ("Joint.friction", "viscous_friction", "coulomb_friction")),
    "free base": (lambda: fm.Arm([LINK], [JOINT], base="free"), ("Arm.base: 'free'", "fixed", "Drake")),
    "tree": (lambda: fm.Arm([LINK], [JOINT], parents=[-1]), ("Arm.parents: [-1]", "serial", "Drake")),
    "contact": (lambda: fm.Scene(fm.Arm([LINK], [JOINT]), **RUN, duration=1.0, output_step=0.1, contact=True),
                ("Scene.contact: True", "tip_force", "MuJoCo")),
    "method": (lambda: fm.Scene(fm.Arm([LINK], [JOINT]), **RUN, duration=1.0, output_step=0.1, method="rk4"),
               ("Scene.method", "fm.simulate")),
    "material": (lambda: fm.Link(**SIZES, **MODULI, material="steel"), ("Link.material", "fm.Link.strip")),
    "misspelt": (lambda: fm.Joint(Z, stifness=3.0), ("Joint.stifness: 3.0", "stiffness")),
    "misspelt load": (lambda: fm.Payload(mas=3.0), ("Payload.mas", "mass")),
    "misspelt motor": (lambda: fm.Motor(gear=50.0), ("Motor.gear", "gear_ratio")),
}  # fmt: skip


@pytest.mark.parametrize("name", GUESSES)
def test_a_guessed_keyword_is_answered_in_one_line(name):
    call, parts = GUESSES[name]
    with pytest.raises(TypeError) as caught:
        call()
    line = str(caught.value)
    assert all(part in line for part in parts), line
    assert "\n" not in line and len(line) < 250


def test_a_file_is_answered_as_a_constructor_is():
    """By a ValueError, as everything else that is wrong with a file."""
    data = fm.catalog.paper_scene("rr").to_dict()
    with pytest.raises(ValueError, match=r"^contact: True .*MuJoCo"):
        fm.Scene.from_dict(data | {"contact": True})
    data["arm"]["joints"][1]["friction"] = 0.01
    with pytest.raises(ValueError, match=r"^arm\.joints\[1\]\.friction: 0\.01 .*coulomb_friction"):
        fm.Scene.from_dict(data)


def test_signatures_stay_typed_and_parts_are_copied_as_before():
    for kind in (fm.Joint, fm.Link, fm.Motor, fm.Payload, fm.Arm, fm.Scene):
        parameters = inspect.signature(kind).parameters
        assert list(parameters) == list(kind.__dataclass_fields__)
        assert all(each.annotation is not each.empty for each in parameters.values())
    assert replace(JOINT, damping=0.0) == JOINT == pickle.loads(pickle.dumps(JOINT))


def test_a_subclass_may_have_keywords_of_its_own():
    class Hub(fm.Joint):
        def __init__(self, size):
            super().__init__(Z, rotor_inertia=size)

    assert Hub(size=0.02).rotor_inertia == 0.02


def test_a_missing_argument_is_python_s_own_error():
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'axis'"):
        fm.Joint()


def test_warnings_blame_who_called():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fm.Link(**SIZES, **MODULI | {"density": 2.7})
        fm.Link.strip(500.0, 40.0, 30.0)
    assert len(caught) == 2 and {each.filename for each in caught} == {__file__}


STRIP = dict(length=0.5, area=1.2e-4, second_moment_y=1.6e-8, second_moment_z=9e-11, torsion_constant=3.4e-10,
             youngs_modulus=69e9, shear_modulus=26e9, density=2700.0)  # fmt: skip
MOTOR = dict(gear_ratio=50.0, torque_constant=0.04, rotor_inertia=1e-5)


def arm(payload=None, masses=(), **changes):
    """An arm of one strip on a hub."""
    return fm.Arm([fm.Link(**STRIP, masses=masses)], [fm.Joint(Z, 0.01)], payload, **changes)


def inertia(size):
    """A round inertia."""
    return size * np.eye(3)


WRONG_UNITS = {
    "E in GPa": lambda: fm.Link(**STRIP | {"youngs_modulus": 69.0}),
    "E in MPa": lambda: fm.Link(**STRIP | {"youngs_modulus": 69e3}),
    "G in GPa": lambda: fm.Link(**STRIP | {"shear_modulus": 26.0}),
    "E and density of a material in GPa": lambda: fm.Link.strip(0.5, 0.04, 0.003, material=(69.0, 26e9, 2700.0)),
    "density in g/cm^3": lambda: fm.Link(**STRIP | {"density": 2.7}),
    "density as kg/m": lambda: fm.Link(**STRIP | {"density": 0.324}),
    "length in mm": lambda: fm.Link(**STRIP | {"length": 500.0}),
    "sizes of a strip in mm": lambda: fm.Link.strip(0.5, 40.0, 3.0),
    "diameter of a tube in mm": lambda: fm.Link.tube(0.5, 30.0, 1.5),
    "area in mm^2": lambda: fm.Link(**STRIP | {"area": 120.0, "second_moment_y": 2e3, "second_moment_z": 2e3}),
    "second moments in mm^4": lambda: fm.Link(**STRIP | {"second_moment_y": 16000.0, "second_moment_z": 90.0}),
    "second moments in cm^4": lambda: fm.Link(**STRIP | {"second_moment_y": 1.6, "second_moment_z": 0.009}),
    "torsion constant in mm^4": lambda: fm.Link(**STRIP | {"torsion_constant": 340.0}),
    "rotor in g cm^2": lambda: fm.Motor(**MOTOR | {"rotor_inertia": 137.0}),
    "torque constant in mN m/A": lambda: fm.Motor(**MOTOR | {"torque_constant": 40.0}),
    "speed in 1/min": lambda: fm.Motor(**MOTOR, speed_limit=6000.0),
    "counts of an encoder": lambda: fm.Motor(**MOTOR, encoder_resolution=4096.0),
    "gravity in mm/s^2": lambda: arm(gravity=(0.0, 0.0, -9810.0)),
    "damping in per cent": lambda: arm(modal_damping_ratio=0.5),
    "payload in g": lambda: arm(fm.Payload(500.0)),
    "offset in mm": lambda: arm(fm.Payload(0.5, offset=(30.0, 0.0, 0.0))),
    "inertia in g cm^2": lambda: arm(fm.Payload(0.5, inertia(500.0))),
    "lumped mass in g": lambda: arm(masses=[fm.LumpedMass(300.0, 0.2)]),
    "a beam that is too soft": lambda: fm.build_model(
        fm.Arm([fm.Link(**STRIP | {"youngs_modulus": 1.5e5, "density": 2e4})], [fm.Joint(Z)], fm.Payload(5.0))
    ),
    "a beam that is too stiff": lambda: fm.build_model(fm.Arm([fm.Link.rod(0.01, 0.01)], [fm.Joint(Z)])),
}


@pytest.mark.parametrize("name", WRONG_UNITS)
def test_a_wrong_unit_is_warned_of_in_one_line(name):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        WRONG_UNITS[name]()
    lines = [str(each.message) for each in caught if each.category is UserWarning]
    assert len(lines) == 1 and "\n" not in lines[0] and len(lines[0]) < 200, lines
    assert caught[0].filename.endswith(("test_input_checks.py", "link.py"))


def sensible(rng):
    """An arm as somebody might build it: of 30 cm to 3 m, with 1 to 4 links of metal or nylon, motors and a load."""
    count, reach = rng.integers(1, 5), 10 ** rng.uniform(-0.5, 0.5)

    def link():
        length, size = reach / count * rng.uniform(0.6, 1.4), reach * rng.uniform(0.015, 0.06)
        material = rng.choice(["aluminium", "steel", "titanium", "nylon"])
        material = (2.5e9, 0.9e9, 1150.0) if material == "nylon" else str(material)
        shape = rng.integers(3)
        if shape == 0:
            return fm.Link.strip(length, size, size * rng.uniform(0.1, 1.0), rng.choice(["y", "z"]), material)
        return fm.Link.tube(length, size, 0.1 * size, material) if shape == 1 else fm.Link.rod(length, size, material)

    links = [link() for _ in range(count)]
    mass = sum(each.mass for each in links)
    links[0] = replace(links[0], masses=[fm.LumpedMass(mass * rng.uniform(0.1, 2.0), links[0].length)])
    motor = fm.Motor(
        gear_ratio=rng.uniform(1.0, 200.0), torque_constant=10 ** rng.uniform(-2.5, 0.3),
        rotor_inertia=10 ** rng.uniform(-7.0, -3.0), current_limit=3.0, speed_limit=rng.uniform(50.0, 1500.0),
        encoder_resolution=2 * np.pi / 2048,
    )  # fmt: skip
    joints = [fm.Joint(Z, motor=motor, stiffness=rng.choice([None, 10 ** rng.uniform(1.5, 4.5)])) for _ in links]
    load = fm.Payload(mass * rng.uniform(0.0, 3.0) + 1e-3, inertia(1e-4 * mass), (0.0, 0.02, 0.0))
    return fm.Arm(links, joints, load, (0.0, 0.0, -9.81), 1e-4, 0.01)


@pytest.mark.slow
def test_sensible_arms_are_not_warned_of():
    rng = np.random.default_rng(5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for i in range(200):
            built = sensible(rng)
            if i % 5 == 0:
                fm.build_model(built, 1)


def test_named_arms_are_not_warned_of():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for make in (
            fm.catalog.paper_rrr,
            fm.catalog.one_link,
            fm.catalog.planar_2r,
            fm.catalog.vertical_2r,
            fm.catalog.one_joint,
        ):
            fm.build_model(make())
