"""Renamed: modules and names of release 0.2 are still found, with a warning that has the present name."""

import importlib
import warnings

import pytest

import flexman_gym as fm
from flexman_gym.common.renamed import METHODS, MODULES, NAMES, current_methods
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.league.scenarios import find_scenario

OLD = [(old, present) for old, present in MODULES.items() if old.startswith("flexman_gym")]


@pytest.mark.parametrize(("old", "present"), OLD)
def test_an_old_module_has_the_names_of_the_present_one(old, present):
    names = vars(importlib.import_module(present))
    name = next(name for name, value in names.items() if getattr(value, "__module__", "").startswith(present))
    with pytest.warns(DeprecationWarning, match=f"{old}.{name} is {present}.{name} now"):
        assert getattr(importlib.import_module(old), name) is names[name]
    with pytest.raises(AttributeError):
        assert importlib.import_module(old).nothing


@pytest.mark.parametrize(
    "module", ["flexman_gym.control", "flexman_gym.envs.sensors", "flexman_gym.evaluation", "flexman_gym.metrics"]
)
def test_an_old_name_of_a_package_is_the_present_one(module):
    package = importlib.import_module(module)
    for old, present in NAMES[module].items():
        with pytest.warns(DeprecationWarning, match=f"{module}.{old} is {module}.{present} now"):
            assert getattr(package, old) is getattr(package, present)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert all(hasattr(package, name) for name in package.__all__)
    with pytest.raises(AttributeError, match=f"module '{module}' has no attribute 'nothing'"):
        assert package.nothing


def test_each_present_name_exists():
    for module, names in NAMES.items():
        if module.startswith("flexman_gym"):
            assert all(hasattr(importlib.import_module(module), present) for present in names.values()), module


@pytest.mark.parametrize(("old", "present"), METHODS.items())
def test_an_old_method_is_the_present_one_with_a_warning(old, present):
    warned = f"method '{old}' is deprecated; give '{present}'"
    assert old not in fm.METHODS and current_methods(f"A-v0/method={old}+given") == f"A-v0/method={present}+given"
    with pytest.warns(DeprecationWarning, match=warned):
        assert fm.METHODS[old] is fm.METHODS[present]
    with pytest.warns(DeprecationWarning, match=warned) as caught:
        assert fm.simulate(fm.catalog.paper_scene("rr"), method=old, step=0.1).status == "ok"
    assert len(caught) == 1 and caught[0].filename == __file__
    with pytest.warns(DeprecationWarning, match=warned) as caught:
        configuration = Configuration("FlexOne-v0", {"method": old})
    assert len(caught) == 1 and configuration.method == configuration.to_plain()["method"] == present
    with pytest.warns(DeprecationWarning, match=warned):
        assert find_scenario(f"FlexOne-v0/method={old}").environment.method == present


def test_a_stored_environment_is_read_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stored = Configuration.from_plain({"id": "FlexOne-v0", "method": "gauss_2_sweeps"})
    assert stored.method == "gauss_2"
    with pytest.raises(KeyError, match="nothing"):
        assert fm.METHODS["nothing"]
