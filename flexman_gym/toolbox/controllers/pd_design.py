"""Design of PD gains from the linearised, sampled loop, without simulation.

The cost of gains is the mean time that the tip of the linearised loop spends outside the settling band after each joint
is released at an angle away from the goal, at a few goals of the environment. The squared tip error is summed over
windows of 1, 1, 2, 4, ... control periods by the doubling iteration for the discrete Lyapunov equation (Smith, SIAM
Journal on Applied Mathematics 16, 1968, 198), whose partial sums are these windows. A quadratic cost of all times would
weight the first, unavoidable part of the motion; the time outside the band is nearly the settling time.

Three bounds represent what the linear loop lacks. Stiffness exceeds the Hessian of the weight's potential energy at any
posture, so that the goal is the only equilibrium (Takegaki and Arimoto, Journal of Dynamic Systems, Measurement, and
Control 103, 1981, 119). The torque left beside the weight is able to brake along the switching line of a saturated PD,
error = -(damping / stiffness) rate. Sampled loops have stability margins, with the largest delay and the lag of the
drives, see `toolbox.controllers.margins`.
"""

import json
from collections.abc import Iterator, Sequence
from functools import lru_cache

import gymnasium as gym
import numpy as np

from flexman_gym.agent.pd import stability_limit
from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import INTERFACE
from flexman_gym.metrics import BAND
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state, rigid_holding_torques
from flexman_gym.simulation.linearization import linearize
from flexman_gym.toolbox.controllers.margins import MIN_MARGINS, SampledLoop, has_margins, sampled_loops

POSTURES = 8  # number of goals at which the arm is linearised
RELEASE = 0.5  # rad; angle from which each joint is released; about the root mean square of slews up to SLEW
SLEW = 0.8  # rad; angle from which a joint brakes at the torque limit
MAX_STIFFNESS = 25.0  # torque limits per radian; largest stiffness
WEIGHT_FACTOR = 1.5  # dimensionless; least stiffness / largest Hessian of the weight's potential energy
WEIGHT_POSTURES = 32  # number of random postures for that Hessian
WEIGHT_STEP = 1e-3  # rad; step of its finite differences
LEAST_TORQUE = 0.05  # torque limits; least torque assumed to be left beside the weight
BANDWIDTHS = np.geomspace(0.2, 16.0, 16)  # first candidates; in units of the bandwidth at which a release saturates
DAMPING_RATIOS = (0.5, 1.0, 1.5)  # dimensionless; first candidates
DAMPING_SHARES = (0.95, 0.8, 0.65, 0.5, 0.35, 0.2, 0.1)  # largest damping; caps of the first candidates
FACTORS = (2.0, 1.4, 1.2)  # factors of the gains of one joint in successive rounds of the search
LEAST_GAIN, LEAST_ROUND = 1e-3, 1e-2  # least relative improvement of a change, and of all joints for another pass
MANTISSAS = (5.0, 2.0, 1.0)  # of the shorter control periods suggested by the error message
SHORTEST_SHARE = 1e-3  # control periods; shortest suggested period


def design_pd(configuration: Configuration) -> dict[str, tuple[float, ...]]:
    """Return PD gains for the arm of an environment, without simulation.

    Gains have three significant digits. Equal environments share one result, which is stored for the process.

    Args:
        configuration: environment with arm, control period, torque limits, and the largest delay and the lag of its
            drives.

    Returns:
        "stiffness" (n,), N m/rad, and "damping" (n,), N m s/rad, with the gain margin and the phase margin of
        MIN_MARGINS at goals of the environment.

    Raises:
        ValueError: if no gains have these margins at this control period; the message has a shorter period with gains.

    Examples:
        >>> from flexman_gym.envs.config.configuration import Configuration
        >>> found = fm.control.design_pd(Configuration("FlexOne-v0"))
        >>> [len(found[name]) for name in ("stiffness", "damping")]
        [1, 1]
    """
    environment = without_agent(configuration)
    try:
        plain = json.dumps(environment.to_plain(), sort_keys=True)
    except ValueError:  # an object of the user, such as a task, has no JSON-compatible data
        gains = PDDesign(environment).gains()
    else:
        gains = _stored_gains(plain)
    stiffness, damping = joint_gains(environment, np.array(np.split(gains, 2))).tolist()
    return {"stiffness": tuple(stiffness), "damping": tuple(damping)}


