"""Live page: running episodes in a browser, and controls of the page."""

import hashlib
import json
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from flexman_gym.common.arrays import Array
from flexman_gym.model.model import Model
from flexman_gym.toolbox.view.live_server import Control, LiveServer
from flexman_gym.toolbox.view.replay import COLOURS, arm_data, encode_array, html_page, view_data

QUEUE_SIZE = 200  # messages by which a slow browser may lag behind before its stream is started anew
KEEP_ALIVE = 10.0  # s; time without a message after which a comment finds out if a browser is still there
CATCH_UP = 0.2  # s; longest delay after which the simulation hurries to be in real time again


class LiveScene(NamedTuple):
    """Contents of a live page: an arm, once for each of the agents.

    Attributes:
        model: model of the arm.
        title: title of the page.
        names: names of the agents.
        period: time between two rows, s.
        points: points (p, 3), m, in the picture.
        strain: strain at the ends of the colour scale; 0 for a rigid arm.
        gain: magnification of the deflection of the links at the start.
        controls: description of the controls, JSON-compatible; None for a page without controls.
    """

    model: Model
    title: str
    names: Sequence[str]
    period: float
    points: Array
    strain: float
    gain: float = 1.0
    controls: dict[str, Any] | None = None


class LivePage:
    """Page of running episodes in a browser, on a local web server whose address is printed to stderr.

    Args:
        control: function of a control message, a mapping, that returns the answer, or raises an exception whose message
            is the answer; None for a page without controls.
        port: port of the server; 0 for a free port.

    Attributes:
        url: address of the page, with a random token, see `LiveServer`.
        html: page without an arm, which comes with the first episode.
        shown, late: number of calls of `wait`, and number of those that came later than in real time.
    """

    def __init__(self, control: Control | None = None, port: int = 0) -> None:
        self.control, self.html = control, html_page({"live": True}, "flexman_gym", "live").encode()
        self._clients: list[queue.Queue[bytes]] = []
        self._rows: list[bytes] = []
        self._scene, self._state = b"", b""
        self._lock = threading.Lock()
        self.shown, self.late, self._next = 0, 0, 0.0
        self._server = LiveServer(self, port)
        self.url = self._server.url
        print(f"the arm is shown at {self.url}", file=sys.stderr, flush=True)

    def begin(self, scene: LiveScene) -> None:
        """Start an episode; a page with a different arm, agents or controls is loaded anew."""
        runs = [{"name": name, "colour": colour, "note": "", "dt": scene.period, "rows": 0, "arm": 0}
                for name, colour in zip(scene.names, COLOURS, strict=False)]  # fmt: skip
        arm, views = arm_data(scene.model), [scene.model]
        text = json.dumps([arm, runs, scene.title, scene.controls])
        layout = hashlib.sha256(text.encode()).hexdigest()[:16]
        data = {"live": True, "layout": layout, "title": scene.title, "arms": [arm], "runs": runs,
                "controls": scene.controls,
                "stage": view_data(views, scene.points, scene.strain, scene.gain)}  # fmt: skip
        with self._lock:
            self._scene, self._rows = _event("begin", json.dumps(data, allow_nan=False)), []
            self._send(self._scene)
        self._next = time.perf_counter()

    def show(self, rows: Array) -> None:
        """Send rows (k, agents, size) of k control periods.

        A row holds the generalised coordinates (d,), the target of the tip (3,), m, the distance of the tip from it, m,
        the commanded motor torques (n,) as fractions of their limits, and the strains (3 n,) at the roots of the links.
        """
        message = b"data: " + encode_array(rows).encode() + b"\n\n"
        with self._lock:
            self._rows.append(message)
            self._send(message)

    def set_state(self, state: dict[str, Any]) -> None:
        """Send the state of the controls, JSON-compatible data."""
        with self._lock:
            self._state = _event("state", json.dumps(state, allow_nan=False))
            self._send(self._state)

    def wait(self, period: float) -> None:
        """Wait until a time, s, has passed since the end of the previous call, or since the start of the episode."""
        self.shown += 1
        now, self._next = time.perf_counter(), self._next + period
        if now > self._next:
            self.late, self._next = self.late + 1, max(self._next, now - CATCH_UP)
        else:
            time.sleep(self._next - now)

    def _send(self, message: bytes) -> None:
        for client in self._clients:
            if client.full():  # its stream ends; the browser opens a new one, which begins with the whole episode
                client.queue.clear()
                client.put_nowait(b"")
                self._clients = [each for each in self._clients if each is not client]
            else:
                client.put_nowait(message)

    def stream(self, write: Callable[[bytes], Any]) -> None:
        """Write the messages of the episode so far, and the following ones until the page is closed.

        Args:
            write: function that sends bytes to a browser, and raises OSError if it has closed the connection.
        """
        with self._lock:
            client: queue.Queue[bytes] = queue.Queue(QUEUE_SIZE)
            self._clients = [*self._clients, client]
            message = b"".join([b"retry: 500\n", self._scene, *self._rows, self._state])
        try:
            while message:
                write(message)
                try:
                    message = client.get(timeout=KEEP_ALIVE)
                except queue.Empty:
                    message = b":\n\n"
        finally:
            with self._lock:
                self._clients = [each for each in self._clients if each is not client]

    def close(self) -> None:
        """End the streams and stop the server; print the number of late states, if any, to stderr."""
        with self._lock:
            for client in self._clients:
                client.queue.clear()
                client.put_nowait(b"")
        self._server.close()
        if self.late:
            print(f"{self.late} of {self.shown} steps came late", file=sys.stderr)


def _event(name: str, data: str) -> bytes:
    return f"event: {name}\ndata: {data}\n\n".encode()
