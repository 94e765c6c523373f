"""Learning: planted errors in environments, tasks, sensors, controllers and metrics."""

from studies.planted.change import changes

STREAMS = "envs/test_random_streams.py envs/test_randomisation.py"
ON_A_PATH = "control/test_lqr.py::test_along_a_path_gains_and_torques_are_those_of_the_moment"

ENVIRONMENT = (
    *changes(
        "environment", "envs/remembering.py", "envs/test_env_refusals.py",
        ("a refused reset leaves its draws behind", "                self.set_state(before)\n", ""),
        ("its episode goes on", "self.episodes.over[:] = over", "pass"),
    ),
    *changes(
        "environment", "envs/streams.py", STREAMS,
        ("the generator of noise is seeded alike for all", "np.random.default_rng(stream.integers(2**63)), BLOCK",
         "np.random.default_rng(0 * stream.integers(2**63)), BLOCK"),
        ("noise is not truncated", "TRUNCATION = 4.0", "TRUNCATION = 40.0"),
        ("one random stream for all effects", "crc32(name.encode())", "crc32(b\"\")"),
        ("the arms' streams do not begin anew with a seed", "if self._parents[arm] is not random:",
         "if self._parents[arm] is None:"),
    ),
    *changes(
        "environment", "envs/effects/initial_vibration.py", STREAMS,
        ("directions from half of the circle", "stream.uniform(0.0, 2.0 * np.pi, n)", "stream.uniform(0.0, np.pi, n)"),
    ),
    *changes(
        "environment", "envs/effects/tip_impulse.py", STREAMS,
        ("impulses at fixed times", "int(self._inner[arm].geometric(self._period / self._gap_time))",
         "max(1, round(self._gap_time / self._period))"),
        ("an impulse over 0.02 s whatever the period", "size / self._period * way", "size / 0.02 * way"),
        ("impulses point up", "inner.normal(size=3)", "np.abs(inner.normal(size=3))"),
    ),
    *changes(
        "environment", "envs/effects/delay.py", STREAMS,
        ("torques of the episode before arrive", "self._past[:, arms] = 0.0", "pass"),
        ("torques come one period early", "(self._now - self._late) % depth", "(self._now - self._late + 1) % depth"),
    ),
    *changes(
        "environment", "envs/motors.py", "envs/test_env.py envs/test_env_refusals.py",
        ("actions beyond the space are taken", "np.abs(actions) <= 1.0) == actions.size",
         "np.abs(actions) <= 9.0) == actions.size"),
    ),
    *changes(
        "environment", "envs/vector_env.py", "envs/test_vector_env.py envs/test_slew.py",
        ("the reward of a reset is not zero", "rewards[late] = 0.0", "pass"),
        ("the last observation is that of the new episode", "final[arm] = self.episodes.sight.seen[arm].copy()",
         "final[arm] = self.episodes.seen[arm]"),
        ("arms have the same seed", "[first + arm for arm in range(self.num_envs)]",
         "[first for arm in range(self.num_envs)]"),
    ),
    *changes(
        "environment", "envs/limits.py", "envs/test_description.py envs/test_env.py envs/test_slew.py",
        ("the limit of deflection in metres", "self.deflection * np.repeat(view.lengths, 2)", "self.deflection"),
    ),
    *changes(
        "environment", "envs/description.py", "envs/test_description.py",
        ("a change reaches the description that it came from", "dict(inner) if isinstance(inner, dict)",
         "inner if isinstance(inner, dict)"),
    ),
    *changes(
        "environment", "envs/episodes.py", "envs/test_hold.py",
        ("the action of an arm that is over changes", "view.action[playing] = actions[playing]",
         "view.action[:] = actions"),
    ),
    *changes(
        "environment", "envs/sight.py", "envs/test_history.py",
        ("averages do not know the hold", "setup.hold * setup.control_period", "setup.control_period"),
    ),
)  # fmt: skip

TASKS = (
    *changes(
        "tasks", "envs/tasks/slew.py", "envs/test_slew.py envs/test_env.py",
        ("starts on one side", "start = random.uniform(-self.start, self.start,",
         "start = random.uniform(0.0, self.start,"),
        ("goals do not depend on the start", '"goal_angles": start + random', '"goal_angles": random'),
        ("effort is worth more", '"effort": 0.1 * (1.0 - view.effort)', '"effort": 0.1 * (1.0 + view.effort)'),
        ("a failure is worth something", "failure = 0.0 - self.failure_penalty",
         "failure = 0.0 + self.failure_penalty"),
        ("one width of three", "(near[0] + near[1] + near[2])", "(3.0 * near[0])"),
    ),
    *changes(
        "tasks", "envs/tasks/rewards.py", "envs/test_slew.py",
        ("the distance does not look ahead", "+ row_dots(moving, moving)", ""),
    ),
)  # fmt: skip

SENSORS = (
    *changes(
        "sensors", "kernels/readings.py", "kernels/test_outputs.py envs/test_env.py envs/test_full_state.py",
        ("angle errors with the other sign", "goal_angles[b, j] - angles[b, j]", "angles[b, j] - goal_angles[b, j]"),
        ("the nearness counts metres, not parts of the reach", "scale = numbers[b] + near", "scale = numbers[b] + 1.0"),
    ),
    *changes(
        "sensors", "envs/sensors/fine.py", "envs/test_fine.py",
        ("fine errors with the other sign", "np.subtract(view.goal_angles, view.motor_angles,",
         "np.subtract(view.motor_angles, view.goal_angles,"),
        ("fine numbers are linear", "np.arcsinh(out, out=out)", "pass"),
        ("a scale of another quantity", '("target_error", LENGTH * reach)', '("target_error", SPEED * reach)'),
    ),
)  # fmt: skip

