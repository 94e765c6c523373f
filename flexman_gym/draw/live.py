"""Live page: running episodes in a browser, on a web server of the local host, and controls of the page."""

import hashlib
import http.server
import json
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.draw.replay import COLOURS, arm_data, encode_array, html_page, view_data
from flexman_gym.model.model import Model

QUEUE_SIZE = 200  # messages by which a slow browser may lag behind before its stream is started anew
MAX_BODY = 65536  # bytes; longest control message
HOSTS = ("127.0.0.1", "localhost")  # host names under which the page answers, against DNS rebinding
HEADERS = {  # of every answer: nothing is stored, and the page loads nothing from elsewhere
    "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'",
}  # fmt: skip
CATCH_UP = 0.2  # s; longest delay after which the simulation hurries to be in real time again
Control = Callable[[dict[str, Any]], dict[str, Any]]


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
        control: function of a control message, a mapping, that returns the answer, or raises ValueError or OSError with
            a one-line message; None for a page without controls.
        port: port of the server; 0 for a free port.

    Attributes:
        url: address of the page.
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
        try:
            self._server = http.server.ThreadingHTTPServer(
                ("127.0.0.1", port), type("Handler", (_Handler,), {"live": self})
            )
        except OSError as error:  # such as a port in use
            raise value_error("port", port, f"a free port, or 0 for any free port ({error.strerror})") from None
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/"
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

    def listen(self) -> "tuple[bytes, queue.Queue[bytes]]":
        """Return the messages of the episode so far, and a queue of the following ones."""
        with self._lock:
            client: queue.Queue[bytes] = queue.Queue(QUEUE_SIZE)
            self._clients = [*self._clients, client]
            return b"".join([b"retry: 500\n", self._scene, *self._rows, self._state]), client

    def leave(self, client: "queue.Queue[bytes]") -> None:
        """Remove the queue of a closed connection."""
        with self._lock:
            self._clients = [each for each in self._clients if each is not client]

    def close(self) -> None:
        """End the streams and stop the server; print the number of late states, if any, to stderr."""
        with self._lock:
            for client in self._clients:
                client.queue.clear()
                client.put_nowait(b"")
        self._server.shutdown()
        self._server.server_close()
        if self.late:
            print(f"{self.late} of {self.shown} steps came late", file=sys.stderr)


def _event(name: str, data: str) -> bytes:
    return f"event: {name}\ndata: {data}\n\n".encode()


class _Handler(http.server.BaseHTTPRequestHandler):
    """Handler that serves the page at /, the events at /live, and takes control messages at /control."""

    live: LivePage

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        types = {"/": "text/html; charset=utf-8", "/live": "text/event-stream"}
        if self._is_foreign() or self.path not in types:
            return self._answer(403 if self._is_foreign() else 404, "text/plain")
        self._answer(200, types[self.path], self.live.html if self.path == "/" else b"")
        if self.path == "/live":
            self._stream()

    def do_POST(self) -> None:
        code, answer = self._controlled()
        self._answer(code, "application/json", json.dumps(answer).encode())

    def _controlled(self) -> tuple[int, dict[str, Any]]:
        """Return status and answer of a control message; one of another page, or not JSON, is refused."""
        host, kind = self.headers.get("Host", ""), self.headers.get("Content-Type", "")
        if self._is_foreign() or self.headers.get("Origin", f"http://{host}") != f"http://{host}":
            return 403, {"error": "only the page of this server may control it"}
        if self.path != "/control" or self.live.control is None or kind != "application/json":
            return 404, {"error": "give JSON to /control of a page with controls"}
        try:
            size = int(self.headers.get("Content-Length", ""))
            data = json.loads(self.rfile.read(size)) if 0 <= size <= MAX_BODY else None
            if not isinstance(data, dict):
                raise ValueError(f"message: this is not allowed; give a mapping of at most {MAX_BODY} bytes")
            return 200, self.live.control(data)
        except (ValueError, OSError, RecursionError) as error:
            return 400, {"error": str(error)}

    def _is_foreign(self) -> bool:
        """Return True for a request under a host name of another machine, as after DNS rebinding."""
        return self.headers.get("Host", "").rpartition(":")[0] not in HOSTS

    def _answer(self, code: int, kind: str, body: bytes = b"") -> None:
        self.send_response(code)
        for name, value in {**HEADERS, "Content-Type": kind}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        before, client = self.live.listen()
        try:
            self.wfile.write(before)
            while message := client.get():
                self.wfile.write(message)
        except OSError:  # the browser closed the connection
            self.live.leave(client)
