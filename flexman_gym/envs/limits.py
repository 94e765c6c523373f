"""Limits of the motion of an arm."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from functools import partial
from typing import Any, Self

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.common.checks import mapping, non_negative, one_of, positive, sequence, set_fields, vector
from flexman_gym.common.errors import value_error
from flexman_gym.envs.view import View
from flexman_gym.kernels.control_period import sparse_product
from flexman_gym.kernels.layout import TIP, TIP_VELOCITY
from flexman_gym.model.linearization import LinearMeasurements, sparse_rows
from flexman_gym.model.model import Model
from flexman_gym.scene.material import YIELD_STRAINS

ON_VIOLATION = ("end", "cost", "record")  # values of Limits.on_violation
UNITS = {
    "angle": "rad", "rate": "rad/s", "twist": "rad", "deflection": "of the length", "deflection_rate": "m/s",
    "tip_speed": "m/s", "strain": "m/m", "spring_torque": "N m", "workspace": "m",
}  # fmt: skip
MODEL_LIMITS = tuple(UNITS)[:6]  # limits beyond which the model is not valid; their values have a default
GAUGE_SHARE = 0.5  # smallest strain at the gauges / strain at the surface: radius of gyration / radius of a solid rod
REGIONS = {  # shape of a region of the workspace -> its two values
    "half_space": "[normal (3 numbers), offset (m)], for normal . tip <= offset",
    "box": "[low (3 numbers, m), high (3 numbers, m)] with low < high",
    "sphere": "[centre (3 numbers, m), radius (m) > 0]",
}


@dataclass(frozen=True)
class Limits:
    """Limits of the motion of an arm.

    The model is not valid beyond the limits from `angle` to `tip_speed`; an episode terminates when one of them is
    exceeded. The limits `strain`, `spring_torque` and `workspace` and all margins protect the arm. They are compared at
    the end of every control period, and `on_violation` is the consequence of a violation. All limits are compared with
    the true state, not with measurements.

    With one of these three limits or a margin, `info["limits"]` maps each limit to its distances: limit - margin -
    magnitude of the quantity in the unit of the limit, one for each scalar quantity, negative in a violation.
    `info["cost"]` is the number of control periods of the step with a violation: 0.0 or 1.0 without action repeat, and
    always 0.0 for on_violation="record". The task draws starts and goals again until they are in the workspace.

    Attributes:
        angle: largest magnitude of a motor angle, rad.
        rate: largest magnitude of a motor rate and of the rate of a joint twist, rad/s.
        twist: largest magnitude of a joint twist (elastic deflection of the joint: motor angle minus link-side angle),
            rad.
        deflection: largest deflection of the tip of a link, as a fraction of the length of the link.
        deflection_rate: largest rate of the deflection of the tip of a link, m/s.
        tip_speed: largest speed of the tip along each base axis, m/s.
        strain: largest magnitude of the bending and shear strains at the root of a link, m/m, see `View.root_strains`:
            one number, one for each link, or the name of a material ("aluminium", "steel", "titanium") for half of its
            yield strength / Young's modulus. The half is the ratio of the strains at gauge and surface of a solid rod;
            the ratio of all other usual sections is larger. None for no limit.
        spring_torque: largest magnitude of the torque of a joint spring, N m: one number, or one for each joint. None
            for no limit.
        workspace: regions that contain the tip (base frame, m), a list of mappings {"half_space": [normal, offset]}
            (normal . tip <= offset), {"box": [low, high]} and {"sphere": [centre, radius]}. None for no limit.
        margin: mapping of names of limits to margins, subtracted from the limits, in the units of the limits.
        on_violation: "end" to terminate the episode, "cost" to count the violation in `info["cost"]`, "record" for the
            distances only.

    Examples:
        >>> import gymnasium as gym
        >>> floor = {"half_space": [[0, 0, -1], 0.5]}  # z >= -0.5 m
        >>> limits = fm.Limits(strain=1e-4, workspace=[floor], margin={"strain": 1e-5}, on_violation="cost")
        >>> env = gym.make("FlexOne-v0", limits=limits)
        >>> info = env.reset(seed=0)[1]
        >>> info["limits"]["strain"], info["limits"]["workspace"], info["cost"]
        (array([9.e-05, 9.e-05, 9.e-05]), array([0.5]), 0.0)
    """

    angle: float = 4.0
    rate: float = 10.0
    twist: float = 1.0
    deflection: float = 0.25
    deflection_rate: float = 15.0
    tip_speed: float = 40.0
    strain: float | tuple[float, ...] | str | None = None
    spring_torque: float | tuple[float, ...] | None = None
    workspace: Any = None
    margin: Any = None
    on_violation: str = "end"

    def __post_init__(self) -> None:
        set_fields(self, **{name: positive(f"Limits.{name}", getattr(self, name)) for name in MODEL_LIMITS})
        strain = self.strain
        if isinstance(strain, str):
            strain = GAUGE_SHARE * YIELD_STRAINS[one_of("Limits.strain", strain, YIELD_STRAINS)]
        set_fields(
            self,
            strain=_one_or_each("Limits.strain", strain, "m/m"),
            spring_torque=_one_or_each("Limits.spring_torque", self.spring_torque, "N m"),
            workspace=_regions(self.workspace),
            margin=self._margins(),
            on_violation=one_of("Limits.on_violation", self.on_violation, ON_VIOLATION),
        )

    def _margins(self) -> dict[str, float] | None:
        """Return the margins by name after a check; None without a margin."""
        names = [name for name in UNITS if getattr(self, name) is not None]
        given = {} if self.margin is None else mapping("Limits.margin", self.margin, names)
        for name, value in given.items():
            limit, margin = getattr(self, name), non_negative(f"Limits.margin.{name}", value, UNITS[name])
            if name != "workspace" and not margin < np.min(limit):
                raise value_error(f"Limits.margin.{name}", value, f"a number below the limit, {limit} ({UNITS[name]})")
        return {name: float(value) for name, value in given.items()} or None

    @classmethod
    def find(cls, value: object) -> Self:
        """Return Limits from a mapping of its arguments; a Limits object is returned unchanged."""
        if isinstance(value, cls):
            return value
        names = [each.name for each in fields(cls)]
        if not isinstance(value, dict):
            raise value_error("limits", value, f"a mapping with some of {', '.join(names)}, or Limits")
        return cls(**mapping("limits", value, names))

    def to_plain(self) -> dict[str, Any]:
        """Return the arguments as JSON-compatible data, without arguments that have the default None or "end"."""
        return {name: value for name, value in asdict(self).items() if value not in (None, "end")}

    @property
    def recorded(self) -> bool:
        """True with a limit of strain, spring torque or workspace, or with a margin."""
        return any(each is not None for each in (self.strain, self.spring_torque, self.workspace, self.margin))

    def check_joints(self, joints: int) -> None:
        """Raise ValueError for a list whose length differs from the number of joints of the arm."""
        for name in ("strain", "spring_torque"):
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) != joints:
                raise value_error(f"limits.{name}", list(value), f"one number, or one for each of the {joints} joints")

    def bounds(self, view: View) -> dict[str, Array]:
        """Return name -> (size,) largest magnitude of each value of a quantity in `view.motion`."""
        sizes = {name: columns.stop - columns.start for name, columns in view.slices.items()}
        values = {
            "motor_angles": self.angle,
            "motor_rates": self.rate,
            "joint_twists": self.twist,
            "joint_twist_rates": self.rate,
            "link_deflections": self.deflection * np.repeat(view.lengths, 2),
            "link_deflection_rates": self.deflection_rate,
            "tip_velocity": self.tip_speed,
        }
        return {name: np.ones(size) * np.asarray(values[name]) for name, size in sizes.items()}

    def distances(self, view: View) -> dict[str, Array]:
        """Return limit -> distances (..., m) of its m quantities from the limit minus its margin, in UNITS.

        The quantities are linear in the state (strains, and torques of linear springs) except for tip speed and
        workspace; `fm.linearize` returns their matrices.
        """
        linear = self.linear_quantities(partial(getattr, view), view.lengths)
        values = {"tip_speed": view.tip_velocity, **linear}
        values = {name: values[name] for name in UNITS if name in values}
        if self.spring_torque is not None:
            values["spring_torque"] = view.spring_torques
        result = {name: self._scale(name, view) - np.abs(value) for name, value in values.items()}
        if self.workspace is not None:
            result["workspace"] = self.depths(view.tip)
        for name, margin in (self.margin or {}).items():
            result[name] = result[name] - margin
        return result

    def linear_quantities(self, read: Callable[[str], Array], lengths: Array) -> dict[str, Array]:
        """Return limit -> quantities (..., m) that are linear in the state for all arms.

        Args:
            read: function of the name of a measurement in `model.linearization.MEASUREMENT_UNITS` that returns it.
            lengths: (n,) lengths of the links, m.
        """
        result = {
            "angle": read("motor_angles"),
            "rate": np.concatenate([read("motor_rates"), read("joint_twist_rates")], axis=-1),
            "twist": read("joint_twists"),
            "deflection": read("link_deflections") / np.repeat(lengths, 2),
            "deflection_rate": read("link_deflection_rates"),
        }
        if self.strain is not None:
            result["strain"] = read("root_strains")
        return result

    def predicted(self, model: Model) -> "LimitShares":
        """Return the quantities with limits as functions of states, for `toolbox.safety.safety_filter`."""
        return LimitShares(self, model)

    def excess(self, view: View) -> Array:
        """Return the largest excess (b,) beyond limits minus margins, 1; negative if all of them are satisfied.

        The excess is a fraction of the limit, for the workspace a fraction of the reach.
        """
        parts = [-each / self._scale(name, view) for name, each in self.distances(view).items()]
        return np.asarray(np.concatenate(parts, axis=-1).max(axis=-1))

    def strain_share(self, view: View) -> Array:
        """Return the largest strain of each arm as a fraction of its limit, (b,)."""
        return np.asarray((np.abs(view.root_strains) / self._scale("strain", view)).max(axis=-1))

    def contains(self, tips: Array) -> bool:
        """Return True if all tips (r, 3), m, are in the workspace minus its margin."""
        margin = (self.margin or {}).get("workspace", 0.0)
        return self.workspace is None or bool((self.depths(tips) >= margin).all())

    def violation(self, view: View, arm: int) -> str:
        """Describe the first violation of an arm for on_violation="end"; "" if there is none."""
        if self.recorded and self.on_violation == "end":
            for name, each in self.distances(view).items():
                if not (each[arm] >= 0.0).all():
                    return f"{name} beyond its limit by {-each[arm].min():.4g} {UNITS[name]}"
        return ""

    def _scale(self, name: str, view: View) -> Any:
        """Return the limit of a quantity, a number or (m,); for the workspace the reach of the arm, m."""
        return view.reach if name == "workspace" else self.of_quantities(name)

    def of_quantities(self, name: str) -> Array:
        """Return a limit but the workspace as a number or (m,), for its m quantities; in UNITS."""
        value = getattr(self, name)
        return np.repeat(value, 3) if name == "strain" and isinstance(value, tuple) else np.asarray(value)

    def depths(self, tips: Array) -> Array:
        """Return the distances (..., k), m, of tips (..., 3) from the boundaries of k regions, negative outside."""
        result = []
        for region in self.workspace:
            [(shape, (first, second))] = region.items()
            if shape == "half_space":
                length = np.sqrt(np.sum(np.square(first)))
                result.append((second - np.sum(tips * np.array(first), axis=-1)) / length)
            elif shape == "box":
                result.append(np.minimum(tips - np.array(first), np.array(second) - tips).min(axis=-1))
            else:
                result.append(second - np.sqrt(np.sum((tips - np.array(first)) ** 2, axis=-1)))
        return np.stack(result, axis=-1)

    @staticmethod
    def describe(values: Array, bound: Array, slices: dict[str, slice], units: dict[str, str]) -> str:
        """Return name, value, unit and bound of the first value beyond its bound as text; "" if there is none.

        Args:
            values: (size,) values.
            bound: (size,) largest magnitudes.
            slices: name of a quantity -> slice of the values.
            units: name of a quantity -> unit.
        """
        inside = np.abs(values) <= bound
        if inside.all():
            return ""
        first = int(np.argmin(inside))
        name = next(name for name, columns in slices.items() if first < columns.stop)
        return f"{name} {values[first]:.4g} {units[name]} beyond {bound[first]:.4g}"


class LimitShares:
    """Quantities of an arm as fractions of their limits minus margins, computed from states.

    A torque of a spring with backlash or stiffness pieces is bounded by that of a spring with its largest stiffness.

    Args:
        limits: limits of the arm.
        model: model of the arm.
    """

    def __init__(self, limits: Limits, model: Model) -> None:
        measured = LinearMeasurements(model).measure(np.eye(2 * model.n_dof))
        self._limits, self._margins, self._reach = limits, limits.margin or {}, float(model.constants.length.sum())
        rows = limits.linear_quantities(measured.__getitem__, model.constants.length)
        bounds = [self._bound(name) * np.ones(each.shape[1]) for name, each in rows.items()]
        scaled = np.hstack(list(rows.values())) / np.concatenate(bounds)
        self._rows = sparse_rows(scaled.T)
        slopes = [
            np.abs(np.cumsum(each)).max(initial=1.0)
            for each in np.split(model.constants.knee_share, model.constants.knee_start[1:-1])
        ]
        self._twists = sparse_rows(measured["joint_twists"].T)
        self._slopes: Array = np.array(slopes)

    def _bound(self, name: str) -> Any:
        """Return a limit minus its margin, a number or (m,)."""
        return self._limits.of_quantities(name) - self._margins.get(name, 0.0)

    def shares(self, states: Array, outputs: Array, stiffness: Array) -> Array:
        """Return quantities as fractions (k, T, m) of their limits; see `PredictedLimits` of the safety filter."""
        (k, periods), flat = states.shape[:2], states.reshape(-1, states.shape[2])
        parts = [_product(self._rows, flat).reshape(k, periods, -1)]
        parts.append(outputs[..., TIP_VELOCITY] / self._bound("tip_speed"))
        if self._limits.spring_torque is not None:
            torques = _product(self._twists, flat).reshape(k, periods, -1) * (self._slopes * stiffness)[:, None]
            parts.append(torques / self._bound("spring_torque"))
        if self._limits.workspace is not None:
            depths = self._limits.depths(outputs[..., TIP]) - self._margins.get("workspace", 0.0)
            parts.append(np.maximum(1.0 - depths / self._reach, 0.0))
        return np.concatenate(parts, axis=2)


def _product(rows: tuple[IntArray, IntArray, Array], states: Array) -> Array:
    """Return the products (r, m) of a sparse matrix (m, 2 d), see `sparse_rows`, with states (r, 2 d)."""
    result = np.zeros((len(states), len(rows[0]) - 1))
    sparse_product(states, *rows, result)
    return result


def _one_or_each(name: str, value: Any, unit: str) -> float | tuple[float, ...] | None:
    """Return a positive number, or a tuple of positive numbers; None is returned unchanged."""
    if value is None:
        return None
    if not isinstance(value, list | tuple | np.ndarray):
        return positive(name, value, unit)
    entries = sequence(name, value, f"numbers > 0 ({unit})")
    if not entries:
        raise value_error(name, value, f"a number > 0 ({unit}), or one for each joint")
    return tuple(positive(f"{name}[{i}]", entry, unit) for i, entry in enumerate(entries))


def _regions(value: Any) -> tuple[dict[str, Any], ...] | None:
    """Return the regions of a workspace after a check, with tuples of numbers."""
    if value is None:
        return None
    name, allowed = "Limits.workspace", f"a list of mappings with one of {', '.join(REGIONS)}"
    entries = sequence(name, value, allowed)
    if not entries:
        raise value_error(name, value, allowed)
    return tuple(_region(f"{name}[{i}]", entry) for i, entry in enumerate(entries))


def _region(name: str, value: object) -> dict[str, tuple[Vector, Any]]:
    """Return a region {shape: (first, second)} of a workspace after a check, see REGIONS."""
    given = mapping(name, value, REGIONS)
    if len(given) != 1:
        raise value_error(name, value, f"a mapping with one of {', '.join(REGIONS)}")
    [(shape, pair)] = given.items()
    name = f"{name}.{shape}"
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        raise value_error(name, pair, REGIONS[shape])
    first, second = vector(f"{name}[0]", pair[0], 3), pair[1]
    if shape == "box":
        second = vector(f"{name}[1]", second, 3, "m")
        if not all(low < high for low, high in zip(first, second, strict=True)):
            raise value_error(name, pair, REGIONS[shape])
    elif shape == "sphere":
        second = positive(f"{name}[1]", second, "m")
    else:
        (second,) = vector(f"{name}[1]", [second], 1, "m")
        if not any(first):
            raise value_error(f"{name}[0]", first, "a normal other than zero")
    return {shape: (first, second)}
