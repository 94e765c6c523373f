"""Links: cross-sections, materials, uniform and stepped beams, and their lumped masses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from flexman_gym.common.arrays import Matrix, Vector
from flexman_gym.common.checks import (
    UNIT_TOLERANCE,
    flag,
    instance,
    instances,
    one_of,
    physical,
    sequence,
    set_fields,
    vector,
)
from flexman_gym.common.errors import value_error, warn_caller
from flexman_gym.scene.input_checks import check_keywords, warn_unusual_units
from flexman_gym.scene.material import find_material
from flexman_gym.scene.rigid_body import LumpedMass

SHAPES = ("strip", "tube", "rod")
# fields of a link that follow from the outline of its cross-section
SIZES = ("area", "second_moment_y", "second_moment_z", "torsion_constant")
OTHER_AXIS = {"y": "z", "z": "y"}
OUTLINE_TOLERANCE = 1e-6  # largest relative difference between the values of a link and those of its outline
SERIES_TERMS = 60  # terms of the series for the torsion constant of a rectangle; 30 are exact to rounding


@dataclass(frozen=True)
class Outline:
    """Outline of a cross-section, centred on the axis of its link, along the y and z axes of the link.

    Attributes:
        shape: "strip" (rectangle), "tube" (hollow circle) or "rod" (solid circle).
        y: outer dimension along y, m.
        z: outer dimension along z, m; equal to y for a tube or rod.
        wall: wall thickness of a tube, m, at most half of its diameter; None for the other shapes.
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
    def inner_diameter(self) -> float:
        """Inner diameter of a tube, m; 0 for the other shapes."""
        return self.y - 2.0 * self.wall if self.wall else 0.0

    @property
    def area(self) -> float:
        """Area of the cross-section, m^2."""
        if self.shape == "strip":
            return self.y * self.z
        return math.pi / 4.0 * (self.y + self.inner_diameter) * (self.y - self.inner_diameter)

    @property
    def second_moment_y(self) -> float:
        """Second moment of area about y, the integral of z^2 over the area, m^4."""
        return self.area * (self.z**2 / 12.0 if self.shape == "strip" else (self.y**2 + self.inner_diameter**2) / 16.0)

    @property
    def second_moment_z(self) -> float:
        """Second moment of area about z, the integral of y^2 over the area, m^4."""
        return self.area * (self.y**2 / 12.0 if self.shape == "strip" else (self.y**2 + self.inner_diameter**2) / 16.0)

    @property
    def torsion_constant(self) -> float:
        """Torsion constant J of St Venant, m^4.

        For a rectangle it is the series of Timoshenko and Goodier (Theory of Elasticity, article on the torsion of
        rectangular bars); for a circular section it equals the polar moment of area.
        """
        if self.shape != "strip":
            return 2.0 * self.second_moment_y
        thin, wide = sorted((self.y, self.z))
        odd = range(1, 2 * SERIES_TERMS, 2)
        series = sum(math.tanh(n * math.pi * wide / (2.0 * thin)) / n**5 for n in odd)
        return wide * thin**3 * (1.0 - 192.0 * thin * series / (math.pi**5 * wide)) / 3.0

    @property
    def sizes(self) -> dict[str, Any]:
        """SIZES of a link with this outline, by name."""
        return {name: getattr(self, name) for name in SIZES}

    @property
    def thin_axis(self) -> str:
        """Axis, "y" or "z", along which a strip is thin, y for a square; "" for the other shapes."""
        return "" if self.shape != "strip" else "y" if self.y <= self.z else "z"

    @property
    def description(self) -> str:
        """Text with the dimensions of the cross-section, and with the bending plane of least stiffness of a strip."""
        if self.shape != "strip":
            return f"{self.y:g} m across" + (f", wall {self.wall:g} m" if self.wall else "")
        sizes = f"{self.y:g} m along y, {self.z:g} m along z"
        if self.y == self.z:
            return sizes
        return f"{sizes}: thin along {self.thin_axis}, it bends easily in its x-{self.thin_axis} plane"


def _strip_outline(width: float, thickness: float, thin: str) -> Outline:
    """Return the outline of a strip, thin along "y" or "z", from its width and thickness in m."""
    width, thickness = physical("Link.width", width, "m"), physical("Link.thickness", thickness, "m")
    if thickness > width:
        raise value_error("Link.thickness", thickness, f"at most the width {width} (m); thin sets its direction")
    sizes = {one_of("Link.thin", thin, OTHER_AXIS): thickness, OTHER_AXIS[thin]: width}
    return Outline("strip", sizes["y"], sizes["z"])


