"""Programs in C that controllers carry: own controllers, subclasses and nested input shapers."""

import shutil
import subprocess

import numpy as np
import pytest

from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController
from flexman_gym.toolbox.controllers.lqr import LQR
from flexman_gym.toolbox.deployment.c_code import begin_agent, write_c
from flexman_gym.toolbox.deployment.c_programs import CProgram, has_c_program

from oracles.assertions import refusal

ENVIRONMENT = "FlexOne-v0"
MODEL = resolve_fidelity(Configuration(ENVIRONMENT)).model
GAINS = {"stiffness": [40.0], "damping": [9.0], "torque_limit": 10.0}


class Damper:
    """Controller of the user: torques against the rates of the motors."""

    sensors = ("servo",)
    c_program = f"{__name__}:damper_program"

    def __init__(self, damping):
        self.damping = np.array(damping)

    def reset(self, arms, episode, count):
        pass

    def act(self, readings, applied, active):
        return np.clip(-self.damping * readings["motor_rates"], -1.0, 1.0)


def damper_program(damper, readings):
    """Return the program of a `Damper`, in a loop over its joints."""
    line = "base[i] = clip(-damping[i] * $r[${P}_MOTOR_RATES + i], 1.0);"
    return CProgram({"damping": damper.damping}, step=[f"    for (int i = 0; i < N; i++)\n        {line}\n"])


class Silent(PD):
    """PD whose actions are zero, although it inherits the C program of a PD."""

    def act(self, readings, applied=None, active=None):
        return 0.0 * super().act(readings, applied, active)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed: the C code is not compiled")
def test_controller_of_the_user_is_exported_by_its_own_program(tmp_path):
    """The test program compares the torques in C with those of Python."""
    files = write_c(begin_agent(Damper([0.5]), ENVIRONMENT), tmp_path)
    assert {path.name for path in files} == {"damper.h", "damper.c", "main.c", "README.md"}
    command = ["gcc", "-std=c99", "-Wall", "-Werror", "main.c", "damper.c", "-o", "test", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "test"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_inherited_program_of_a_subclass_is_refused():
    line = refusal(begin_agent, Silent(**GAINS), ENVIRONMENT)
    assert line.startswith("agent: 'Silent' is not allowed; give pd, pd-shaped, ")


def test_shaped_controller_has_a_program_if_its_inner_controller_has_one():
    pd, lqr, silent = PD(**GAINS), LQR(MODEL, 10.0, 0.01), Silent(**GAINS)
    assert all(map(has_c_program, (pd, lqr, InputShapedController(pd, MODEL), InputShapedController(lqr, MODEL))))
    assert not has_c_program(silent) and not has_c_program(InputShapedController(silent, MODEL))


def test_input_shaper_of_an_input_shaper_is_refused():
    twice = InputShapedController(InputShapedController(PD(**GAINS), MODEL), MODEL)
    assert "one input shaper" in refusal(begin_agent, twice, ENVIRONMENT)


def test_second_export_of_a_session_has_the_files_of_the_first(tmp_path):
    session = begin_agent("pd", ENVIRONMENT)
    first, second = ({path.name: path.read_bytes() for path in write_c(session, tmp_path / name)} for name in "ab")
    assert first == second
