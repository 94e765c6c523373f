"""Links: cross-sections and materials, uniform and stepped beams, and the lumped masses clamped to them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, Self

from flexman_gym.common.arrays import Matrix
from flexman_gym.common.checks import (
    instance,
    instances,
    mapping,
    one_of,
    physical,
    rotation,
    sequence,
    set_fields,
    value_error,
)
from flexman_gym.scene.input_checks import check_keywords, warn_caller, warn_unusual_units
from flexman_gym.scene.rigid_body import LumpedMass

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


def _find_material(value: object) -> _Material:
    """Return a material by its name, or by its three numbers as a list or a mapping.

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


def _strip_outline(width: float, thickness: float, thin: str) -> Outline:
    """Return the outline of a strip that is thin along "y" or "z".

    Raises:
        ValueError: for sizes that are not positive, a thickness above the width, and another axis.
    """
    width, thickness = physical("Link.width", width, "m"), physical("Link.thickness", thickness, "m")
    if thickness > width:
        raise value_error("Link.thickness", thickness, f"at most the width {width} (m); thin says which way it is thin")
    sizes = {one_of("Link.thin", thin, ACROSS): thickness, ACROSS[thin]: width}
    return Outline("strip", sizes["y"], sizes["z"])


def _round_outline(diameter: float, wall: float | None = None) -> Outline:
    """Return the outline of a rod, or of a tube with a wall.

    Raises:
        ValueError: for sizes that are not positive, and for a wall above half of the diameter.
    """
    diameter = physical("Link.diameter", diameter, "m")
    if wall is None:
        return Outline("rod", diameter, diameter)
    if physical("Link.wall", wall, "m") > diameter / 2.0:
        raise value_error("Link.wall", wall, f"at most half of the diameter {diameter} (m)")
    return Outline("tube", diameter, diameter, wall)


def _check_outline(outline: object, numbers: dict[str, float]) -> None:
    """Raise a ValueError for an outline that has not the area and the second moments of area of its link.

    Raises:
        ValueError: one line with the first number that differs; also for something else than an Outline.
    """
    own = instance("Link.outline", outline, Outline, "an Outline or None")
    for name in ("area", "second_moment_y", "second_moment_z"):
        if not math.isclose(numbers[name], getattr(own, name), rel_tol=MATCHING):
            allowed = f"{getattr(own, name):.6g}, that of its outline, or the link without an outline"
            raise value_error(f"Link.{name}", numbers[name], allowed)


MAX_MASSES = 64  # on a link


def _lumped_masses(name: str, value: object, length: float) -> tuple[LumpedMass, ...]:
    """Gives the lumped masses of a link of a length (m) as a tuple.

    Raises:
        ValueError: for something else, for more than 64 and for a position beyond the tip.
    """
    masses = tuple(sequence(name, value, "LumpedMass"))
    if len(masses) > MAX_MASSES:
        raise value_error(name, f"{len(masses)} masses", f"at most {MAX_MASSES}")
    for i, mass in enumerate(masses):
        if not isinstance(mass, LumpedMass):
            raise value_error(f"{name}[{i}]", mass, "a LumpedMass")
        if mass.position > length:
            raise value_error(f"{name}[{i}].position", mass.position, f"at most the length {length} of the link (m)")
    return masses


def _total_mass(masses: Sequence[LumpedMass]) -> float:
    """Return the mass of all lumped masses, kg."""
    return sum(mass.mass for mass in masses)


MAX_WIDTH = 5.0  # lengths of a link that no section exceeds
MAX_TORSION = 10.0  # polar moments of area that no torsion constant exceeds
MAX_SECTIONS = 64  # of a link, as a model has at most so many finite elements of it
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
UP = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))  # turns the x axis of a beam to +Z

_LINK_UNITS = {
    "length": "m",
    "area": "m^2",
    "second_moment_y": "m^4",
    "second_moment_z": "m^4",
    "torsion_constant": "m^4",
    "youngs_modulus": "Pa",
    "shear_modulus": "Pa",
    "density": "kg/m^3",
}


