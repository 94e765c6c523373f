"""Agents: planted errors in training, its memory and its curves, and in evaluation."""

from flexman_gym.studies.planted.change import changes

TRAINING, EVALUATION = "agents/test_training.py::test_", "agents/test_evaluation.py::test_"
RESUMED = "agents/test_resume.py::test_a_run_that_was_interrupted_twice_is_the_run_that_was_not"

AGENTS = (
    *changes(
        "agents", "agents/evaluation.py", "agents/test_evaluation.py",
        ("a failed episode may settle", "    if not record.failure:\n", "    if True:\n"),
        ("rewards after the end count", "own = {name: values[: end + (name in",
         "own = {name: values[: len(values) + (name in"),
        ("a policy acts in every period", "environment.keywords() | policy.interface)",
         "environment.keywords() | policy.interface | {\"hold\": 1})"),
        ("seeds are counted anew", "venv.reset(seed=list(seeds))", "venv.reset(seed=list(range(len(seeds))))"),
        ("the band is a part of the longest link", "BAND * sum(link.length for link in arm.links)",
         "BAND * max(link.length for link in arm.links)"),
        ("a failed episode ends one period early", "= len(rows[\"actions\"]), episodes",
         "= len(rows[\"actions\"]) - 1, episodes"),
        ("the median of the effort", '"effort": float(np.mean(', '"effort": float(np.median('),
        ("vibration of the whole episode", "peak_to_peak(record.tips, period)", "peak_to_peak(record.tips, 1.0)"),
    ),
    *changes(
        "agents", "agents/evaluation.py", f"{EVALUATION}every_figure_stands_below_its_name",
        ("the shares of settled and failed episodes are exchanged",
         "f\"{found['settled']:.0%}\", f\"{found['failed']:.0%}\"",
         "f\"{found['failed']:.0%}\", f\"{found['settled']:.0%}\""),
        ("vibration and error stand below each other's name", '("vibration", "error" if slew else "rms_error")]',
         '("error" if slew else "rms_error", "vibration")]'),
        ("an interval from its high to its low end", "{middle} ({low}-{high})", "{middle} ({high}-{low})"),
    ),
    *changes(
        "agents", "agents/evaluation.py",
        f"{EVALUATION}the_pd_beside_policies_has_the_gains_of_the_first_that_learned_on_one "
        f"{EVALUATION}what_a_policy_was_trained_with_is_not_changed_in_part_either "
        f"{EVALUATION}the_error_at_the_end_is_the_median_of_its_last_second",
        ("the error of the last moment", "final_error(record.errors, period), effort",
         "float(record.errors[-1]), effort"),
        ("the PD beside a policy has gains that it did not learn on", 'if whole.get("gains")]', "if False]"),
        ("other gains make another environment", '{**wholes[name], "gains": None} != {**wholes[first], "gains": None}',
         "wholes[name] != wholes[first]"),
        ("a part of what a policy was trained with is changed", 'change.split("=")[0].split(".")[0] in',
         'change.split("=")[0] in'),
    ),
    *changes(
        "agents", "agents/policies.py", f"{EVALUATION}random_torques_go_both_ways",
        ("random torques of one sign", "random.uniform(-1.0, 1.0, shape)", "random.uniform(0.0, 1.0, shape)"),
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
        "agents", "agents/folder.py",
        "agents/test_folder.py::test_a_file_takes_its_place_when_all_of_it_is_on_the_disk",
        ("a file takes its place before it is on the disk", "            os.fsync(file.fileno())\n", ""),
    ),
    *changes(
        "agents", "agents/curves.py", "agents/test_resume.py",
        ("curves lose the row of the last step that was kept", "float(row[column]) <= steps]",
         "float(row[column]) < steps]"),
    ),
    *changes(
        "agents", "agents/tuning.py", "agents/test_tuning.py",
        ("gains are stable with the least delay", "stability_limit(int(delay[1])", "stability_limit(int(delay[0])"),
        ("rewards of the next episodes count", "np.where(playing, rewards, 0.0)", "rewards"),
        ("the second search is around the first gains drawn", "best = np.log(gains[np.argmax(rewards)])",
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
        ("judged more often after long rollouts", "self._next = self.num_timesteps + self._every\n        found",
         "self._next += self._every\n        found"),
    ),
    *changes(
        "agents", "agents/callbacks.py", f"{TRAINING}the_curves_show_medians_of_what_the_judge_has_seen",
        ("curves show an end of the interval, not the median", "found[key][0])", "found[key][1])"),
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
