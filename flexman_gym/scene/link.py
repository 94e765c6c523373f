"""Link: a straight beam, uniform or of several sections, as a person describes it, in SI units."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

from flexman_gym.arrays import Matrix
from flexman_gym.checks import physical, refusal, rotation, sequence, store
from flexman_gym.scene.guesses import answer_guesses
from flexman_gym.scene.lumped import LumpedMass, lumped_masses, total_mass
from flexman_gym.scene.sections import Outline, check_outline, material_of, round_outline, strip_outline
from flexman_gym.scene.slips import warn, warn_of_section, warn_of_slips

MOST_SECTIONS = 64  # of a link, as a model has at most so many finite elements of it
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


@answer_guesses
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
        store(self, **{name: physical(f"Link.{name}", getattr(self, name), unit) for name, unit in _LINK_UNITS.items()})
        store(self, orientation=rotation("Link.orientation", self.orientation))
        store(self, masses=lumped_masses("Link.masses", self.masses, self.length))
        if self.outline is not None:
            check_outline(self.outline, vars(self))
        warn_of_slips("Link", vars(self))
        polar, least = self.second_moment_y + self.second_moment_z, self.area * self.area / (2.0 * math.pi)
        if polar < (1.0 - 1e-9) * least:
            warn(
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
            material: "aluminium", "steel" or "titanium", whose numbers `scene.sections.material_of` gives with their
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
        whole = material_of(material)._asdict()
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
        sections = chain("NonUniformLink.sections", self.sections, Link)
        if len(sections) > MOST_SECTIONS:
            raise refusal("NonUniformLink.sections", f"{len(sections)} sections", f"at most {MOST_SECTIONS}")
        for i, section in enumerate(sections):
            if section.orientation != IDENTITY:
                allowed = "the identity; the link as a whole has an orientation"
                raise refusal(f"NonUniformLink.sections[{i}].orientation", section.orientation, allowed)
            if section.masses:
                allowed = "none; the link as a whole has masses"
                raise refusal(f"NonUniformLink.sections[{i}].masses", section.masses, allowed)
        store(self, sections=sections, orientation=rotation("NonUniformLink.orientation", self.orientation))
        store(self, masses=lumped_masses("NonUniformLink.masses", self.masses, self.length))

    @property
    def length(self) -> float:
        """Length of the link, the sum of the lengths of its sections, m."""
        return sum(section.length for section in self.sections)

    @property
    def mass(self) -> float:
        """Mass of the link with its lumped masses, kg."""
        return sum(section.mass for section in self.sections) + total_mass(self.masses)


def chain(name: str, value: object, *kinds: type) -> tuple[Any, ...]:
    """Gives a list of at least one item, each of one of the `kinds`, as a tuple."""
    names = " or ".join(kind.__name__ for kind in kinds)
    items = sequence(name, value, f"at least one {names}")
    if not items:
        raise refusal(name, value, f"at least one {names}")
    for i, item in enumerate(items):
        if not isinstance(item, kinds):
            raise refusal(f"{name}[{i}]", item, f"a {names}")
    return tuple(items)
