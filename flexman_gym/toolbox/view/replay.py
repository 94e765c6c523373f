"""Replay page in a browser: saved episodes as one HTML file; parts of its data that the live page shares."""

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.common.plot_style import DARK, LINK_COLOURS, VIOLET, round_up
from flexman_gym.model.deformation import curves, link_shapes
from flexman_gym.model.model import Model
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.view.comparison import suggested_gain
from flexman_gym.toolbox.view.frames import FLOOR_GAP, FramePainter, limiting_strains
from flexman_gym.toolbox.view.mesh import section_outlines

TEMPLATE_FOLDER = Path(__file__).parent
POINTS = 24  # number of drawn points on the centreline of a link
COLOURS = (*LINK_COLOURS, VIOLET, DARK)
VIEW_STATES = 60  # number of states of an episode from which camera and scales are computed
QUANTISATION_STEPS = 2**15 - 1  # int16; steps of a reading from the middle of its range to each end
MISSING_VALUE = -QUANTISATION_STEPS - 1  # int16; step of a reading that is not finite, a gap in its curve


def replay_page(episodes: Sequence[Episode], title: str = "") -> str:
    """Return an HTML page that replays episodes in a browser without a network connection.

    Args:
        episodes: 1 to 8 episodes, shown side by side; the arms may differ.
        title: title of the page; "" for a title of environment and agents.
    """
    if not 1 <= len(episodes) <= len(COLOURS):
        raise value_error("episodes", len(episodes), f"1 to {len(COLOURS)} of them")
    arms: list[dict[str, Any]] = []
    runs = []
    for episode, colour in zip(episodes, COLOURS, strict=False):
        arm = arm_data(episode.model)
        if arm not in arms:
            arms.append(arm)
        runs.append(_episode_data(episode, colour) | {"arm": arms.index(arm)})
    names = [episode.name for episode in episodes]
    for i, name in enumerate(names):
        if names.count(name) > 1:
            runs[i]["name"] = f"{name} {i + 1}"
    first = episodes[0].about
    about = {"seed": first.get("seed"), "settings": first.get("hash"), **first.get("versions", {})}
    words = " \N{MIDDLE DOT} ".join(f"{name} {value}" for name, value in about.items() if value is not None)
    stage, title = _episodes_view(episodes), title or f"{first.get('environment', '')} {' and '.join(names)}".strip()
    stage["ends"] = " or ".join(dict.fromkeys("limit" if "scales" in run else stage["ends"] for run in runs))
    return html_page({"live": False, "title": title, "arms": arms, "runs": runs, "stage": stage}, title, words)


def html_page(data: dict[str, Any], title: str, words: str) -> str:
    """Return the HTML page of JSON-compatible data, with escaped texts.

    Args:
        data: mapping with "live", and for a replay with "title", "arms", "runs" and "stage".
        title: title of the page.
        words: text next to the title.
    """
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    script, style, frame = (
        (TEMPLATE_FOLDER / f"replay.{suffix}").read_text(encoding="utf-8") for suffix in ("js", "css", "html")
    )
    return Template(frame).substitute(
        title=html.escape(title), about=html.escape(words), data=text, style=style,
        script=script.replace("</script", "<\\/script"),
    )  # fmt: skip


def arm_data(model: Model) -> dict[str, Any]:
    """Return the data of a model for the page as JSON-compatible data, with arrays encoded as base64."""
    links, constants = [], model.constants
    painter, sections = FramePainter(model, (16, 16)), section_outlines(model, POINTS)
    for i, (shapes, section) in enumerate(zip(link_shapes(model, POINTS), sections, strict=True)):
        columns = model.elastic_columns(i)
        links.append({
            "length": float(constants.length[i]), "motor": int(model.motor_columns[i]),
            "axis": constants.axis[i].tolist(), "mount": constants.mount.reshape(-1, 9)[i].tolist(),
            "elastic": [columns.start, columns.stop], "rows": encode_array(shapes.rows),
            "slopes": encode_array(shapes.slopes),
            "before": shapes.inboard.tolist(), "points": encode_array(section.points),
            "normals": encode_array(section.normals),
            "gauges": encode_array(section.gauges),
        })  # fmt: skip
    return {"points": POINTS, "width": model.n_dof, "links": links, "radii": painter.radii.tolist()}