def _round_outline(diameter: float, wall: float | None = None) -> Outline:
    """Return the outline of a rod, or of a tube if a wall thickness is given; outer diameter and wall in m."""
    diameter = physical("Link.diameter", diameter, "m")
    if wall is None:
        return Outline("rod", diameter, diameter)
    if physical("Link.wall", wall, "m") > diameter / 2.0:
        raise value_error("Link.wall", wall, f"at most half of the diameter {diameter} (m)")
    return Outline("tube", diameter, diameter, wall)


def _check_outline(outline: object, numbers: dict[str, float]) -> None:
    """Check that an outline has the area and the second moments of area of its link."""
    checked = instance("Link.outline", outline, Outline, "an Outline or None")
    for name in SIZES[:3]:
        if not math.isclose(numbers[name], getattr(checked, name), rel_tol=OUTLINE_TOLERANCE):
            allowed = f"{getattr(checked, name):.6g}, the value of its outline, or a link without an outline"
            raise value_error(f"Link.{name}", numbers[name], allowed)


MAX_MASSES = 64  # largest number of lumped masses on a link


def _rotation(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    """Return a rotation matrix (3, 3), orthonormal within 1e-9 with determinant +1, as a tuple of rows."""
    rows = sequence(name, value, "3 rows of 3 numbers")
    if len(rows) != 3:
        raise value_error(name, value, "3 rows of 3 numbers")
    rows = tuple(vector(f"{name}[{i}]", row, 3) for i, row in enumerate(rows))
    matrix = np.array(rows)
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(matrix @ matrix.T - np.eye(3)).max()
    # Reflections are orthonormal, too, with determinant -1.
    if not error <= UNIT_TOLERANCE or np.linalg.det(matrix) < 0.0:
        raise value_error(name, value, "a rotation matrix: orthonormal within 1e-9, determinant +1")
    return rows


def _lumped_masses(name: str, value: object, length: float) -> tuple[LumpedMass, ...]:
    """Return the lumped masses of a link of a length (m) as a tuple after checking their number and positions."""
    masses = tuple(sequence(name, value, "LumpedMass"))
    if len(masses) > MAX_MASSES:
        raise value_error(name, f"{len(masses)} masses", f"at most {MAX_MASSES}")
    for i, mass in enumerate(masses):
        instance(f"{name}[{i}]", mass, LumpedMass, "a LumpedMass")
        if mass.position > length:
            raise value_error(f"{name}[{i}].position", mass.position, f"at most the length {length} of the link (m)")
    return masses


def _total_mass(masses: Sequence[LumpedMass]) -> float:
    """Return the sum of all lumped masses, kg."""
    return sum(mass.mass for mass in masses)


MAX_WIDTH = 5.0  # dimensionless; width of a cross-section / length of its link; above it the unit is probably wrong
MAX_TORSION = 10.0  # dimensionless; torsion constant / polar moment of area; above it the unit is probably wrong
NO_DENSITY = 1e-20  # kg/m^3; density of the beam of `Link.rigid`, whose mass is that of its lumped mass
MIN_DRAWN = 0.01  # m; a shorter `Link.rigid` is drawn as thick as one of this length
MAX_SECTIONS = 64  # largest number of sections of a link; each needs a finite element, and a link has at most 64
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

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
    """Straight uniform beam along the x axis of its own frame, from its joint to its tip.

    A UserWarning is issued if second_moment_y + second_moment_z is less than area^2 / (2 pi), the polar moment of a
    solid disc, which is the smallest of all cross-sections with the same area. Values that suggest a wrong unit also
    cause a UserWarning.

    Attributes:
        length: length, m; 0 is allowed for a rigid link.
        area: area of the cross-section, m^2.
        second_moment_y: second moment of area I_y about y, integral of z^2, m^4, for bending in the x-z plane.
        second_moment_z: second moment of area I_z about z, integral of y^2, m^4, for bending in the x-y plane.
        torsion_constant: torsion constant J in the torsional stiffness G J, m^4; I_y + I_z for a circular section.
        youngs_modulus: Young's modulus E, Pa.
        shear_modulus: shear modulus G, Pa.
        density: mass density, kg/m^3.
        orientation: rotation matrix (3, 3), orthonormal within 1e-9, whose columns are the beam axes in the joint
            frame; stored as rows of floats.
        masses: lumped masses on the link, a sequence of LumpedMass; stored as a tuple.
        outline: outline of the cross-section for plots; None if only the numbers above are known.
        flexible: False for a link that is rigid in every model, see `Link.rigid`.

    Raises:
        ValueError: for a number outside 1e-30 to 1e30, for an invalid rotation matrix, for a mass beyond the tip, and
            for an outline in contradiction to the area or the second moments of area.

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
    flexible: bool = True

    def __post_init__(self) -> None:
        set_fields(self, flexible=flag("Link.flexible", self.flexible))
        for name, unit in _LINK_UNITS.items():
            zero = name == "length" and not self.flexible
            set_fields(self, **{name: physical(f"Link.{name}", getattr(self, name), unit, zero)})
        set_fields(self, orientation=_rotation("Link.orientation", self.orientation))
        set_fields(self, masses=_lumped_masses("Link.masses", self.masses, self.length))
        if self.outline is not None:
            _check_outline(self.outline, vars(self))
        if not self.flexible:
            warn_unusual_units("Link", {"length": self.length} if self.length else {})
            return
        warn_unusual_units("Link", vars(self))
        polar, least = self.second_moment_y + self.second_moment_z, self.area * self.area / (2.0 * math.pi)
        if polar < (1.0 - 1e-9) * least:
            warn_caller(
                f"Link.second_moment_y + second_moment_z: {polar:.6g} (m^4) is impossible for an area of "
                f"{self.area:.6g} m^2; the smallest value is {least:.6g}, area^2 / (2 pi) of a solid disc"
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
        """Build a flat strip of rectangular cross-section, with its outline.

        With thin="y" the width is along z, and the strip bends easily in the x-y plane, like a ruler on its edge. With
        thin="z" the width is along y, and the strip bends easily in the x-z plane, like a diving board.

        Args:
            length: length, m.
            width: larger dimension of the cross-section, m.
            thickness: smaller dimension of the cross-section, m.
            thin: axis of the link along which the thickness is measured, "y" or "z".
            material: "aluminium" (6061-T6), "steel" (4130) or "titanium" (Ti-6Al-4V), with values from the data sheets
                of ASM (Aerospace Specification Metals); or Young's modulus (Pa), shear modulus (Pa) and density
                (kg/m^3).
            orientation: rotation matrix (3, 3), see `Link`.
            masses: lumped masses, see `Link`.

        Examples:
            >>> ruler = fm.Link.strip(length=0.8, width=0.05, thickness=0.001)
            >>> round(ruler.mass, 3)
            0.108
        """
        return cls._from_outline(
            length, _strip_outline(width, thickness, thin), material, orientation=orientation, masses=masses
        )

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
        """Build a round tube, with its outline.

        Args:
            length: length, m.
            diameter: outer diameter, m.
            wall: wall thickness, m, at most half of the diameter.
            material: name, or moduli and density, see `strip`.
            orientation: rotation matrix (3, 3), see `Link`.
            masses: lumped masses, see `Link`.

        Examples:
            >>> round(fm.Link.tube(1.0, diameter=0.05, wall=0.002).mass, 3)
            0.814
        """
        return cls._from_outline(
            length, _round_outline(diameter, wall), material, orientation=orientation, masses=masses
        )

    @classmethod
    def rod(
        cls,
        length: float,
        diameter: float,
        material: Any = "aluminium",
        orientation: Matrix = IDENTITY,
        masses: Sequence[LumpedMass] = (),
    ) -> Self:
        """Build a solid round rod, with its outline.

        Args:
            length: length, m.
            diameter: diameter, m.
            material: name, or moduli and density, see `strip`.
            orientation: rotation matrix (3, 3), see `Link`.
            masses: lumped masses, see `Link`.
        """
        return cls._from_outline(length, _round_outline(diameter), material, orientation=orientation, masses=masses)

    @classmethod
    def rigid(
        cls, length: float, mass: float, centre: Vector, inertia: Matrix | None = None, orientation: Matrix = IDENTITY
    ) -> Self:
        """Build a rigid link of given mass, centre of mass and inertia.

        Args:
            length: distance between its joint and its tip, along x, m; 0 if the next joint is at the same place.
            mass: kg.
            centre: (3,) centre of mass in the link frame, m.
            inertia: inertia matrix (3, 3) about the centre of mass, kg m^2; None for a point mass.
            orientation: rotation matrix (3, 3), see `Link`.

        Returns:
            The link, drawn as a rod.

        Examples:
            >>> upper_arm = fm.Link.rigid(0.4, 3.0, (0.2, 0.0, 0.0), [[0.01, 0, 0], [0, 0.05, 0], [0, 0, 0.05]])
            >>> upper_arm.mass
            3.0
        """
        x, y, z = vector("Link.rigid.centre", centre, 3, "m")
        position = min(max(x, 0.0), physical("Link.rigid.length", length, "m", zero=True))
        offset = (x - position, y, z)
        body = LumpedMass(mass, position, inertia, offset if any(offset) else None)
        outline = _round_outline(max(length, MIN_DRAWN) / 20.0)
        material = find_material("steel")._replace(density=NO_DENSITY)
        return cls._from_outline(length, outline, material, orientation=orientation, masses=(body,), flexible=False)

    @classmethod
    def _from_outline(cls, length: float, outline: Outline, material: Any, **rest: Any) -> Self:
        """Build a link from an outline, a material and further fields."""
        return cls(length, outline=outline, **outline.sizes, **find_material(material)._asdict(), **rest)

    def __repr__(self) -> str:
        if self.outline is None:
            shown = (field for field in fields(self) if getattr(self, field.name) != field.default)
            return f"Link({', '.join(f'{field.name}={getattr(self, field.name)!r}' for field in shown)})"
        moduli = f"E {self.youngs_modulus:g} Pa, G {self.shear_modulus:g} Pa, {self.density:g} kg/m^3"
        lumped = f", lumped masses of {_total_mass(self.masses):g} kg" if self.masses else ""
        return f"<Link: a {self.outline.shape} {self.length:g} m long, {self.outline.description}\n  {moduli}{lumped}>"

    @property
    def mass(self) -> float:
        """Mass of the link with its lumped masses, kg."""
        return self.density * self.area * self.length + _total_mass(self.masses)

    @property
    def sections(self) -> tuple["Link", ...]:
        """The link itself, as its only section."""
        return (self,)


def _warn_of_section(length: float, area: float, polar: float, torsion: float) -> None:
    """Warn (UserWarning) of a cross-section that is out of proportion to the length of its link.

    Args:
        length: length of the link, m.
        area: area, m^2.
        polar: polar moment of area I_y + I_z, m^4.
        torsion: torsion constant, m^4.
    """
    radius, width = math.sqrt(polar / area), math.sqrt(area)
    if width > MAX_WIDTH * length:
        line = f"Link.area: {area:g} (m^2) is too wide for the length; wrong unit? is it in mm^2, or the sizes in mm?"
    elif radius > MAX_WIDTH * length:
        line = (
            f"Link.second_moment_y + second_moment_z: {polar:g} (m^4) has a radius of gyration of {radius:.3g} m; "
            "wrong unit? is it in mm^4?"
        )
    elif torsion > MAX_TORSION * polar:
        line = f"Link.torsion_constant: {torsion:g} (m^4) exceeds the polar moment {polar:g}; wrong unit?"
    else:
        return
    warn_caller(line)


@dataclass(frozen=True)
class NonUniformLink:
    """Straight beam of uniform sections in series, with the centroids of all cross-sections on one line.

    Sections of different dimensions form a stepped beam; many short sections approximate a tapered beam.

    Attributes:
        sections: 1 to 64 instances of Link, from base to tip, each with its own length, cross-section and material;
            stored as a tuple. They have no lumped masses, and their orientation is the identity.
        orientation: rotation matrix (3, 3) of the whole link, see `Link`.
        masses: lumped masses at positions along the whole link, a sequence of LumpedMass; stored as a tuple.

    Raises:
        ValueError: for a section with an orientation or lumped masses, for an invalid rotation matrix, and for a mass
            beyond the tip.

    Examples:
        >>> thick, thin = fm.Link.rod(0.3, diameter=0.012), fm.Link.rod(0.2, diameter=0.008)
        >>> fm.NonUniformLink([thick, thin]).length
        0.5
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
                allowed = "the identity; give the orientation of the whole link"
                raise value_error(f"NonUniformLink.sections[{i}].orientation", section.orientation, allowed)
            if section.masses:
                allowed = "none; give the masses of the whole link"
                raise value_error(f"NonUniformLink.sections[{i}].masses", section.masses, allowed)
        set_fields(self, sections=sections, orientation=_rotation("NonUniformLink.orientation", self.orientation))
        set_fields(self, masses=_lumped_masses("NonUniformLink.masses", self.masses, self.length))

    @property
    def flexible(self) -> bool:
        """True: a link of sections is rigid only in a model with flexible_links=False."""
        return True

    @property
    def length(self) -> float:
        """Length of the link, the sum of the lengths of its sections, m."""
        return sum(section.length for section in self.sections)

    @property
    def mass(self) -> float:
        """Mass of the link with its lumped masses, kg."""
        return sum(section.mass for section in self.sections) + _total_mass(self.masses)
