"""Links: uniform and stepped beams, with lumped masses clamped to them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from flexman_gym.common.arrays import Matrix, Vector
from flexman_gym.common.checks import (
    MAX_SIZE,
    check_magnitudes,
    non_negative,
    physical,
    rotation,
    sequence,
    set_fields,
    value_error,
    vector,
)
from flexman_gym.scene.mistakes import check_keywords, warn_caller, warn_of_section, warn_of_units
from flexman_gym.scene.section import Outline, check_outline, find_material, round_outline, strip_outline


def rigid_body_fields(name: str, inertia: Matrix | None, offset: Vector | None) -> dict[str, Any]:
    """Gives the inertia and the offset of a rigid body as they are stored; None stays None.

    Raises:
        ValueError: for an inertia that no rigid body has, and for an offset that is not three numbers up to 1e30.
    """
    if inertia is not None:
        inertia = _inertia_matrix(f"{name}.inertia", inertia)
    if offset is not None:
        offset = vector(f"{name}.offset", offset, 3, "m")
        check_magnitudes(f"{name}.offset", offset, MAX_SIZE, "m")
    return {"inertia": inertia, "offset": offset}


def _inertia_matrix(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    """Gives the (3, 3) inertia of a rigid body in kg m^2 as a tuple of rows.

    It is symmetric, its principal moments are not negative, and none exceeds the sum of the other two.

    Raises:
        ValueError: for anything else.
    """
    allowed = "a symmetric inertia (kg m^2) whose principal moments are >= 0, none above the sum of the others"
    rows = sequence(name, value, "3 rows of 3 numbers")
    if len(rows) != 3:
        raise value_error(name, value, "3 rows of 3 numbers")
    rows = tuple(vector(f"{name}[{i}]", row, 3) for i, row in enumerate(rows))
    matrix = np.array(rows)
    if not np.array_equal(matrix, matrix.T):
        raise value_error(name, value, allowed)
    moments = np.linalg.eigvalsh(matrix)
    rounding = 1e-12 * max(abs(moments))
    if moments[0] < -rounding or moments[2] > moments[0] + moments[1] + rounding:
        raise value_error(name, value, allowed)
    return rows


MAX_MASSES = 64  # on a link


@dataclass(frozen=True)
class LumpedMass:
    """A point mass or a rigid body that is clamped to one section of a link.

    Inertia and offset are in the link's own frame. The body stiffens nothing.

    Attributes:
        mass: kg.
        position: of its section along the link, from the joint, m.
        inertia: (3, 3) about the centre of mass, kg m^2; None for a point mass.
        offset: (3,) from the axis at its section to the centre of mass, m; None for a centre on the axis.

    Raises:
        ValueError: for a mass that is not positive, a position that is negative, and an inertia that no rigid body has.
    """

    mass: float
    position: float
    inertia: Matrix | None = None
    offset: Vector | None = None

    def __post_init__(self) -> None:
        set_fields(
            self,
            mass=physical("LumpedMass.mass", self.mass, "kg"),
            position=non_negative("LumpedMass.position", self.position, "m"),
            **rigid_body_fields("LumpedMass", self.inertia, self.offset),
        )


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


def total_mass(masses: Sequence[LumpedMass]) -> float:
    """Gives the mass of them all, kg."""
    return sum(mass.mass for mass in masses)


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
            check_outline(self.outline, vars(self))
        warn_of_units("Link", vars(self))
        polar, least = self.second_moment_y + self.second_moment_z, self.area * self.area / (2.0 * math.pi)
        if polar < (1.0 - 1e-9) * least:
            warn_caller(
                f"Link.second_moment_y + second_moment_z: {polar:.6g} is less than any section of the area "
                f"{self.area:.6g} m^2 has; the least is {least:.6g} (m^4), area^2 / (2 pi) of a solid disc"
            )
        warn_of_section(self.length, self.area, polar, self.torsion_constant)

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
            material: "aluminium", "steel" or "titanium", whose numbers `scene.section.find_material` gives with their
                source; or three numbers: Young's modulus (Pa), shear modulus (Pa) and density (kg/m^3).
            orientation: as of any Link.
            masses: as of any Link.

        Raises:
            ValueError: for a size that is not positive, a thickness above the width, another axis or material.

        Examples:
            >>> ruler = fm.Link.strip(length=0.8, width=0.05, thickness=0.001)
            >>> round(ruler.mass, 3)
            0.108
        """
        return cls._outlined(length, strip_outline(width, thickness, thin), material, orientation, masses)

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
        return cls._outlined(length, round_outline(diameter, wall), material, orientation, masses)

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
        return cls._outlined(length, round_outline(diameter), material, orientation, masses)

    @classmethod
    def _outlined(
        cls, length: float, outline: Outline, material: Any, orientation: Matrix, masses: Sequence[LumpedMass]
    ) -> Self:
        names = ("area", "second_moment_y", "second_moment_z", "torsion_constant")
        numbers = {name: getattr(outline, name) for name in names}
        whole = find_material(material)._asdict()
        return cls(length, orientation=orientation, masses=masses, outline=outline, **numbers, **whole)

    def __repr__(self) -> str:
        if self.outline is None:
            shown = (each for each in fields(self) if getattr(self, each.name) != each.default)
            return f"Link({', '.join(f'{each.name}={getattr(self, each.name)!r}' for each in shown)})"
        moduli = f"E {self.youngs_modulus:g} Pa, G {self.shear_modulus:g} Pa, {self.density:g} kg/m^3"
        carried = f", lumped masses of {total_mass(self.masses):g} kg" if self.masses else ""
        return f"<Link: a {self.outline.shape} {self.length:g} m long, {self.outline.words}\n  {moduli}{carried}>"

    @property
    def mass(self) -> float:
        """Mass of the link with its lumped masses, kg."""
        return self.density * self.area * self.length + total_mass(self.masses)

    @property
    def sections(self) -> tuple["Link", ...]:
        """The link itself, as its only section."""
        return (self,)


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
        return sum(section.mass for section in self.sections) + total_mass(self.masses)


def instances(name: str, value: object, *kinds: type) -> tuple[Any, ...]:
    """Gives a list of at least one item, each of one of the `kinds`, as a tuple."""
    names = " or ".join(kind.__name__ for kind in kinds)
    items = sequence(name, value, f"at least one {names}")
    if not items:
        raise value_error(name, value, f"at least one {names}")
    for i, item in enumerate(items):
        if not isinstance(item, kinds):
            raise value_error(f"{name}[{i}]", item, f"a {names}")
    return tuple(items)
