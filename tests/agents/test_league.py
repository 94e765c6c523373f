"""League: a run plays in it as it plays by itself, and not on episodes that it has seen."""

import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.training import train
from flexman_gym.evaluation import FIGURES, rollout
from flexman_gym.evaluation.league import play_league
from flexman_gym.evaluation.seeds import SELECTION

from oracles.refusals import refusal
from oracles.runs import RUNS


def test_a_run_plays_as_by_itself_and_is_played_anew_when_it_has_learned(tmp_path):
    folder, said = str(tmp_path / "run"), []
    train(RUNS["ppo"], tmp_path / "run", progress=False)
    for _ in range(2):
        book = play_league([folder], ["FlexOne-v0"], range(9000, 9002), tmp_path, say=said.append)
    values = [row.values[: len(FIGURES)] for _, row in sorted(book.rows.items())]
    records = rollout(folder, "FlexOne-v0", range(9000, 9002)).records
    assert values == [tuple(figure.of(record) for figure in FIGURES.values()) for record in records]
    assert len(said) == 1, "nothing is played twice"
    (tmp_path / "run" / "best.npz").unlink()  # the newest policy acts now
    play_league([folder], ["FlexOne-v0"], range(9000, 9002), tmp_path, say=said.append)
    assert len(said) == 2
    assert "nor chosen on the seed 5000" in refusal(play_league, [folder], ["FlexOne-v0"], SELECTION, tmp_path)
