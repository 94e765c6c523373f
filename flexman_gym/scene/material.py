"""Materials of links: names, moduli and densities."""

from typing import NamedTuple

from flexman_gym.common.checks import mapping, physical, sequence
from flexman_gym.common.errors import value_error


class _Material(NamedTuple):
    """Young's modulus and shear modulus (Pa) and density (kg/m^3) of a link."""

    youngs_modulus: float
    shear_modulus: float
    density: float


MATERIALS = {
    "aluminium": _Material(68.9e9, 26.0e9, 2700.0),
    "steel": _Material(205.0e9, 80.0e9, 7850.0),
    "titanium": _Material(113.8e9, 44.0e9, 4430.0),
}
YIELD_STRENGTHS = {"aluminium": 276e6, "steel": 435e6, "titanium": 880e6}  # Pa; same data sheets, see `find_material`
YIELD_STRAINS = {name: yield_ / MATERIALS[name].youngs_modulus for name, yield_ in YIELD_STRENGTHS.items()}  # m/m


def find_material(value: object) -> _Material:
    """Return a material given by name, or by its three numbers as a list or a mapping.

    The names stand for typical alloys with values from the data sheets of ASM (Aerospace Specification Metals):
    aluminium 6061-T6 (68.9 GPa, 26 GPa, 2700 kg/m^3), steel 4130 (205 GPa, 80 GPa, 7850 kg/m^3) and titanium Ti-6Al-4V
    (113.8 GPa, 44 GPa, 4430 kg/m^3). Their yield strengths are 276, 435 (normalised) and 880 MPa (annealed). Prefer
    measured values.
    """
    numbers = "youngs_modulus (Pa), shear_modulus (Pa) and density (kg/m^3)"
    allowed = f"one of {', '.join(MATERIALS)}, or three numbers, {numbers}"
    if isinstance(value, str):
        if value not in MATERIALS:
            raise value_error("Link.material", value, allowed)
        return MATERIALS[value]
    if isinstance(value, dict):
        value = tuple(mapping("Link.material", value, _Material._fields).get(name) for name in _Material._fields)
    values = sequence("Link.material", value, allowed)
    if len(values) != 3:
        raise value_error("Link.material", value, allowed)
    units = ("Pa", "Pa", "kg/m^3")
    named = zip(_Material._fields, values, units, strict=True)
    return _Material(*(physical(f"Link.{name}", number, unit) for name, number, unit in named))
