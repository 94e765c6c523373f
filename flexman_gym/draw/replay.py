"""Replay: a page of episodes that opens from the disk, where arms move side by side and can be turned round.

The page holds states and the shapes of the links, no meshes, and works out where they are by itself.
"""

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.draw.camera import direction
from flexman_gym.draw.frames import BELOW, FramePainter
from flexman_gym.draw.mesh import outlines
from flexman_gym.draw.style import BLUE, GREEN, ORANGE, RED, SKY, round_number
from flexman_gym.model.curves import curves, link_shapes
from flexman_gym.model.model import Model
from flexman_gym.simulation.episode import Episode

PLACES = Path(__file__).parent
POINTS = 24  # of the curve of a link
COLOURS = (BLUE, RED, GREEN, ORANGE, SKY, "#CC79A7", "#555555", "#8a6d3b")
SHOWN = 60  # states of an episode by which camera and scales are chosen
STEPS = 2**15 - 1  # of a reading, either way from the middle
GAP = -STEPS - 1  # step of a reading that is no finite number: its curve has a gap there


def replay_page(episodes: Sequence[Episode], title: str = "") -> str:
    """Gives the page, HTML that needs no network.

    Args:
        episodes: 1 to 8, side by side; each with its own arm.
        title: of the page; "" for that of the first environment and who acts.

    Raises:
        ValueError: for none or more than 8 episodes.
    """
    if not 1 <= len(episodes) <= len(COLOURS):
        raise refusal("episodes", len(episodes), f"1 to {len(COLOURS)} of them")
    arms: list[dict[str, Any]] = []
    runs = []
    for episode, colour in zip(episodes, COLOURS, strict=False):
        arm = page_arm(episode.model)
        if arm not in arms:
            arms.append(arm)
        runs.append(_run(episode, colour) | {"arm": arms.index(arm)})
    names = [episode.name for episode in episodes]
    for i, name in enumerate(names):
        if names.count(name) > 1:
            runs[i]["name"] = f"{name} {i + 1}"
    first = episodes[0].about
    told = {"seed": first.get("seed"), "settings": first.get("hash"), **first.get("versions", {})}
    words = " \N{MIDDLE DOT} ".join(f"{name} {value}" for name, value in told.items() if value is not None)
    data = {"live": False, "arms": arms, "runs": runs, "stage": _stage(episodes)}
    return page(data, title or f"{first.get('environment', '')} {' and '.join(names)}".strip(), words)


def page(data: dict[str, Any], title: str, words: str) -> str:
    """Gives the page of plain data; whatever text is in them, none of it is read as a part of the page.

    Args:
        data: "arms", "runs", "stage" and "live".
        title: in the head.
        words: beside it.
    """
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    script, style, frame = (
        (PLACES / f"replay.{suffix}").read_text(encoding="utf-8") for suffix in ("js", "css", "html")
    )
    return Template(frame).substitute(
        title=html.escape(title), about=html.escape(words), data=text, style=style,
        script=script.replace("</script", "<\\/script"), strain=_percent(data["stage"]["strain"]),
    )  # fmt: skip


def page_arm(model: Model) -> dict[str, Any]:
    """Gives what the page needs of a model to draw it, plain; arrays as texts."""
    links, constants = [], model.constants
    painter, sections = FramePainter(model, (16, 16)), outlines(model, POINTS)
    for i, (shapes, section) in enumerate(zip(link_shapes(model, POINTS), sections, strict=True)):
        columns = model.elastic_columns(i)
        links.append({
            "length": float(constants.length[i]), "motor": int(model.motor_columns[i]),
            "axis": constants.axis[i].tolist(), "mount": constants.mount.reshape(-1, 9)[i].tolist(),
            "elastic": [columns.start, columns.stop], "rows": packed(shapes.rows), "slopes": packed(shapes.slopes),
            "before": shapes.before.tolist(), "points": packed(section.points), "normals": packed(section.normals),
            "gauges": packed(section.gauges),
        })  # fmt: skip
    return {"points": POINTS, "width": model.n_dof, "links": links, "radii": painter.radii.tolist()}


def stage(models: Sequence[Model], points: Array, strain: float) -> dict[str, Any]:
    """Gives camera, floor and scale of the page, plain.

    Args:
        models: of the arms.
        points: (p, 3) m, all that should be seen.
        strain: at the ends of the colours; 0 for arms that do not bend.
    """
    reach = max(float(model.constants.length.sum()) for model in models)
    points = np.concatenate([points[np.isfinite(points).all(axis=1)], np.zeros((1, 3))])
    floor = float(points[:, 2].min()) - BELOW * reach
    points = np.concatenate([points, [[0.0, 0.0, floor]]])
    azimuth, elevation = np.radians(direction(models[0])[:2])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    return {"reach": reach, "points": np.round(points, 6).tolist(), "distance": 3.0 * size, "floor": floor,
            "towards": towards.tolist(), "step": round_number(reach / 10), "strain": strain}  # fmt: skip


def packed(values: NDArray[Any], kind: str = "<f4") -> str:
    """Gives numbers as a text that the page reads: base64 of little-endian float32 or of another kind."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def _run(episode: Episode, colour: str) -> dict[str, Any]:
    """What the page shows of an episode."""
    torques = np.vstack([episode.actions, episode.actions[-1:]]) if len(episode.actions) else np.zeros((1, 1))
    return {
        "name": episode.name, "colour": colour, "note": episode.about.get("failure") or "over",
        "dt": episode.period, "rows": len(episode.time),
        "x": packed(episode.states[:, : episode.states.shape[1] // 2]), "target": packed(episode.targets),
        "error": packed(episode.errors), "torque": packed(torques),
        "readings": [_reading(name, values) for name, values in episode.readings.items()],
    }  # fmt: skip


def _reading(name: str, values: Array) -> dict[str, Any]:
    """Return a reading in steps of a part of its finite range; they are more than enough for a curve."""
    known = np.isfinite(values)
    low, high = np.where(known, values, np.inf).min(axis=0), np.where(known, values, -np.inf).max(axis=0)
    low, high = np.where(known.any(axis=0), (low, high), 0.0) / 2  # the difference of two large numbers may be infinite
    middle, scale = low + high, np.maximum((high - low) / STEPS, 1e-30)
    steps = packed(np.where(known, np.rint((np.where(known, values, middle) - middle) / scale), GAP), "<i2")
    return {"name": name, "size": values.shape[1], "values": steps, "scale": scale.tolist(), "middle": middle.tolist()}


def _stage(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Camera and scales by what happens in the episodes."""
    points, largest = [], 0.0
    for episode in episodes:
        some = np.unique(np.linspace(0, len(episode.time) - 1, SHOWN).astype(int))
        bent = curves(episode.model, episode.states[some], POINTS)
        points += [bent.positions[:, :, -1].reshape(-1, 3), episode.targets[some]]
        largest = max(largest, 2.0 * float(np.percentile(np.abs(bent.strains[..., :3]).max(axis=(1, 2, 3)), 90)))
    strain = round_number(largest) if largest > 0.0 else 0.0
    return stage([episode.model for episode in episodes], _corners(np.concatenate(points)), strain)


def _corners(points: Array) -> Array:
    """Some of the points (p, 3): those that are outermost in one of many directions."""
    known = points[np.isfinite(points).all(axis=1)]
    turn = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    ways = np.array([[np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)] for a in turn for b in turn])
    corners: Array = known[np.unique((known @ ways.T).argmax(axis=0))]
    return corners


def _percent(strain: float) -> str:
    return f"{1e6 * strain:g} µε" if strain < 1e-3 else f"{1e2 * strain:g} %"
