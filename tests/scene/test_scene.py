"""Scene: a scene file is read and written without loss, and whatever is not a scene is refused in one clear line."""

import copy
import json
import math
import warnings
from dataclasses import replace
from functools import partial, reduce

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import IDENTITY, Link, NonUniformLink
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.serialization import find_arm
from flexman_gym.scene.signals import ConstantTorque, SineTorque

from oracles.assertions import offenders, refusal
from oracles.files import REFERENCE

# Of the printed area of link 1 in the reference scene.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")
with warnings.catch_warnings():
    warnings.simplefilter("ignore", UserWarning)
    SCENE = Scene.load(REFERENCE / "paper_ff.json")
triples = st.tuples(*[st.floats(0.0, 100.0)] * 3)


@given(st.builds(ConstantTorque, triples) | st.builds(SineTorque, triples, triples, triples), st.floats(0.0, 10.0))
def test_the_signals_of_a_torque_are_its_formula(torque, time):
    signals = torque.signals()
    assert len(signals) == 3 and all(signal.start == 0.0 and signal.stop is None for signal in signals)
    numbers = [(signal.offset, signal.amplitude, signal.frequency_hz, signal.phase) for signal in signals]
    offset, amplitude, frequency_hz, phase = np.transpose(numbers)
    expected = offset + amplitude * np.sin(2.0 * np.pi * frequency_hz * time + phase)
    assert torque.at(time) == pytest.approx(expected, rel=0.0, abs=1e-8)


def test_a_torque_at_a_quarter_of_its_period_is_its_amplitude():
    assert SineTorque([3.0, 2.0], [0.25, 0.25], [0.0, math.pi / 2]).at(1.0) == pytest.approx([3.0, 0.0])
    assert ConstantTorque([3.0, 2.0]).at(1.0) == pytest.approx([3.0, 2.0])


