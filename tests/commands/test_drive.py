"""flexman drive: its log keeps earlier ones, and is written elsewhere if the disk is full."""

import errno

import pytest

from flexman_gym.__main__ import main
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.deployment.machine import simulated

from oracles.machines import FakeSimulatedMachine

pytestmark = pytest.mark.slow

WORDS = ["drive", "pd", "--machine", "sim:FlexOne-v0", "--seconds", "0.2"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Change to an empty folder, and drive a machine without sockets."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(simulated, "SimulatedMachine", FakeSimulatedMachine)
    return tmp_path


def test_a_log_without_a_name_keeps_all_earlier_ones(folder, capsys):
    for count, name in enumerate(("drive.npz", "drive-2.npz", "drive-3.npz"), 1):
        assert main(WORDS) == 0
        assert f"{name}: to go on" in capsys.readouterr().out
        assert len(list(folder.glob("*.npz"))) == count and Episode.load(name).about["failure"] == ""


@pytest.mark.parametrize("path", ["taken", "taken/log.npz/", "/proc/log.npz"])
def test_a_log_that_cannot_be_written_is_refused_before_the_machine_is_started(path, folder, monkeypatch, capsys):
    monkeypatch.setattr(simulated, "SimulatedMachine", lambda *_: pytest.fail("it began"))
    (folder / "taken").mkdir()
    (folder / "taken" / "log.npz").mkdir()
    with pytest.raises(SystemExit) as stop:
        main([*WORDS, "--out", path])
    assert stop.value.code == 2 and "is not allowed; give a path" in capsys.readouterr().err


def test_a_log_is_kept_elsewhere_if_the_disk_is_full_after_the_motion(folder, monkeypatch, capsys):
    save = Episode.save

    def full(log, path):
        if "flexman-" not in str(path):
            raise OSError(errno.ENOSPC, "No space left on device")
        return save(log, path)

    monkeypatch.setattr(Episode, "save", full)
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    assert main([*WORDS, "--out", "log.npz"]) == 0
    line = capsys.readouterr().out.splitlines()[0]
    assert line.startswith("log.npz: No space left on device; the log is in ")
    assert len(Episode.load(line.split(" is in ")[1]).time) > 1