CONTROL = (
    *changes(
        "control", "control/pd.py", "control/test_pd.py",
        ("damping drives", "self.stiffness * error - self.damping * rate",
         "self.stiffness * error + self.damping * rate"),
        ("gravity is not held", "torque = torque + (self._holding", "torque = torque + 0.0 * (self._holding"),
        ("a PD does not saturate", "-1.0, 1.0).astype(np.float32)", "-9.0, 9.0).astype(np.float32)"),
    ),
    *changes(
        "control", "control/discrete.py", "control/test_discrete.py",
        ("weights are multiplied", "tip / weights.tip, tip / weights.tip_speed",
         "tip * weights.tip, tip / weights.tip_speed"),
        ("a gain of the continuous model", 'positive("period", period, "s") * block',
         '0.5 * positive("period", period, "s") * block'),
        ("torques cost alike", "cost = np.diag(1.0 / limits**2)", "cost = np.diag(1.0 / limits)"),
    ),
    *changes(
        "control", "control/lqr.py", "control/test_lqr.py",
        ("feedback has the wrong sign", "self._held - row_dots(", "self._held + row_dots("),
        ("a slew's plan does not move on", "self._now += 1", "self._now += 0"),
        ("gains jump", "plan.gains[lower] + part * (plan.gains[upper] - plan.gains[lower])", "plan.gains[lower]"),
        ("gains change with time, not with the way", "(GAINS - 1) * np.clip(way, 0.0, 1.0)",
         "(GAINS - 1) * np.linspace(0.0, 1.0, len(way))"),
    ),
    *changes(
        "control", "control/reference.py", "control/test_reference.py",
        ("the jerk is not least", "(10.0 - 15.0 * s + 6.0 * s**2)", "(10.0 - 14.0 * s + 5.0 * s**2)"),
        ("rotors need no torque", "return x, links + rotors", "return x, links"),
        ("bending is solved for once", "PASSES = 3", "PASSES = 1"),
        ("torques along a path are those where a period begins", "all_times[:-1] + 0.5 * period", "all_times[:-1]"),
        ("joints give way into directions that take far", "SINGULAR = 0.05", "SINGULAR = 1e-9"),
    ),
    *changes(
        "control", "control/pd.py", "control/test_pd.py",
        ("damping brakes on a path too", 'rate = rate - readings["goal_rates"]', "pass"),
        ("arms that come later let the others sink",
         "np.vstack([self._holding, np.zeros((more, self._holding.shape[1]))])",
         "np.zeros((len(self._holding) + more, self._holding.shape[1]))"),
        ("a warning names the damping of the first motor", "limit * inertia[i] / period",
         "limit * inertia[0] / period"),
    ),
    *changes(
        "control", "control/discrete.py", "control/test_discrete.py",
        ("joint angles weigh, not those of the motors", "outputs[6:, motors] = np.eye(n)",
         "outputs[6:, :n] = np.eye(n)"),
    ),
    *changes(
        "control", "control/lqr.py", f"control/test_lqr.py::test_an_arm_that_starts_at_its_goal_is_held_more_tightly "
        f"control/test_lqr.py::test_feed_forward_leaves_a_part_of_the_limits_for_feedback {ON_A_PATH}",
        ("an arm that starts at its goal is held loosely", "HOLDING = 0.25", "HOLDING = 4.0"),
        ("feed-forward leaves nothing for feedback", "self.limits, SHARE, self.period",
         "self.limits, 1.0, self.period"),
        ("a path has the gains of its start", "self.gain(path[row]) for row in rows",
         "self.gain(path[0]) for row in rows"),
        ("torques along a path come a period late", "np.vstack([slew.torques, slew.torques[-1:]])",
         "np.vstack([slew.torques[:1], slew.torques])"),
    ),
)  # fmt: skip

METRICS = (
    *changes(
        "metrics", "metrics/settling.py", "metrics/test_settling.py",
        ("settled at the first entry", "int(outside[-1]) + 1", "int(outside[0]) + 1"),
        ("the mean error", "np.median(last(", "np.mean(last("),
        ("an overshoot counts the way in", "np.asarray(errors, dtype=np.float64)[first:]",
         "np.asarray(errors, dtype=np.float64)[:]"),
        ("since the entry is since the start", "settled -= int(np.flatnonzero(inside)[0])", "settled -= 0"),
    ),
    *changes(
        "metrics", "metrics/vibration.py", "metrics/test_vibration.py",
        ("half of the vibration", "(tips.max(axis=0) - tips.min(axis=0)).max()",
         "(tips.max(axis=0) - tips.mean(axis=0)).max()"),
    ),
    *changes(
        "metrics", "metrics/actions.py", "metrics/test_actions.py",
        ("effort without a square", "np.mean(np.square(samples(", "np.mean(np.abs(samples("),
    ),
    *changes(
        "metrics", "metrics/intervals.py", "metrics/test_intervals.py",
        ("an interval of one side", "cut = round((1.0 - level) / 2.0 * (draws - 1))",
         "cut = round((1.0 - level) * (draws - 1))"),
    ),
    *changes(
        "metrics", "metrics/samples.py", "metrics/test_vibration.py metrics/test_settling.py",
        ("a window that is one sample short", "array[-round(count) - 1 :]", "array[-round(count) :]"),
    ),
)  # fmt: skip