def joint_gains(environment: Configuration, of_motors: Array) -> Array:
    """Return the gains (k, n) of all joints, 0 for passive ones, from those of the motors (k, m)."""
    motors = [not joint.passive for joint in environment.arm.joints]
    result = np.zeros((len(of_motors), len(motors)))
    result[:, motors] = of_motors
    return result


@lru_cache(maxsize=64)
def _stored_gains(plain: str) -> Array:
    """Return the gains (2 n,) of the environment with these JSON-compatible data."""
    return PDDesign(Configuration.from_plain(json.loads(plain))).gains()


def without_agent(environment: Configuration) -> Configuration:
    """Return a configuration without gains and without the settings of an agent, such as a base that needs gains."""
    return environment.without((*INTERFACE, "gains"))


def goal_postures(environment: Configuration) -> tuple[Array, Model]:
    """Return the goals (8, n), rad, of episodes with seeds 0 to 7, and the model of the environment."""
    venv = gym.make_vec(environment.id, POSTURES, "vector_entry_point", **without_agent(environment).keywords())
    venv.reset(seed=list(range(POSTURES)))  # type: ignore[arg-type]
    episodes = venv.unwrapped.episodes  # type: ignore[attr-defined]
    postures, model = episodes.view.goal_angles.copy(), episodes.batch.model
    venv.close()
    return postures, model


def shorter_periods(period: float) -> Iterator[float]:
    """Yield the control periods 1, 2, 5 times a power of ten below a period, the longest first, s."""
    decade = int(np.floor(np.log10(period)))
    for exponent in range(decade, decade - 5, -1):
        for mantissa in MANTISSAS:
            shorter = float(f"{mantissa}e{exponent}")
            if SHORTEST_SHARE * period <= shorter < period * (1.0 - 1e-9):
                yield shorter


def _kept(loops: Sequence[SampledLoop], gains: Array) -> bool:
    """Return True if the loops have MIN_MARGINS with gains (2 n,)."""
    stiffness, damping = np.split(gains, 2)
    return has_margins(loops, stiffness, damping, MIN_MARGINS)


def _rounded(gains: Array) -> Array:
    """Return gains with three significant digits."""
    return np.array([float(f"{gain:.3g}") for gain in gains])


def weight_stiffness(model: Model) -> Array:
    """Return bounds (n,) of the Hessian of the weight's potential energy in any posture, N m/rad.

    The bound of a joint is the largest sum of the absolute entries of its row in random postures, so that a diagonal
    matrix of larger numbers exceeds the Hessian there (Gershgorin).
    """
    n = model.n_joints
    if not model.constants.gravity.any():
        return np.zeros(n)
    postures = np.random.default_rng(0).uniform(-np.pi, np.pi, (WEIGHT_POSTURES, n))
    steps = WEIGHT_STEP * np.eye(n)
    hessians = [
        [rigid_holding_torques(model, q + step) - rigid_holding_torques(model, q - step) for step in steps]
        for q in postures
    ]
    bounds: Array = (np.abs(hessians) / (2.0 * WEIGHT_STEP)).sum(axis=2).max(axis=0)
    return bounds