@given(st.integers(1, 100_000), st.floats(1e-6, 1e3))
def test_output_times_run_from_zero_to_the_duration(steps, output_step):
    times = replace(SCENE, duration=steps * output_step, output_step=output_step).output_times
    assert times.shape == (steps + 1,)
    assert times[0] == 0.0 and times[-1] == steps * output_step
    assert np.allclose(np.diff(times), output_step, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize(
    ("duration", "output_step"), [(1.5, 0.4), (1.0, 2.0), (1.0, 0.333), (1e300, 1e-300), (1.0, 1e-8)]
)
def test_the_duration_is_a_whole_number_of_output_steps(duration, output_step):
    line = refusal(lambda: replace(SCENE, duration=duration, output_step=output_step))
    assert line.startswith(f"Scene.output_step: {output_step} is not allowed")


@pytest.mark.parametrize(
    ("part", "value", "field"),
    [
        ("arm", None, "arm"),
        ("model", {}, "Scene.model"),
        ("torque", (1.0, 1.0, 1.0), "Scene.torque"),
        ("initial", (0.0, 0.0, 0.0), "Scene.initial"),
        ("note", 1, "Scene.note"),
        ("model", ModelChoice(True, (2, 2)), "Scene.model.elements"),
        ("model", ModelChoice((True,), 2), "Scene.model.flexible_links"),
        ("model", ModelChoice(True, 2, (1, 1, 1, 1)), "Scene.model.modes"),
        ("torque", ConstantTorque([1.0]), "Scene.torque.value"),
        ("torque", SineTorque([1.0], [1.0], [1.0]), "Scene.torque.amplitude"),
        ("initial", Initial([0.0], [0.0]), "Scene.initial.joint_angles"),
    ],
)
def test_the_parts_of_a_scene_fit_each_other(part, value, field):
    assert refusal(lambda: replace(SCENE, **{part: value})).startswith(f"{field}: ")


@pytest.mark.parametrize(
    ("entries", "field"),
    [
        ({"flexible_links": 1}, "flexible_links"),
        ({"flexible_links": [True, "no"]}, "flexible_links[1]"),
        ({"elements": 0}, "elements"),
        ({"elements": 65}, "elements"),
        ({"elements": 2.0}, "elements"),
        ({"elements": True}, "elements"),
        ({"elements": ()}, "elements"),
        ({"elements": np.array([2, 65])}, "elements[1]"),
        ({"modes": -1}, "modes"),
        ({"modes": [385]}, "modes[0]"),
        ({"modes": [4, (0, 384)]}, "modes[1][1]"),
        ({"modes": [4, (3, 1)]}, "modes[1]"),
        ({"modes": [4, (1, 1)]}, "modes[1]"),
        ({"modes": [()]}, "modes[0]"),
        ({"flexible_joints": None}, "flexible_joints"),
        ({"stiffening": "yes"}, "stiffening"),
        ({"rotary_inertia": 0}, "rotary_inertia"),
    ],
)
def test_a_model_choice_refuses(entries, field):
    line = refusal(lambda: ModelChoice(**({"flexible_links": True, "elements": 2} | entries)))
    assert line.startswith(f"ModelChoice.{field}: ")


def test_a_model_choice_takes_one_value_or_one_for_each_link():
    assert ModelChoice(np.array([True, False]), np.array([2, 3]), [4, 0]) == ModelChoice((True, False), (2, 3), (4, 0))
    assert ModelChoice(True, 2).modes is None
    assert ModelChoice(True, 2, [3, np.array([0, 2])]).modes == (3, (0, 2))


def test_sine_torques_agree_in_length_and_have_no_negative_frequency():
    assert refusal(SineTorque, [1.0, 1.0], [1.0], [0.0, 0.0]).startswith("SineTorque.frequency_hz: ")
    assert refusal(SineTorque, [1.0], [-1.0], [0.0]).startswith("SineTorque.frequency_hz[0]: -1.0")
    assert refusal(Initial, [0.0], [0.0, 0.0]).startswith("Initial.joint_rates: ")


REFERENCES = sorted(REFERENCE.glob("*.json"))
# Of the printed area of link 1 in the reference scenes, and of sections of any numbers.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning", "ignore:.*wrong unit")
with warnings.catch_warnings():
    warnings.simplefilter("ignore", UserWarning)
    SCENE = Scene.load(REFERENCES[0])
GIVEN = SCENE.to_dict()
GIVEN["model"] |= {"modes": [4, [0, 1, 3], 4], "rotary_inertia": False}
UNIFORM = {name: value for name, value in GIVEN["arm"]["links"][1].items() if name != "orientation"}
GIVEN["arm"]["links"][1] = {"sections": [UNIFORM, dict(UNIFORM)], "orientation": [list(row) for row in IDENTITY]}

positive = st.floats(1e-30, 1e30)
number = st.floats(allow_nan=False, allow_infinity=False)
TURNED = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
unit_axis = st.floats(-math.pi, math.pi).map(lambda angle: (math.cos(angle), math.sin(angle), 0.0))


@st.composite
def scenes(draw):
    """Scenes of 1 to 3 links with every part of the file format in use."""
    n = draw(st.integers(1, 3))
    each = lambda entry: st.tuples(*[entry] * n)  # noqa: E731
    numbers = each(number)
    uniform = st.builds(Link, *[positive] * 8)
    stepped = st.builds(NonUniformLink, st.lists(uniform, min_size=1, max_size=3), st.sampled_from([IDENTITY, TURNED]))
    links = draw(each(uniform | stepped))
    rigid = st.builds(Joint, unit_axis, st.just(0.0) | positive)
    springs = st.builds(Joint, unit_axis, positive, positive, st.just(0.0) | positive)
    arm = Arm(
        links,
        draw(each(rigid | springs)),
        draw(st.none() | st.builds(Payload, st.just(0.0) | positive)),
        draw(st.tuples(*[st.floats(-1e30, 1e30)] * 3)),
        draw(st.floats(0.0, 1.0)),
        draw(st.floats(0.0, 1.0, exclude_max=True)),
    )
    numbered = st.sets(st.integers(0, 383), min_size=1, max_size=4).map(lambda modes: tuple(sorted(modes)))
    model = ModelChoice(
        draw(st.booleans() | each(st.booleans())),
        draw(st.integers(1, 64) | each(st.integers(1, 64))),
        draw(st.none() | st.integers(0, 384) | each(st.integers(0, 384) | numbered)),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.booleans()),
    )
    sine = st.builds(SineTorque, numbers, each(st.floats(0.0, 1e300)), numbers)
    torque = draw(st.builds(ConstantTorque, numbers) | sine)
    output_step = draw(st.floats(1e-6, 1e3))
    duration = draw(st.integers(1, 1000)) * output_step
    return Scene(arm, model, torque, Initial(draw(numbers), draw(numbers)), duration, output_step, draw(st.text()))


def keys(data, path=()):
    """Yield the path of every entry below `data`, (key or index, ...)."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from keys(value, (*path, key))


def named(path):
    """Return the field path ("arm", "links", 1) as the errors write it, arm.links[1]."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)[1:]


def holder(data, path):
    """Return the dict or list that holds the entry at `path`."""
    return reduce(lambda part, key: part[key], path[:-1], data)


@pytest.mark.parametrize("path", REFERENCES, ids=lambda path: path.stem)
@pytest.mark.parametrize("suffix", [".json", ".yaml", ".yml"])
def test_a_reference_scene_loads_and_round_trips(path, suffix, tmp_path):
    scene = Scene.load(path)
    assert scene.to_dict() == json.loads(path.read_text())
    scene.save(tmp_path / f"scene{suffix}")
    assert Scene.load(str(tmp_path / f"scene{suffix}")) == scene


