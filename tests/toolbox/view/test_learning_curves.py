"""Learning curves: the progress files are read, and the plot shows the median and the range over seeds."""

import pytest

pytest.importorskip("matplotlib")

from flexman_gym.toolbox.view import learning_curves
from flexman_gym.toolbox.view.learning_curves import draw_learning_curves, read_progress


def test_learning_curves_are_those_of_the_files_with_a_band_over_seeds(monkeypatch, tmp_path):
    for seed, values in enumerate(([1.0, 3.0], [2.0, 8.0], [3.0, 4.0])):
        folder = tmp_path / f"seed-{seed}"
        folder.mkdir()
        (folder / "progress.csv").write_text(
            f"time/total_timesteps,rollout/ep_rew_mean,b\n100,{values[0]},\n300,{values[1]},1\n"
        )
    seeds = [read_progress(tmp_path / f"seed-{seed}") for seed in range(3)]
    assert seeds[1][0].tolist() == [100.0, 300.0] and seeds[1][2] == "rollout/ep_rew_mean"
    made, new_figure = [], learning_curves.new_figure
    monkeypatch.setattr(
        learning_curves, "new_figure", lambda *given, **named: made.append(new_figure(*given, **named)) or made[-1]
    )
    draw_learning_curves({"ppo": [each[:2] for each in seeds]}, tmp_path / "a.png", "reward")
    axes = made[0].axes[0]
    assert axes.get_lines()[0].get_ydata().tolist() == [2.0, 4.0]
    band = axes.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (1.0, 8.0)
    with pytest.raises(ValueError, match=r"^column: 'c' is not allowed; give one of b, "):
        read_progress(tmp_path / "seed-0", "c")
    with pytest.raises(FileNotFoundError, match=r"no progress\.csv"):
        read_progress(tmp_path)