class PDDesign:
    """Linearised, sampled loops of an arm at p goals of its environment, bounds of the gains, and their cost.

    Args:
        environment: environment of the gains.
        period: control period, s; None for that of the environment.

    Attributes:
        loops: sampled loops of all goals, those with sliding motors first.
    """

    def __init__(self, environment: Configuration, period: float | None = None) -> None:
        postures, model = goal_postures(environment)
        self._environment, self._period = environment, period or environment.control_period
        timing = self._period, environment.max_delay, environment.drive_bandwidth
        of_posture = [sampled_loops(model, posture, *timing) for posture in postures]
        self.loops = [loop for loops in zip(*of_posture, strict=True) for loop in loops]
        sliding, joints = self.loops[: len(postures)], np.flatnonzero(model.constants.passive == 0)
        self._transition, self._inputs = (np.stack([loop[i] for loop in sliding]) for i in (0, 1))
        self._columns = sliding[0].motors, sliding[0].rates
        self._doublings = max(1, int(np.ceil(np.log2(environment.horizon / self._period))))
        torques = np.array([holding_torques(model, posture) for posture in postures])
        states = [rest_state(model, posture) for posture in postures]
        linear = [linearize(model, state=x, torque=torque) for x, torque in zip(states, torques, strict=True)]
        size, unit = self._transition.shape[1], model.at_rest(np.eye(model.n_joints)[joints])
        self._tips, self._releases = np.zeros((len(postures), 3, size)), np.zeros((len(joints), size))
        self._tips[:, :, : unit.shape[1]] = [each.C[:3] / model.constants.length.sum() for each in linear]  # reaches
        self._releases[:, : unit.shape[1]] = RELEASE * unit
        sensitivity = np.linalg.norm(self._tips @ self._releases.T, axis=1) / RELEASE  # (p, n) reaches per radian
        # uniform rest of the error
        self._friction = sensitivity * model.constants.coulomb_friction[joints] / np.sqrt(3.0)
        self._bound(model, states, torques[:, joints])

    def _bound(self, model: Model, states: Sequence[Array], holding: Array) -> None:
        """Compute the bounds of the gains and the scales of the first candidates from the rest states at the goals."""
        joints, motors = np.flatnonzero(model.constants.passive == 0), model.driven_columns
        limits = np.array(self._environment.torque_limit)[joints]
        masses = [mass_matrix(model, state) for state in states]
        diagonals = np.array([np.diag(mass) for mass in masses])
        inertias = diagonals[:, joints] + np.where(motors == joints, 0.0, diagonals[:, motors])
        rotors = np.min([1.0 / np.diag(np.linalg.inv(mass))[motors] for mass in masses], axis=0)
        free = np.maximum(limits - np.abs(holding), LEAST_TORQUE * limits)
        self._inertia = inertias.max(axis=0)
        self._saturating = np.sqrt((free.min(axis=0) / (RELEASE * self._inertia)).min())  # rad/s
        self._braking = np.sqrt((2.0 * free / (inertias * SLEW)).min(axis=0))  # 1/s; largest stiffness / damping
        self._least = WEIGHT_FACTOR * weight_stiffness(model)[joints]
        self._most = np.maximum(MAX_STIFFNESS * limits, 2.0 * self._least)
        self._max_damping = stability_limit(self._environment.max_delay) * rotors / (MIN_MARGINS.gain * self._period)

    def gains(self, margin: bool = True) -> Array:
        """Return gains (2 n,), stiffness and damping, of least cost.

        Margins are checked in the loops with sliding motors during the search. Loops with sticking motors, of which n
        motors with friction have 2^n - 2, are checked at its end; those without the margins join the next search.

        Args:
            margin: False to require stability only.

        Raises:
            ValueError: if no gains have the margins; the message has a shorter control period with gains.
        """
        checked = [loop for loop in self.loops if not loop.stuck] if margin else []
        while (found := self._search(checked)) is not None:
            failed = [loop for loop in self.loops if not _kept([loop], found)] if margin else []
            if not failed:
                return found
            checked += failed
        works = next((each for each in shorter_periods(self._period) if self._exists(each)), None)
        margins = f"a gain margin of {MIN_MARGINS.gain:g} and a phase margin of {MIN_MARGINS.phase:g} degrees"
        why = f"no PD at {1e3 * self._period:.6g} ms has {margins}"
        why += self._damping_advice()
        allowed = f"{works:g}: {why}; {1e3 * works:g} ms works" if works else f"another arm: {why}, nor at any shorter"
        raise value_error("control_period", self._period, allowed)

    def _damping_advice(self) -> str:
        """Return the settings of a damping for an arm without one, with 1 % of the critical damping of its rotors."""
        arm = self._environment.arm
        springs = [each for each in arm.joints if each.stiffness is not None and not each.passive]
        of_links = np.any(arm.modal_damping_ratio) or arm.stiffness_proportional_damping > 0.0
        if of_links or any(each.damping for each in springs):
            return ""
        critical = [2.0 * np.sqrt((each.stiffness or 0.0) * each.rotor_inertia) for each in springs]
        names = ["modal_damping_ratio"] * any(link.flexible for link in arm.links)
        if springs:
            part = ", ".join(f"{0.01 * each:.2g}" for each in critical)
            names.append(f"damping of the joints, 1 % of critical: {part} N m s/rad")
        return f" on an arm without damping ({'; or '.join(names)})" if names else ""

    def _exists(self, period: float) -> bool:
        """Return True if gains with margins exist at a control period, s."""
        shorter = PDDesign(self._environment, period)
        return shorter._first(shorter.loops) is not None

    def cost(self, gains: Array) -> float:
        """Return the mean time outside the settling band after a release, s; inf for an unstable loop.

        A window in which the squared tip error has the mean e is counted with its length times e / (e + band^2).
        """
        stiffness, damping = np.split(gains, 2)
        n, size = len(stiffness), self._transition.shape[1]
        feedback = np.zeros((n, size))
        for columns, values in zip(self._columns, (stiffness, damping), strict=True):
            feedback[np.arange(n), columns] = values
        power = self._transition - self._inputs @ feedback
        weight = np.swapaxes(self._tips, 1, 2) @ self._tips
        x, rest, total, length = self._releases, ((self._friction / stiffness) ** 2).sum(axis=1)[:, None], 0.0, 1
        square = np.einsum("ij,pjk,ik->pi", x, weight, x)
        with np.errstate(over="ignore", invalid="ignore"):
            for doubling in range(self._doublings + 1):
                error = square / length + rest
                total += length * float((error / (error + BAND**2)).mean())
                if doubling == self._doublings:
                    break
                window, length = np.swapaxes(power, 1, 2) @ weight @ power, 2**doubling
                power, weight = power @ power, weight + window
                square = np.einsum("ij,pjk,ik->pi", x, window, x)
        return float(f"{self._period * total:.6g}") if np.isfinite(total) else np.inf

    def _starts(self) -> Iterator[Array]:
        """Yield the first candidates (2 n,): joints with a common bandwidth and damping ratio."""
        for share in DAMPING_SHARES:
            for bandwidth in self._saturating * BANDWIDTHS:
                for ratio in DAMPING_RATIOS:
                    stiffness = np.minimum(self._inertia * bandwidth**2 + self._least, self._most)
                    damping = np.minimum(2.0 * ratio * np.sqrt(self._inertia * stiffness), share * self._max_damping)
                    yield self.bounded(np.concatenate([stiffness, damping]))

    def bounded(self, gains: Array) -> Array:
        """Return rounded gains within the bounds of stiffness and damping."""
        stiffness, damping = np.split(gains, 2)
        damping = np.minimum(damping, self._max_damping)
        most = np.minimum(self._most, self._braking * damping)
        return _rounded(np.concatenate([np.maximum(np.minimum(stiffness, most), self._least), damping]))

    def _first(self, checked: Sequence[SampledLoop]) -> tuple[float, Array] | None:
        """Return cost and gains of the best first candidate with margins in the checked loops; None without one."""
        ranked = sorted((self.cost(np.array(gains)), gains) for gains in {tuple(each) for each in self._starts()})
        for cost, gains in ranked:
            if np.isfinite(cost) and _kept(checked, np.array(gains)):
                return cost, np.array(gains)
        return None

    def _search(self, checked: Sequence[SampledLoop]) -> Array | None:
        """Return gains (2 n,) of least cost with margins in the checked loops, joint by joint; None without any."""
        start = self._first(checked)
        if start is None:
            return None
        cost, gains = start
        for factor in FACTORS:
            before = np.inf
            while cost < before * (1.0 - LEAST_ROUND):
                before = cost
                for joint in range(len(gains) // 2):
                    cost, gains = self._improved(cost, gains, joint, factor, checked)
        return gains

    def _improved(
        self, cost: float, gains: Array, joint: int, factor: float, checked: Sequence[SampledLoop]
    ) -> tuple[float, Array]:
        """Return cost and gains after the best change of the gains of one joint by a factor, or the given ones."""
        n, tried = len(gains) // 2, set()
        for stiffer, damped in np.ndindex(3, 3):
            changed = gains.copy()
            changed[[joint, n + joint]] *= factor ** (np.array([stiffer, damped]) - 1.0)
            tried.add(tuple(self.bounded(changed)))
        for found, candidate in sorted((self.cost(np.array(each)), each) for each in tried - {tuple(gains)}):
            if found >= cost * (1.0 - LEAST_GAIN):
                break
            if _kept(checked, np.array(candidate)):
                return found, np.array(candidate)
        return cost, gains
