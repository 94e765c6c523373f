"""Cross-sections of links (strip, tube, rod) and materials."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from flexman_gym.common.checks import instance, mapping, one_of, physical, sequence, set_fields, value_error

SHAPES = ("strip", "tube", "rod")
ACROSS = {"y": "z", "z": "y"}
MATCHING = 1e-6  # part by which the numbers of a link may differ from those of its outline
TERMS = 60  # of the series for a rectangle, whose rest is below rounding from some 30 on


class _Material(NamedTuple):
    """What a link is made of: Young's modulus and shear modulus in Pa, density in kg/m^3."""

    youngs_modulus: float
    shear_modulus: float
    density: float


MATERIALS = {
    "aluminium": _Material(68.9e9, 26.0e9, 2700.0),
    "steel": _Material(205.0e9, 80.0e9, 7850.0),
    "titanium": _Material(113.8e9, 44.0e9, 4430.0),
}


def find_material(value: object) -> _Material:
    """Gives a material by its name, or by its three numbers as a list or a mapping.

    The names are typical alloys with the numbers of the data sheets of ASM (Aerospace Specification Metals): aluminium
    6061-T6 (68.9 GPa, 26 GPa, 2700 kg/m^3), steel 4130 (205 GPa, 80 GPa, 7850 kg/m^3) and titanium Ti-6Al-4V (113.8
    GPa, 44 GPa, 4430 kg/m^3). A measured modulus is better than any of them.

    Raises:
        ValueError: for another name, and for anything but three numbers from 1e-30 to 1e30.
    """
    if isinstance(value, str):
        return MATERIALS[one_of("Link.material", value, MATERIALS)]
    if isinstance(value, dict):
        value = tuple(mapping("Link.material", value, _Material._fields).get(name) for name in _Material._fields)
    allowed = f"youngs_modulus (Pa), shear_modulus (Pa) and density (kg/m^3), or one of {', '.join(MATERIALS)}"
    numbers = sequence("Link.material", value, allowed)
    if len(numbers) != 3:
        raise value_error("Link.material", value, allowed)
    units = ("Pa", "Pa", "kg/m^3")
    named = zip(_Material._fields, numbers, units, strict=True)
    return _Material(*(physical(f"Link.{name}", number, unit) for name, number, unit in named))


@dataclass(frozen=True)
class Outline:
    """The outline of a cross-section, centred on the axis of its link, in the link's own y and z.

    Attributes:
        shape: "strip", a rectangle; "tube" or "rod", hollow and solid and round.
        y, z: its outer sizes along y and z, m; equal for a round one.
        wall: thickness of the wall of a tube, m; None for the others.

    Raises:
        ValueError: for another shape, for sizes that are not positive, and for a wall that does not fit.
    """

    shape: str
    y: float
    z: float
    wall: float | None = None

    def __post_init__(self) -> None:
        one_of("Outline.shape", self.shape, SHAPES)
        set_fields(self, y=physical("Outline.y", self.y, "m"), z=physical("Outline.z", self.z, "m"))
        if self.shape != "strip" and self.y != self.z:
            raise value_error("Outline.z", self.z, f"{self.y} (m), the diameter along y")
        if self.shape == "tube":
            set_fields(self, wall=physical("Outline.wall", self.wall, "m"))
            if not 2.0 * self.wall <= self.y:  # type: ignore[operator]
                raise value_error("Outline.wall", self.wall, f"at most half of the diameter {self.y} (m)")
        elif self.wall is not None:
            raise value_error("Outline.wall", self.wall, f"None for a {self.shape}")

    @property
    def hollow(self) -> float:
        """Diameter of the hole of a tube, m; 0 for the others."""
        return self.y - 2.0 * self.wall if self.wall else 0.0

    @property
    def area(self) -> float:
        """Area, m^2."""
        if self.shape == "strip":
            return self.y * self.z
        return math.pi / 4.0 * (self.y + self.hollow) * (self.y - self.hollow)

    @property
    def second_moment_y(self) -> float:
        """Integral of z^2 over the area, m^4."""
        return self.area * (self.z**2 / 12.0 if self.shape == "strip" else (self.y**2 + self.hollow**2) / 16.0)

    @property
    def second_moment_z(self) -> float:
        """Integral of y^2 over the area, m^4."""
        return self.area * (self.y**2 / 12.0 if self.shape == "strip" else (self.y**2 + self.hollow**2) / 16.0)

    @property
    def torsion_constant(self) -> float:
        """Torsion constant J of St Venant, m^4.

        That of a rectangle is the series of Timoshenko and Goodier (Theory of Elasticity, article on the torsion of
        rectangular bars); that of a round section is its polar moment.
        """
        if self.shape != "strip":
            return 2.0 * self.second_moment_y
        thin, wide = sorted((self.y, self.z))
        odd = range(1, 2 * TERMS, 2)
        lost = sum(math.tanh(n * math.pi * wide / (2.0 * thin)) / n**5 for n in odd)
        return wide * thin**3 * (1.0 - 192.0 * thin * lost / (math.pi**5 * wide)) / 3.0

    @property
    def words(self) -> str:
        """Its sizes in plain words, and for a strip which way it is thin."""
        if self.shape != "strip":
            return f"{self.y:g} m across" + (f", wall {self.wall:g} m" if self.wall else "")
        sizes = f"{self.y:g} m along y, {self.z:g} m along z"
        if self.y == self.z:
            return sizes
        thin = "y" if self.y < self.z else "z"
        return f"{sizes}: thin along {thin}, it bends easily in its x-{thin} plane"


def strip_outline(width: float, thickness: float, thin: str) -> Outline:
    """Gives the outline of a strip that is thin along "y" or "z".

    Raises:
        ValueError: for sizes that are not positive, a thickness above the width, and another axis.
    """
    width, thickness = physical("Link.width", width, "m"), physical("Link.thickness", thickness, "m")
    if thickness > width:
        raise value_error("Link.thickness", thickness, f"at most the width {width} (m); thin says which way it is thin")
    sizes = {one_of("Link.thin", thin, ACROSS): thickness, ACROSS[thin]: width}
    return Outline("strip", sizes["y"], sizes["z"])


def round_outline(diameter: float, wall: float | None = None) -> Outline:
    """Gives the outline of a rod, or of a tube with a wall.

    Raises:
        ValueError: for sizes that are not positive, and for a wall above half of the diameter.
    """
    diameter = physical("Link.diameter", diameter, "m")
    if wall is None:
        return Outline("rod", diameter, diameter)
    if physical("Link.wall", wall, "m") > diameter / 2.0:
        raise value_error("Link.wall", wall, f"at most half of the diameter {diameter} (m)")
    return Outline("tube", diameter, diameter, wall)


def check_outline(outline: object, numbers: dict[str, float]) -> None:
    """Refuses an outline that has not the area and the second moments of area of its link.

    Raises:
        ValueError: one line with the first number that differs; also for something else than an Outline.
    """
    own = instance("Link.outline", outline, Outline, "an Outline or None")
    for name in ("area", "second_moment_y", "second_moment_z"):
        if not math.isclose(numbers[name], getattr(own, name), rel_tol=MATCHING):
            allowed = f"{getattr(own, name):.6g}, that of its outline, or the link without an outline"
            raise value_error(f"Link.{name}", numbers[name], allowed)
