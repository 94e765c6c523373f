"""Replay page in a browser: saved episodes as one HTML file, and a live page of a running environment."""

import base64
import html
import http.server
import json
import queue
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.common.plot_style import BLUE, DARK, LINK_COLOURS, VIOLET, round_up
from flexman_gym.draw.comparison import suggested_gain
from flexman_gym.draw.frames import FLOOR_GAP, FramePainter, limiting_strains
from flexman_gym.draw.mesh import section_outlines
from flexman_gym.model.deformation import curves, link_shapes
from flexman_gym.model.model import Model
from flexman_gym.simulation.episode import Episode

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
        arm = _arm_data(episode.model)
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
    data = {"live": False, "arms": arms, "runs": runs, "stage": _episodes_view(episodes)}
    return _html_page(data, title or f"{first.get('environment', '')} {' and '.join(names)}".strip(), words)


def _html_page(data: dict[str, Any], title: str, words: str) -> str:
    """Return the HTML page of JSON-compatible data, with escaped texts.

    Args:
        data: mapping with "arms", "runs", "stage" and "live".
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
        strain=" or ".join(dict.fromkeys("limit" if "scales" in run else _percent(data["stage"]["strain"])
                                         for run in data["runs"])),
    )  # fmt: skip


def _arm_data(model: Model) -> dict[str, Any]:
    """Return the data of a model for the page as JSON-compatible data, with arrays encoded as base64."""
    links, constants = [], model.constants
    painter, sections = FramePainter(model, (16, 16)), section_outlines(model, POINTS)
    for i, (shapes, section) in enumerate(zip(link_shapes(model, POINTS), sections, strict=True)):
        columns = model.elastic_columns(i)
        links.append({
            "length": float(constants.length[i]), "motor": int(model.motor_columns[i]),
            "axis": constants.axis[i].tolist(), "mount": constants.mount.reshape(-1, 9)[i].tolist(),
            "elastic": [columns.start, columns.stop], "rows": _encode_array(shapes.rows),
            "slopes": _encode_array(shapes.slopes),
            "before": shapes.inboard.tolist(), "points": _encode_array(section.points),
            "normals": _encode_array(section.normals),
            "gauges": _encode_array(section.gauges),
        })  # fmt: skip
    return {"points": POINTS, "width": model.n_dof, "links": links, "radii": painter.radii.tolist()}


def _view_data(models: Sequence[Model], points: Array, strain: float, gain: float = 1.0) -> dict[str, Any]:
    """Return reach, points, camera, floor and scale of the page as JSON-compatible data.

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
            "towards": towards.tolist(), "step": round_up(reach / 10), "strain": strain, "gain": gain}  # fmt: skip


