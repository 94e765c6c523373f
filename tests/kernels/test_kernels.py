"""Compiled kernels: no allocation of memory, and cached binaries that match the sources."""

import os
from pathlib import Path

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

import flexman_gym as fm
from flexman_gym import kernels
from flexman_gym.kernels import dynamics, inverse, layout, outputs

from oracles.files import ROOT
from oracles.small_package import CALL, copied, run

SOURCES = ROOT / "flexman_gym" / "kernels"

REAL = """import numpy as np, flexman_gym as fm
from flexman_gym.kernels import batch, dynamics
model = fm.build_model(fm.catalog.one_link())
fm.acceleration(model, np.zeros(2 * model.n_dof), [0.0])
fm.Simulator(model, step=0.02).step([0.0])
for kernel in (dynamics.accelerations, batch.advance_single):
    print(sum(kernel.stats.cache_hits.values()), sum(kernel.stats.cache_misses.values()))
"""


@pytest.fixture
def counting():
    """Switch on Numba's counts of allocations for one test."""
    was_on = _nrt_python.memsys_stats_enabled()
    _nrt_python.memsys_enable_stats()
    yield
    if not was_on:
        _nrt_python.memsys_disable_stats()


def allocations(call):
    """Return the allocations (blocks, reference-counted objects) of a call; array arguments add some of the latter."""
    before = rtsys.get_allocation_stats()
    call()
    after = rtsys.get_allocation_stats()
    return after.alloc - before.alloc, after.mi_alloc - before.mi_alloc


@pytest.mark.parametrize(("method", "step"), [("rk4", 1.0), ("ros2", 1.0), ("dop853", None)])
def test_allocations_do_not_depend_on_the_number_of_steps(method, step, counting):
    """No step allocates, whatever their number; the remaining allocations are those of the arguments."""
    arm = fm.catalog.planar_2r(joint_stiffness=20.0)
    counts, evaluations = [], []
    for scale in (1, 8, 64):
        period = 1e-4 * scale
        simulator = fm.Simulator(fm.build_model(arm, elements=1), method, step and 1e-4, control_period=period)
        simulator.step([0.1, 0.1])
        counts.append(allocations(lambda simulator=simulator: simulator.step([0.1, 0.1])))
        evaluations.append(simulator.substeps)
        assert simulator.status == "ok"
    assert counts[0] == counts[1] == counts[2]
    assert step is None or evaluations == [1, 8, 64]


@pytest.mark.slow
def test_the_counts_detect_an_allocation(counting):
    """Check of the measurement by a kernel that makes a new array."""
    import numba

    @numba.njit
    def allocating(count):
        total = 0.0
        for _ in range(count):
            total += np.zeros(3)[0]
        return total

    allocating(1)
    assert allocations(lambda: allocating(1000))[0] >= 1000


@pytest.mark.parametrize("links", [1, 6])
def test_accelerations_allocate_no_more_for_a_longer_arm(links, counting):
    """Only the arguments are counted, and their number is the same for every arm."""
    link, joint = fm.catalog.one_link().links[0], fm.Joint((0.0, 0.0, 1.0), 1.0, 100.0)
    model = fm.build_model(fm.Arm([link] * links, [joint] * links))
    x, out, torque = np.zeros(model.n_dof), np.zeros(model.n_dof), np.zeros(links)
    work, row = layout.make_work(model.constants), np.zeros(layout.OUTPUTS)
    for kernel, arguments in (
        (dynamics.accelerations, (x, x, torque, out)),
        (inverse.inertial_forces, (x, x, x, out)),
        (outputs.compute_outputs, (x, x, row)),
        (outputs.tip_accelerations, (x, x, torque, row)),
    ):
        kernel(model.constants, work, *arguments)
        blocks, objects = allocations(lambda k=kernel, a=arguments: k(model.constants, work, *a))
        arrays = len(model.constants) + len(work) + len(arguments)
        assert blocks <= arrays and objects <= arrays


@pytest.mark.slow
def test_an_edited_kernel_is_never_served_from_the_cache_of_its_callers(tmp_path):
    """Numba alone would return 2 again: it checks only the file of the caller."""
    package, cache = tmp_path / "package", tmp_path / "cache"
    copied(package, 1)
    first, hits, old_folder = run(package, cache, CALL)
    assert (first, hits) == ("2", "0")
    again, hits, same_folder = run(package, cache, CALL)
    assert (again, hits, same_folder) == ("2", "1", old_folder)
    copied(package, 500)  # another size, because Python's own cache compares size and second
    edited, hits, new_folder = run(package, cache, CALL)
    assert (edited, hits) == ("1000", "0")
    assert new_folder != old_folder
    assert cache in Path(new_folder).parents and cache in Path(old_folder).parents


@pytest.mark.slow
def test_the_kernels_come_from_the_cache_in_another_process():
    model = fm.build_model(fm.catalog.one_link())
    fm.acceleration(model, np.zeros(2 * model.n_dof), [0.0])
    fm.Simulator(model, step=0.02).step([0.0])
    folder = Path(dynamics.accelerations.stats.cache_path)
    cache = next(parent.parent for parent in folder.parents if parent.name == "flexman_gym")
    assert run(ROOT, cache, REAL) == ["1", "0"] * 2


def test_binaries_are_in_the_folder_of_these_sources():
    assert dynamics.accelerations.stats.cache_path.startswith(kernels.CACHE_FOLDER)
    files = {path.name for path in SOURCES.glob("*.py")}
    assert files == {f"{name}.py" for name in (*kernels.__all__, "__init__", "cache")}


@pytest.mark.slow
def test_other_packages_keep_their_cache_folder(tmp_path):
    """`numba.config.CACHE_DIR` is as it was before the import."""
    script = "import numba; before = numba.config.CACHE_DIR; import flexman_gym; print(before, numba.config.CACHE_DIR)"
    before, after = run(ROOT, os.environ.get("NUMBA_CACHE_DIR", str(tmp_path)), script)
    assert before == after
