"""Randomisation: ranges of physical parameters and disturbances, from which each episode is drawn."""

from typing import Any

from flexman_gym.common.checks import non_negative, positive, vector
from flexman_gym.common.errors import keyword_error, suggestion, value_error
from flexman_gym.envs.effects import SIGNALS, Range
from flexman_gym.simulation.physical_parameters import PARAMETERS

DEFAULT_IMPULSE_GAP = 2.0  # s; mean time between two impulses or changes of load


class Randomisation:
    """Domain randomisation: ranges (low, high) from which every episode draws uniformly; None disables a range.

    Each parameter and each effect has a separate random generator, seeded by its name and the seed of the environment,
    so that enabling one of them changes neither the other draws nor start and goal. The draws of an episode do not
    depend on earlier episodes.

    Args:
        impulse_gap: mean time between two impulses, or two changes of load, s; at least a control period. None for 2 s.
        **ranges: name -> (low, high). Physical parameters of `physical_parameters.PARAMETERS`: payload_mass (kg),
            joint_damping (N m s/rad), joint_stiffness_factor, rotor_inertia_factor, viscous_friction_factor,
            coulomb_friction_factor, coulomb_rate and stribeck_rate (rad/s), static_excess, backlash (rad),
            soft_stiffness, ripple_torque (N m), link_stiffness_factor and link_damping_factor. A factor is > 0, or >= 0
            for friction and damping, and multiplies the nominal value of each joint or link. Effects (disturbances) of
            `envs.effects.SIGNALS`: torque_limit_factor (also a wrong torque constant of the motors), gauge_gain_factor
            (of each strain gauge), sensor_noise (standard deviation as a fraction of the measurement range),
            sensor_bias (of each measured quantity, a fraction of its range of either sign), dropped_samples
            (probability that a sensor loses a sample), delay (whole control periods), initial_vibration (m),
            tip_impulse (N s), tip_load (N) and base_sway (m/s^2).

    Attributes:
        effects: names of the enabled parameters and effects, in the order of PARAMETERS and SIGNALS.
        ranges: name of a parameter or effect -> (low, high), without the disabled ones of the argument `ranges` and
            without the suffix "_factor". Each range is also an attribute, None by default.
        given: arguments of the constructor by name.

    Examples:
        >>> import gymnasium as gym
        >>> ranges = fm.Randomisation(payload_mass=(0.0, 0.2), delay=(0, 2))
        >>> env = gym.make("FlexOne-v0", randomisation=ranges)
        >>> _, info = env.reset(seed=0)
        >>> sorted(info["drawn"]), 0.0 <= info["drawn"]["payload_mass"] <= 0.2
        (['delay', 'payload_mass'], True)
    """

    def __init__(self, *, impulse_gap: float | None = None, **ranges: Any) -> None:
        self.impulse_gap = (
            DEFAULT_IMPULSE_GAP if impulse_gap is None else positive("Randomisation.impulse_gap", impulse_gap, "s")
        )
        known = (*_range_names(), "impulse_gap")
        for name in ranges:
            if name not in known:
                allowed = f"a range of help(fm.Randomisation){suggestion(name, known)}"
                raise keyword_error("randomisation", name, allowed, name)
        self.given = ranges if impulse_gap is None else {**ranges, "impulse_gap": self.impulse_gap}
        given = {name: effect for name, effect in _range_names().items() if ranges.get(name) is not None}
        self.ranges = {effect: _range(name, ranges[name]) for name, effect in given.items()}
        self.effects = tuple(self.ranges)

    def __getattr__(self, name: str) -> Range | None:
        if name in _range_names():
            return self.ranges.get(_range_names()[name])
        raise AttributeError(name)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Randomisation):
            return False
        return (self.ranges, self.impulse_gap) == (other.ranges, other.impulse_gap)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        enabled = {name: self.ranges[effect] for name, effect in _range_names().items() if effect in self.ranges}
        given = enabled | {"impulse_gap": self.impulse_gap}
        return f"Randomisation({', '.join(f'{name}={value!r}' for name, value in given.items())})"

    @staticmethod
    def range_name(effect: str) -> str:
        """Return the name of the range of a parameter or effect: NAME_factor for factors on the nominal value."""
        entry = PARAMETERS[effect] if effect in PARAMETERS else SIGNALS[effect]
        return f"{effect.removesuffix('_factor')}_factor" if getattr(entry, "factor", False) else effect


def _range(name: str, value: object) -> Range:
    """Return a range after a check."""
    field, effect = f"Randomisation.{name}", _range_names()[name]
    low, high = vector(field, value, 2)
    if effect in SIGNALS:
        low, high = (SIGNALS[effect].checked(field, each) for each in value)  # type: ignore[attr-defined]
    else:
        low, high = (
            (non_negative if PARAMETERS[effect].may_be_zero else positive)(field, each) for each in (low, high)
        )
    if low > high:
        raise value_error(field, value, "a range (low, high) with low <= high, or None")
    return low, high


def _range_names() -> dict[str, str]:
    """Return name of a range -> name of its parameter or effect."""
    return {Randomisation.range_name(name): name for name in (*PARAMETERS, *SIGNALS)}
