"""Guesses: keywords that other libraries have are answered in one line, with what is modelled and what to take."""

import inspect
import pickle
import warnings
from dataclasses import replace

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
    "backlash": (lambda: fm.Joint(Z, backlash=0.01), ("Joint.backlash: 0.01", "spring", "Modelica")),
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
    data["arm"]["joints"][1]["backlash"] = 0.01
    with pytest.raises(ValueError, match=r"^arm\.joints\[1\]\.backlash: 0\.01 .*Modelica"):
        fm.Scene.from_dict(data)


def test_an_arm_is_not_read_from_urdf_and_the_error_names_what_does():
    """It stays an AttributeError, so that `hasattr` is false."""
    with pytest.raises(AttributeError, match=r"URDF.*rigid.*fm\.Arm\(links, joints\).*Pinocchio"):
        fm.Arm.from_urdf("arm.urdf")
    assert not hasattr(fm.Arm, "from_urdf") and not hasattr(fm.Arm([LINK], [JOINT]), "from_urdf")


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
