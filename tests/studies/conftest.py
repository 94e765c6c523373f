"""Fixtures of studies: modules of other simulators, where they are installed."""

import importlib

import pytest


@pytest.fixture(scope="session")
def mujoco():
    """Return MuJoCo."""
    return pytest.importorskip("mujoco", minversion="4")


@pytest.fixture(scope="session")
def mujoco_peer(mujoco):
    """Return the module of the MuJoCo models."""
    return importlib.import_module("flexman_gym.toolbox.precision.peers.mujoco")
