"""Certify: the exit status is 0 where a policy is recommended and 1 where it is not."""

import json

import pytest

from flexman_gym.__main__ import main
from flexman_gym.evaluation import certificate


@pytest.mark.parametrize(("fails", "status", "words"), [
    ([], 0, "recommended"), (["delay 3", "finer"], 1, "not recommended, it fails delay 3, finer"),
])  # fmt: skip
def test_the_exit_status_says_whether_a_policy_is_recommended(fails, status, words, tmp_path, monkeypatch, capsys):
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps({"arrays_hash": "", "fails": fails}))
    monkeypatch.setattr(certificate, "certify", lambda *_, **__: path)
    assert main(["certify", "lab-flexrrr"]) == status
    assert capsys.readouterr().out == f"{path}: {words}\n"