@check_keywords
@dataclass(frozen=True)
class Link:
    """A straight uniform beam along the x axis of its own frame, from its joint to its tip.

    It warns (UserWarning) when second_moment_y + second_moment_z is less than area^2 / (2 pi). No section can have so
    little: of all sections of one area a solid disc has the least polar moment. It also warns of numbers that can only
    be in another unit.

    Attributes:
        length: m.
        area: of the cross-section, m^2.
        second_moment_y: int z^2 dA, m^4; it resists bending in the x-z plane.
        second_moment_z: int y^2 dA, m^4; it resists bending in the x-y plane.
        torsion_constant: J in G J, m^4; it resists twist. For a round section it is the polar moment.
        youngs_modulus: Pa.
        shear_modulus: Pa.
        density: kg/m^3.
        orientation: (3, 3) rotation whose columns are the beam's axes in the joint's frame; stored as rows of floats.
        masses: of LumpedMass, bodies that sit on the link; stored as a tuple.
        outline: of its section, for pictures; None for a link of which only the numbers above are known.

    Raises:
        ValueError: for a number that is not from 1e-30 to 1e30, for an orientation that is not a rotation within 1e-9,
            for a mass beyond the tip, and for an outline of another area or other second moments of area.

    Examples:
        >>> link = fm.Link(0.8, 6e-5, 2.88e-11, 5e-9, 1.15e-10, 69e9, 26e9, 2700.0)
        >>> round(link.mass, 3)
        0.13
    """

    length: float
    area: float
    second_moment_y: float
    second_moment_z: float
    torsion_constant: float
    youngs_modulus: float
    shear_modulus: float
    density: float
    orientation: Matrix = IDENTITY
    masses: Sequence[LumpedMass] = ()
    outline: Outline | None = None

    def __post_init__(self) -> None:
        set_fields(
            self, **{name: physical(f"Link.{name}", getattr(self, name), unit) for name, unit in _LINK_UNITS.items()}
        )
        set_fields(self, orientation=rotation("Link.orientation", self.orientation))
        set_fields(self, masses=_lumped_masses("Link.masses", self.masses, self.length))
        if self.outline is not None:
            _check_outline(self.outline, vars(self))
        warn_unusual_units("Link", vars(self))
        polar, least = self.second_moment_y + self.second_moment_z, self.area * self.area / (2.0 * math.pi)
        if polar < (1.0 - 1e-9) * least:
            warn_caller(
                f"Link.second_moment_y + second_moment_z: {polar:.6g} is less than any section of the area "
                f"{self.area:.6g} m^2 has; the least is {least:.6g} (m^4), area^2 / (2 pi) of a solid disc"
            )
        _warn_of_section(self.length, self.area, polar, self.torsion_constant)

    @classmethod
    def strip(
        cls,
        length: float,
        width: float,
        thickness: float,
        thin: str = "y",
        material: Any = "aluminium",
        orientation: Matrix = IDENTITY,
        masses: Sequence[LumpedMass] = (),
    ) -> Self:
        """Builds a flat strip of rectangular section.

        Thin along "y" it is like a ruler that stands on its edge: its width is along z, and it bends easily in its x-y
        plane. Thin along "z" it is like a diving board: its width is along y, and it bends easily in its x-z plane.

        Args:
            length: m.
            width: larger size of the section, m.
            thickness: smaller size of the section, m.
            thin: "y" or "z", the axis of the link along which it is thin.
            material: "aluminium" 6061-T6, "steel" 4130 or "titanium" Ti-6Al-4V, with the numbers of the data sheets of
                ASM (Aerospace Specification Metals); or three numbers: Young's modulus (Pa), shear modulus (Pa) and
                density (kg/m^3).
            orientation: as of any Link.
            masses: as of any Link.

        Raises:
            ValueError: for a size that is not positive, a thickness above the width, another axis or material.

        Examples:
            >>> ruler = fm.Link.strip(length=0.8, width=0.05, thickness=0.001)
            >>> round(ruler.mass, 3)
            0.108
        """
        return cls._outlined(length, _strip_outline(width, thickness, thin), material, orientation, masses)

    @classmethod
    def tube(
        cls,
        length: float,
        diameter: float,
        wall: float,
        material: Any = "aluminium",
        orientation: Matrix = IDENTITY,
        masses: Sequence[LumpedMass] = (),
    ) -> Self:
        """Builds a round tube.

        Args:
            length: m.
            diameter: outer one, m.
            wall: thickness of the wall, m.
            material: as of `strip`.
            orientation: as of `strip`.
            masses: as of `strip`.

        Raises:
            ValueError: for a size that is not positive, and for a wall above half of the diameter.
        """
        return cls._outlined(length, _round_outline(diameter, wall), material, orientation, masses)

    @classmethod
    def rod(
        cls,
        length: float,
        diameter: float,
        material: Any = "aluminium",
        orientation: Matrix = IDENTITY,
        masses: Sequence[LumpedMass] = (),
    ) -> Self:
        """Builds a solid round rod.

        Args:
            length: m.
            diameter: m.
            material: as of `strip`.
            orientation: as of `strip`.
            masses: as of `strip`.

        Raises:
            ValueError: for a size that is not positive.
        """
        return cls._outlined(length, _round_outline(diameter), material, orientation, masses)

    @classmethod
    def _outlined(
        cls, length: float, outline: Outline, material: Any, orientation: Matrix, masses: Sequence[LumpedMass]
    ) -> Self:
        names = ("area", "second_moment_y", "second_moment_z", "torsion_constant")
        numbers = {name: getattr(outline, name) for name in names}
        whole = _find_material(material)._asdict()
        return cls(length, orientation=orientation, masses=masses, outline=outline, **numbers, **whole)

    def __repr__(self) -> str:
        if self.outline is None:
            shown = (each for each in fields(self) if getattr(self, each.name) != each.default)
            return f"Link({', '.join(f'{each.name}={getattr(self, each.name)!r}' for each in shown)})"
        moduli = f"E {self.youngs_modulus:g} Pa, G {self.shear_modulus:g} Pa, {self.density:g} kg/m^3"
        carried = f", lumped masses of {_total_mass(self.masses):g} kg" if self.masses else ""
        return f"<Link: a {self.outline.shape} {self.length:g} m long, {self.outline.words}\n  {moduli}{carried}>"

    @property
    def mass(self) -> float:
        """Mass of the link with its lumped masses, kg."""
        return self.density * self.area * self.length + _total_mass(self.masses)

    @property
    def sections(self) -> tuple["Link", ...]:
        """The link itself, as its only section."""
        return (self,)