def _encode_array(values: NDArray[Any], kind: str = "<f4") -> str:
    """Return numbers as base64 of little-endian float32, or of another NumPy type."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def _episode_data(episode: Episode, colour: str) -> dict[str, Any]:
    """Return the data of an episode for the page as JSON-compatible data."""
    torques = np.vstack([episode.actions, episode.actions[-1:]]) if len(episode.actions) else np.zeros((1, 1))
    return {
        "name": episode.name, "colour": colour, "note": episode.about.get("failure") or "over",
        "dt": episode.period, "rows": len(episode.time),
        "x": _encode_array(episode.states[:, : episode.states.shape[1] // 2]), "target": _encode_array(episode.targets),
        "error": _encode_array(episode.errors), "torque": _encode_array(torques),
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
    steps = _encode_array(
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
    return _view_data(models, _outermost_points(np.concatenate(points)), strain, gain)


def _outermost_points(points: Array) -> Array:
    """Return the points, among points (p, 3), that are outermost in one of 144 directions."""
    finite = points[np.isfinite(points).all(axis=1)]
    turn = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    directions = np.array([[np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)] for a in turn for b in turn])
    corners: Array = finite[np.unique((finite @ directions.T).argmax(axis=0))]
    return corners


def _percent(strain: float) -> str:
    return f"{1e6 * strain:g} µε" if strain < 1e-3 else f"{1e2 * strain:g} %"


QUEUE_SIZE = 200  # states by which a slow browser may lag behind before states are dropped


class LivePage:
    """Page of a running environment in a browser, on a local web server whose address is printed to stderr.

    Args:
        model: model of the arm.
        title: title of the page.
        period: time between two states, s.
        strain: strain at the ends of the colour scale; 0 for a rigid arm.

    Attributes:
        address: address of the page.
        shown, late: number of shown states, and number of states shown later than in real time.
    """

    def __init__(self, model: Model, title: str, period: float, strain: float) -> None:
        self._model, self._title, self._period, self._strain = model, title, period, strain
        self._clients: list[queue.Queue[bytes]] = []
        self._rows: list[bytes] = []
        self._lock = threading.Lock()
        self._page = b""
        self.shown, self.late, self._next = 0, 0, 0.0
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"
        print(f"the arm is shown at {self.address}", file=sys.stderr, flush=True)

    def begin(self, points: Array) -> None:
        """Start an episode.

        Args:
            points: points (p, 3), m, in the picture.
        """
        run = {"name": self._title, "colour": BLUE, "note": "", "dt": self._period, "rows": 0, "arm": 0}
        data = {"live": True, "arms": [_arm_data(self._model)], "runs": [run],
                "stage": _view_data([self._model], points, self._strain)}  # fmt: skip
        with self._lock:
            self._page, self._rows = _html_page(data, self._title, "live").encode(), []
            self._send(b"event: begin\ndata: \n\n")
        self._next = time.perf_counter()

    def show(self, coordinates: Array, target: Array, error: float, torques: Array) -> None:
        """Send the state of the arm and wait until the time of this state.

        Args:
            coordinates: generalised coordinates (d,).
            target: target of the tip (3,), m.
            error: distance of the tip from the target, m.
            torques: commanded motor torques (n,) as fractions of their limits.
        """
        row = np.concatenate([coordinates, target, [error], torques])
        message = b"data: " + _encode_array(row).encode() + b"\n\n"
        with self._lock:
            self._rows.append(message)
            self._send(message)
        self.shown += 1
        now, self._next = time.perf_counter(), self._next + self._period
        if now > self._next:
            self.late, self._next = self.late + 1, now
        else:
            time.sleep(self._next - now)

    def _send(self, message: bytes) -> None:
        for client in self._clients:
            if not client.full():
                client.put_nowait(message)

    def listen(self) -> "tuple[bytes, queue.Queue[bytes]]":
        """Return the messages of the episode so far, and a queue of the following ones."""
        with self._lock:
            client: queue.Queue[bytes] = queue.Queue(QUEUE_SIZE)
            self._clients.append(client)
            return b"".join(self._rows), client

    def leave(self, client: "queue.Queue[bytes]") -> None:
        """Remove the queue of a closed connection."""
        with self._lock:
            self._clients.remove(client)

    def html(self) -> bytes:
        """Return the page of the present episode."""
        return self._page

    def close(self) -> None:
        """Stop the server; print the number of late states, if any, to stderr."""
        self._server.shutdown()
        self._server.server_close()
        if self.late:
            print(f"{self.late} of {self.shown} steps came late", file=sys.stderr)


def _handler(live: LivePage) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        """Handler that serves the page at / and the events at /live."""

        def log_message(self, *_: Any) -> None:
            pass

        def do_GET(self) -> None:
            types = {"/": "text/html; charset=utf-8", "/live": "text/event-stream"}
            self.send_response(200 if self.path in types else 404)
            self.send_header("Content-Type", types.get(self.path, "text/plain"))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            if self.path == "/":
                self.wfile.write(live.html())
            if self.path == "/live":
                self._stream()

        def _stream(self) -> None:
            before, client = live.listen()
            try:
                self.wfile.write(before)
                while True:
                    self.wfile.write(client.get())
            except OSError:  # the browser closed the connection
                live.leave(client)

    return Handler