@pytest.mark.slow
@given(scenes())
@settings(deadline=None)
def test_what_is_saved_is_what_loads(tmp_path_factory, scene):
    folder = tmp_path_factory.mktemp("scenes")
    assert Scene.from_dict(scene.to_dict()) == scene
    for name in ("scene.json", "scene.yaml"):
        scene.save(folder / name)
        assert Scene.load(folder / name) == scene


@pytest.mark.slow
@given(scenes())
@settings(deadline=None)
def test_a_saved_yaml_scene_is_what_other_readers_see(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("scenes") / "scene.yaml"
    scene.save(path)
    assert {**yaml.safe_load(path.read_text()), "note": ""} == {**scene.to_dict(), "note": ""}


GONE = object()


def load(path, value):
    """Load the scene with another value at `path`, or with GONE without the entry."""
    data = copy.deepcopy(GIVEN)
    entry = holder(data, path)
    entry[path[-1]] = value
    if value is GONE:
        del entry[path[-1]]
    Scene.from_dict(data)


def ill_said(path, values, begin):
    """Return what is wrong with the lines that refuse values at `path`: each begins so and says what is allowed."""
    good = lambda line: line.startswith(begin) and "give " in line and "\n" not in line and len(line) < 420  # noqa: E731
    return [f"{named(path)}: {each}" for each in offenders(partial(load, path), values, good)]


@pytest.mark.parametrize("part", GIVEN)
def test_every_entry_of_a_scene_file_is_checked(part):
    wrong = []
    for path in keys({part: GIVEN[part]}):
        values = [math.nan, math.inf, "one", {"a": 1}, [], None, [[[]]]]
        if path[-1] in ("payload", "stiffness", "modes", "elements"):
            values.remove(None)
        if path == ("note",):
            values.remove("one")
        wrong += ill_said(path, values, named(path))
    assert not wrong, "\n".join(["not as it should be:", *wrong])


@pytest.mark.parametrize("part", GIVEN)
def test_a_key_is_needed_and_no_other_is_known(part):
    wrong = []
    for path in (path for path in keys({part: GIVEN[part]}) if isinstance(path[-1], str)):
        if path[-1] in ("note", "payload", "modes", "rotary_inertia"):
            load(path, GONE)
        elif path[-1] == "sections":  # without them it is a uniform link
            wrong += ill_said(path, [GONE], f"{named(path[:-1])}.length, area, second_moment_y, ")
        else:
            wrong += ill_said(path, [GONE], f"{named(path)}: ")
        other = (*path[:-1], "lenght")
        wrong += ill_said(other, [1.0], f"{named(other)}: 1.0 is not allowed; give only")
    assert not wrong, "\n".join(["not as it should be:", *wrong])


def test_the_error_of_a_file_names_the_file_the_field_the_value_and_what_is_allowed(tmp_path):
    data = SCENE.to_dict()
    data["arm"]["links"][1]["length"] = -1.0
    path = tmp_path / "bent.json"
    path.write_text(json.dumps(data))
    assert refusal(Scene.load, path) == (
        f"{path}: arm.links[1].length: -1.0 is not allowed; give a finite number > 0 (m)"
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"length": -1.0}, "length: -1.0 is not allowed; give a finite number > 0 (m)"),
        ({"orientation": TURNED}, "orientation: "),
    ],
)
def test_the_error_of_a_section_names_its_place(changes, said):
    data = copy.deepcopy(GIVEN)
    data["arm"]["links"][1]["sections"][0] = UNIFORM | changes
    assert refusal(Scene.from_dict, data).startswith(f"arm.links[1].sections[0].{said}")


def test_a_switch_is_written_where_it_is_off():
    assert "rotary_inertia" not in SCENE.to_dict()["model"]
    assert Scene.from_dict(GIVEN).to_dict()["model"]["rotary_inertia"] is False