def _warn_of_section(length: float, area: float, polar: float, torsion: float) -> None:
    """Warn (UserWarning) of a section that is far too large for the length (m) of its link.

    Args:
        length: m.
        area: m^2.
        polar: sum of both second moments of area, m^4.
        torsion: torsion constant, m^4.
    """
    radius, size = math.sqrt(polar / area), math.sqrt(area)
    if size > MAX_WIDTH * length:
        said = f"Link.area: {area:g} (m^2) is wider than the link is long, a slip of units; in mm^2, sizes in mm?"
    elif radius > MAX_WIDTH * length:
        said = (
            f"Link.second_moment_y + second_moment_z: {polar:g} (m^4) reaches {radius:.3g} m, a slip of units; in mm^4?"
        )
    elif torsion > MAX_TORSION * polar:
        said = f"Link.torsion_constant: {torsion:g} (m^4) exceeds the polar moment {polar:g}, a slip of units?"
    else:
        return
    warn_caller(said)


@dataclass(frozen=True)
class NonUniformLink:
    """A straight beam of uniform sections end to end, with their centroids on one line.

    Sections of different size make a stepped beam; many short ones approximate a tapered beam.

    Attributes:
        sections: 1 to 64 of Link, base to tip, each with its own length, cross-section and material; stored as a tuple.
        orientation: (3, 3) rotation, as of a Link. The orientation of each section must be the identity.
        masses: of LumpedMass, as of a Link, at positions along the link as a whole. The sections have none.

    Raises:
        ValueError: for sections that are not links, a section with an orientation or masses, an orientation that is not
            a rotation within 1e-9, and for a mass beyond the tip.
    """

    sections: Sequence[Link]
    orientation: Matrix = IDENTITY
    masses: Sequence[LumpedMass] = ()

    def __post_init__(self) -> None:
        sections = instances("NonUniformLink.sections", self.sections, Link)
        if len(sections) > MAX_SECTIONS:
            raise value_error("NonUniformLink.sections", f"{len(sections)} sections", f"at most {MAX_SECTIONS}")
        for i, section in enumerate(sections):
            if section.orientation != IDENTITY:
                allowed = "the identity; the link as a whole has an orientation"
                raise value_error(f"NonUniformLink.sections[{i}].orientation", section.orientation, allowed)
            if section.masses:
                allowed = "none; the link as a whole has masses"
                raise value_error(f"NonUniformLink.sections[{i}].masses", section.masses, allowed)
        set_fields(self, sections=sections, orientation=rotation("NonUniformLink.orientation", self.orientation))
        set_fields(self, masses=_lumped_masses("NonUniformLink.masses", self.masses, self.length))

    @property
    def length(self) -> float:
        """Length of the link, the sum of the lengths of its sections, m."""
        return sum(section.length for section in self.sections)

    @property
    def mass(self) -> float:
        """Mass of the link with its lumped masses, kg."""
        return sum(section.mass for section in self.sections) + _total_mass(self.masses)
