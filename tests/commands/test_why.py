"""Why: the command prints shares, modes and what would help."""

from flexman_gym.__main__ import main
from flexman_gym.commands.why import lines as told
from flexman_gym.envs.description import Description
from flexman_gym.evaluation.diagnosis import HELP, RINGING, Diagnosis, diagnose

GIVEN = ["--env", "FlexPlanar-v0", "--episodes", "2", "--seed", "3", "--set", "horizon=1.0"]


def test_it_tells_of_each_entrant_the_shares_the_largest_first(capsys):
    assert main(["why", "pd", "zero", *GIVEN]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" on ")[0] for line in lines if not line.startswith(" ")] == ["pd", "zero"]
    found = diagnose("pd", Description("FlexPlanar-v0", {"horizon": 1.0}), [3, 4])
    for cause in HELP:
        line = next(line for line in lines if line.startswith(f"  {cause} "))
        share = 100.0 * sum(each.shares[cause] for each in found) / 2.0
        assert abs(float(line.split("%")[0].split()[-1]) - share) < 0.051
        assert f"the largest share of {sum(each.cause == cause for each in found)} episodes" in line
    shares = [float(line.split("%")[0].split()[-1]) for line in lines[1:7]]
    assert shares == sorted(shares, reverse=True)
    worst = next(cause for cause in HELP if lines[1].startswith(f"  {cause} "))
    assert lines[7] == f"  what would help: {HELP[worst]}"


def test_where_nothing_is_left_nothing_has_to_help(capsys):
    assert main(["why", "lqr-tracking", "--env", "FlexPlanar-v0", "--episodes", "1", "--seed", "9003"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "  what would help: nothing is needed, so little is left"


def test_it_takes_what_evaluate_takes(capsys):
    assert main(["why", "nobody", *GIVEN]) == 2
    assert capsys.readouterr().err.startswith("entrant: nobody is not allowed; give the folder of a training run")


def test_one_quiet_episode_does_not_hide_one_that_rings():
    shares = dict.fromkeys(HELP, 0.0) | {RINGING: 1.0}
    still, ringing = (Diagnosis(rms, quiet, shares, ()) for rms, quiet in ((1e-6, True), (0.05, False)))
    assert told("pd", [still, ringing])[-1] == f"  what would help: {HELP[RINGING]}"
    assert told("pd", [still, still])[-1].endswith("nothing is needed, so little is left")