JSON = json.dumps(SCENE.to_dict())
LINK = "arm:\n  links:\n    - length: "


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("cut.json", JSON[:100], "give valid JSON"),
        ("empty.json", "", "give valid JSON"),
        ("list.json", "[]", "this is no mapping; give names with their values"),
        ("nan.json", JSON.replace('"duration": 1.5', '"duration": NaN'), "duration: nan is not allowed"),
        ("infinity.json", JSON.replace('"duration": 1.5', '"duration": -Infinity'), "duration: -inf is not allowed"),
        ("overflow.json", JSON.replace('"duration": 1.5', '"duration": 1e999'), "duration: inf is not allowed"),
        ("digits.json", JSON.replace('"duration": 1.5', '"duration": ' + "9" * 5000), "give valid JSON"),
        (
            "twice.json",
            '{"arm": {"gravity": 1, "gravity": 2}}',
            "arm.gravity: 2 is not allowed; this key was given before",
        ),
        ("deep.json", "[" * 100_000, "nested too deeply"),
        ("key.json", '{"a\\nb": 1}', "the key 'a\\nb' is not allowed"),
        ("long.json", " " * 1_000_001, "a size of 1000001 bytes is not allowed"),
        ("empty.yaml", "", "this is no mapping; give names with their values"),
        ("broken.yaml", "arm: [1, 2\nmodel: {", "line 2"),
        ("control.yaml", "arm: \x01", "give valid YAML"),
        ("two.yaml", "a: 1\n---\nb: 2\n", "2 documents separated by --- are not allowed; give one"),
        ("twice.yaml", LINK + "1.0\n      length: 2.0\n", "arm.links[0].length: 2.0 is not allowed"),
        ("key.yaml", "[1, 2]: 3\n", "the key [1, 2] is not allowed"),
        ("number.yaml", "1: 3\n", "the key 1 is not allowed"),
        ("deep.yaml", "[" * 100_000, "nested too deeply"),
        ("alias.yaml", "a: &a [1]\nb: [*a, *a]\n", "line 1: anchors, aliases and tags are not allowed"),
        ("undefined.yaml", "b: *a\n", "line 1: anchors, aliases and tags are not allowed"),
        ("python.yaml", "arm: !!python/object/apply:os.getcwd []\n", "anchors, aliases and tags are not allowed"),
        ("tag.yaml", "arm: !!float 1\n", "anchors, aliases and tags are not allowed"),
        ("scene.txt", JSON, "give one of .json, .yaml, .yml"),
        ("scene", JSON, "give one of .json, .yaml, .yml"),
    ],
    ids=lambda value: value if "." in value[:20] and len(value) < 20 else "",
)
def test_a_file_that_is_no_scene_is_refused(name, content, said, tmp_path):
    path = tmp_path / name
    path.write_text(content)
    line = refusal(Scene.load, path)
    assert line.startswith(f"{path}: ") and said in line


def test_bytes_directories_and_missing_files_are_refused(tmp_path):
    (tmp_path / "latin.yaml").write_bytes(b"note: \xe9t\xe9")
    assert "byte 6 is not UTF-8" in refusal(Scene.load, tmp_path / "latin.yaml")
    (tmp_path / "folder.json").mkdir()
    assert "give a file" in refusal(Scene.load, tmp_path / "folder.json")
    with pytest.raises(FileNotFoundError, match=r"missing\.json: there is no such file"):
        Scene.load(tmp_path / "missing.json")
    assert "give one of .json, .yaml, .yml" in refusal(SCENE.save, tmp_path / "scene.toml")


def test_yaml_has_the_numbers_and_words_of_json_alone(tmp_path):
    path, text = tmp_path / "scene.yaml", yaml.dump(SCENE.to_dict())
    for written in ("1:30", "0x10", "0o17", "010", "1_0", "yes", ".inf", ".nan", "2026-01-01"):
        path.write_text(text.replace("duration: 1.5", f"duration: {written}"))
        assert f"duration: '{written}' is not allowed" in refusal(Scene.load, path)
    for written in ("15e-1", "1.5e0", "0.15e+1"):
        path.write_text(text.replace("duration: 1.5", f"duration: {written}"))
        assert Scene.load(path) == SCENE, written


@pytest.mark.slow
@given(st.binary() | st.text().map(str.encode) | st.text("[]{}:,-?!&*\"' \n01e.a#|>%").map(str.encode))
@settings(deadline=None)
def test_any_bytes_are_refused_in_one_line(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("bytes")
    for name in ("scene.json", "scene.yaml"):
        (folder / name).write_bytes(content)
        assert refusal(Scene.load, folder / name).startswith(f"{folder / name}: ")


def test_all_missing_keys_of_a_part_are_named_at_once():
    joint = {"axis": [0, 0, 1], "rotor_inertia": 0.1}
    link = {"shape": "strip", "length": 0.5, "width": 0.04, "thickness": 0.003}
    plain = {"links": [link], "joints": [joint], "gravity": [0, 0, 0], "stiffness_proportional_damping": 0.0}
    line = refusal(find_arm, plain)
    assert line.startswith("arm.joints[0].stiffness, damping: missing; give the keys axis, rotor_inertia, stiffness, ")
    assert find_arm({**plain, "joints": [{**joint, "stiffness": None, "damping": 0.0}]}).n_joints == 1
