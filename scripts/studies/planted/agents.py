"""Agents: planted errors in training, its memory and its curves, and in evaluation."""

from studies.planted.change import changes

TRAINING = "agents/test_training.py::test_"
RESUMED = "agents/test_resume.py::test_a_run_that_was_interrupted_twice_is_the_run_that_was_not"

AGENTS = (
    *changes(
        "agents", "evaluation/rollout.py", "evaluation/test_rollout.py",
        ("an agent acts in every period", "deepcopy(player.interface)", "deepcopy(player.interface) | {\"hold\": 1}"),
        ("seeds are counted anew", "venv.reset(seed=list(seeds))", "venv.reset(seed=list(range(len(seeds))))"),
        ("a failed episode ends one period early", "= len(self._rows[\"actions\"]), episodes",
         "= len(self._rows[\"actions\"]) - 1, episodes"),
        ("what an arm does after its episode is shown",
         "values[arm, end + (name in (\"tips\", \"errors\")) :] = np.nan", "pass"),
        ("the episode after a failure counts", "(self.ends == 0)", "(self.ends >= 0)"),
        ("the band is a part of the longest link", "BAND * view.reach", "BAND * view.lengths.max()"),
    ),
    *changes(
        "agents", "evaluation/figures.py", "evaluation/test_figures.py evaluation/test_rollout.py",
        ("a failed episode may settle", "np.inf if record.failure else settling_time", "settling_time"),
        ("the median of the effort", "effort(record.actions), MEAN)", "effort(record.actions), MEDIAN)"),
        ("vibration of the whole episode", "peak_to_peak(record.tips, record.period)",
         "peak_to_peak(record.tips, 1.0)"),
        ("the error of the last moment", "final_error(record.errors, record.period)", "float(record.errors[-1])"),
        ("the mean of medians", "upper_median(result) if", "float(np.mean(result)) if"),
        ("a rough torque is better", '"low", lambda record: roughness', '"high", lambda record: roughness'),
    ),
    *changes(
        "agents", "evaluation/rollout.py", "evaluation/test_entrants.py",
        ("a controller remembers another rollout", "deepcopy(player.interface)", "player.interface"),
    ),
    *changes(
        "agents", "evaluation/table.py", "evaluation/test_table.py",
        ("shares of episodes in parts", 'return f"{result:.0%}"', 'return f"{0.01 * result:.0%}"'),
        ("metres below the name of millimetres", "figure.scale * value", "value"),
        ("an interval from its high to its low end", "({low} to {high})", "({high} to {low})"),
        ("a name is cut off at its end", 'f"...{name[3 - LONGEST_NAME :]}"', "name"),
    ),
    *changes(
        "agents", "evaluation/entrants.py", "evaluation/test_entrants.py",
        ("the PD beside a policy has gains that it did not learn on", 'if whole.get("gains")]', "if False]"),
        ("other gains make another environment", '{**whole, "gains": None} != {**trained[0][2], "gains": None}',
         "whole != trained[0][2]"),
        ("a part of what a policy was trained with is changed", 'change.split("=")[0].split(".")[0] in',
         'change.split("=")[0] in'),
        ("random torques of one sign", "random.uniform(-1.0, 1.0, shape)", "random.uniform(0.0, 1.0, shape)"),
        ("a policy leaves its gains to the environment", '        interface["gains"] = described.whole()["gains"]\n',
         "        pass\n"),
    ),
    *changes(
        "agents", "control/network.py", "control/test_network.py",
        ("observations are not limited", "-LARGEST, LARGEST)", "-1e9, 1e9)"),
        ("normalised by the variance", "1.0 / np.sqrt(", "1.0 / np.square("),
        ("the last layer bends too", "for weights, bias in self._layers[:-1]:", "for weights, bias in self._layers:"),
        ("SAC acts without its end", '"relu", np.tanh)', '"relu", lambda values: np.clip(values, -1.0, 1.0))'),
        ("the tenth layer comes before the second", "sorted({int(name[len(first) :].split(\".\")[0])",
         "sorted({name[len(first) :].split(\".\")[0]"),
    ),
    *changes(
        "agents", "agents/algorithm.py", f"{TRAINING}a_training_begins_with_seeds_of_its_own "
        f"{TRAINING}rewards_are_normalised_where_they_should_be_and_by_returns_of_the_same_discount",
        ("a training begins with seeds of the judge", "env.seed(training_seed(settings.seed))",
         "env.seed(settings.seed)"),
        ("rewards are normalised by returns of another discount", ', gamma=chosen["gamma"])', ")"),
        ("rewards are normalised whatever is asked for", "norm_reward=settings.normalise_reward", "norm_reward=True"),
    ),
    *changes(
        "agents", "agents/settings.py", "agents/test_settings.py",
        ("SAC may not learn from its first step", 'value, 1 - (name == "learning_starts")', "value, 1"),
    ),
    *changes(
        "agents", "evaluation/folder.py",
        "agents/test_folder.py::test_a_file_takes_its_place_when_all_of_it_is_on_the_disk",
        ("a file takes its place before it is on the disk", "            os.fsync(file.fileno())\n", ""),
    ),
    *changes(
        "agents", "agents/curves.py", "agents/test_resume.py",
        ("curves lose the row of the last step that was kept", "float(row[column]) <= steps]",
         "float(row[column]) < steps]"),
    ),
    *changes(
        "agents", "evaluation/tuning.py", "evaluation/test_tuning.py",
        ("gains are stable without a delay", "stability_limit(setup.latest_delay)", "stability_limit(0)"),
        ("margins without the delay", "setup.control_period, setup.latest_delay)", "setup.control_period, 0)"),
        ("gains without margins", "if has_margins(loops, stiffness, damping, LEAST)", "if True"),
        ("gains are judged on one episode", "np.tile(np.arange(episodes), len(gains))",
         "np.zeros(episodes * len(gains), dtype=int)"),
        ("every round is around the first gains drawn", "best = np.log(gains[np.argmax(rewards)])",
         "best = np.log(gains[0])"),
    ),
    *changes(
        "agents", "agents/zoo.py", "agents/test_zoo.py",
        ("a rate that falls early is written as one that falls late", "rate.end != 0.0 or rate.until != 1.0",
         "rate.end != 0.0"),
        ("a rate that stays is refused", "    if rate.end == rate.start:\n", "    if False:\n"),
    ),
    *changes(
        "agents", "agents/memory.py", "agents/test_resume.py",
        ("a full memory is taken for one that is not", 'buffer.pos, buffer.full = data["pos"], data["full"]',
         'buffer.pos = data["pos"]'),
    ),
    *changes(
        "agents", "agents/memory.py", RESUMED,
        ("the mean reward of the curves begins anew", 'for each in data["episodes"]]', "for each in ()]"),
        ("Python's generator is not given back", "    random.setstate((version, tuple(words), gauss))\n", ""),
    ),
    *changes(
        "agents", "agents/training.py", "agents/test_training.py",
        ("a third run counts the steps of the second only", "self._before += count", "self._before = count"),
    ),
    *changes(
        "agents", "agents/training.py",
        f"{TRAINING}a_run_that_keeps_its_best_policy_goes_on_only_where_it_is_judged "
        "agents/test_resume.py::test_versions_of_every_part_of_a_run_are_kept",
        ("versions of long ago are forgotten", "earlier = [*earlier, last |", "earlier = [last |"),
        ("the judge of another run waits for the steps of the first", "                self._judge.begin()",
         "                pass"),
    ),
    *changes(
        "agents", "agents/callbacks.py", "agents/test_training.py",
        ("judged more often after long rollouts", "self._next = self.num_timesteps + self._every\n        result",
         "self._next += self._every\n        result"),
    ),
    *changes(
        "agents", "agents/callbacks.py", f"{TRAINING}the_curves_show_what_the_judge_has_seen_with_its_units",
        ("curves without their units", "if unit else", "if False else"),
    ),
    *changes(
        "agents", "agents/vector.py", "agents/test_vector.py",
        ("a failure counts as the end of time", "bool(truncations[arm] and not terminations[arm])",
         "bool(truncations[arm] or terminations[arm])"),
        ("truncated episodes go on", "dones = terminations | truncations", "dones = terminations.copy()"),
        ("seeds hold for every reset", "        self._reset_seeds()\n", ""),
        ("a picture of the first arm alone", "list(self.env.render() or ())", "list(self.env.render() or ())[:1]"),
    ),
)  # fmt: skip