def view_data(models: Sequence[Model], points: Array, strain: float, gain: float = 1.0) -> dict[str, Any]:
    """Return reach, points, camera, floor, scale and text of its ends for the page as JSON-compatible data.

    Args:
        models: models of the arms.
        points: points (p, 3), m, in the picture.
        strain: strain at the ends of the colour scale; 0 for rigid arms.
        gain: magnification of the deflection of the links at the start.
    """
    reach = max(float(model.constants.length.sum()) for model in models)
    points = np.concatenate([points[np.isfinite(points).all(axis=1)], np.zeros((1, 3))])
    floor = float(points[:, 2].min()) - FLOOR_GAP * reach
    points = np.concatenate([points, [[0.0, 0.0, floor]]])
    azimuth, elevation = np.radians(FramePainter(models[0], (16, 16)).direction[:2])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    return {"reach": reach, "points": np.round(points, 6).tolist(), "distance": 3.0 * size, "floor": floor,
            "towards": towards.tolist(), "step": round_up(reach / 10), "strain": strain, "gain": gain,
            "ends": _percent(strain) if strain else ""}  # fmt: skip


def encode_array(values: NDArray[Any], kind: str = "<f4") -> str:
    """Return numbers as base64 of little-endian float32, or of another NumPy type."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def _episode_data(episode: Episode, colour: str) -> dict[str, Any]:
    """Return the data of an episode for the page as JSON-compatible data."""
    torques = np.vstack([episode.actions, episode.actions[-1:]]) if len(episode.actions) else np.zeros((1, 1))
    return {
        "name": episode.name, "colour": colour, "note": episode.about.get("failure") or "over",
        "dt": episode.period, "rows": len(episode.time),
        "x": encode_array(episode.states[:, : episode.states.shape[1] // 2]), "target": encode_array(episode.targets),
        "error": encode_array(episode.errors), "torque": encode_array(torques),
        "readings": [_reading_data(name, values) for name, values in episode.readings.items()],
        "violations": episode.about.get("violations", []), **_limit_data(episode),
    }  # fmt: skip


def _limit_data(episode: Episode) -> dict[str, list[float]]:
    """Return the strains of the links at the ends of the colour scale, if the environment limits them."""
    limit = episode.about.get("limits", {}).get("strain")
    return {} if limit is None else {"scales": limiting_strains(episode.model, limit).tolist()}


def _reading_data(name: str, values: Array) -> dict[str, Any]:
    """Return a reading (T + 1, k) as JSON-compatible data, quantised in the range of its finite values."""
    finite = np.isfinite(values)
    low, high = np.where(finite, values, np.inf).min(axis=0), np.where(finite, values, -np.inf).max(axis=0)
    low, high = np.where(finite.any(axis=0), (low, high), 0.0) / 2  # halves, as the range itself may overflow
    middle, scale = low + high, np.maximum((high - low) / QUANTISATION_STEPS, 1e-30)
    steps = encode_array(
        np.where(finite, np.rint((np.where(finite, values, middle) - middle) / scale), MISSING_VALUE), "<i2"
    )
    return {"name": name, "size": values.shape[1], "values": steps, "scale": scale.tolist(), "middle": middle.tolist()}


def _episodes_view(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Return camera, floor and scale of the page for several episodes, as JSON-compatible data."""
    points, largest, gain = [], 0.0, suggested_gain(episodes)
    for episode in episodes:
        some = np.unique(np.linspace(0, len(episode.time) - 1, VIEW_STATES).astype(int))
        bent = curves(episode.model, episode.states[some], POINTS)
        drawn = curves(episode.model, episode.states[some], 2, gain, 1.0).positions[:, :, -1]
        points += [drawn.reshape(-1, 3), bent.positions[:, -1, -1], episode.targets[some]]
        largest = max(largest, 2.0 * float(np.percentile(np.abs(bent.strains[..., :3]).max(axis=(1, 2, 3)), 90)))
    strain = round_up(largest) if largest > 0.0 else 0.0
    models = [episode.model for episode in episodes]
    return view_data(models, _outermost_points(np.concatenate(points)), strain, gain)


def _outermost_points(points: Array) -> Array:
    """Return the points, among points (p, 3), that are outermost in one of 144 directions."""
    finite = points[np.isfinite(points).all(axis=1)]
    turn = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    directions = np.array([[np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)] for a in turn for b in turn])
    corners: Array = finite[np.unique((finite @ directions.T).argmax(axis=0))]
    return corners


def _percent(strain: float) -> str:
    return f"{1e6 * strain:g} µε" if strain < 1e-3 else f"{1e2 * strain:g} %"
