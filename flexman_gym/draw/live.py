"""Live: the replay page of an arm that moves now, on an address of this machine alone, by server-sent events."""

import http.server
import queue
import sys
import threading
import time
from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.draw.replay import packed, page, page_arm, stage
from flexman_gym.draw.style import BLUE
from flexman_gym.model.model import Model

WAITING = 200  # rows that a slow browser may be behind before it misses some


class Live:
    """A page that follows an arm; a line on stderr says its address, once.

    Attributes:
        address: of the page.
        shown, late: rows that were shown, and those of them that came later than the clock wanted.
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
        print(f"the arm can be seen at {self.address}", file=sys.stderr, flush=True)

    def begin(self, points: Array) -> None:
        """Starts an episode.

        Args:
            points: (p, 3) m, all that should be seen.
        """
        run = {"name": self._title, "colour": BLUE, "note": "", "dt": self._period, "rows": 0, "arm": 0}
        data = {"live": True, "arms": [page_arm(self._model)], "runs": [run],
                "stage": stage([self._model], points, self._strain)}  # fmt: skip
        with self._lock:
            self._page, self._rows = page(data, self._title, "live").encode(), []
            self._tell(b"event: begin\ndata: \n\n")
        self._next = time.perf_counter()

    def show(self, row: Array) -> None:
        """Sends a row, and waits until it is its time.

        Args:
            row: coordinates (d,), target (3,), error and torques (n,) as parts of their limits, side by side.
        """
        message = b"data: " + packed(row).encode() + b"\n\n"
        with self._lock:
            self._rows.append(message)
            self._tell(message)
        self.shown += 1
        now, self._next = time.perf_counter(), self._next + self._period
        if now > self._next:
            self.late, self._next = self.late + 1, now
        else:
            time.sleep(self._next - now)

    def _tell(self, message: bytes) -> None:
        for client in self._clients:
            if not client.full():
                client.put_nowait(message)

    def listen(self) -> "tuple[bytes, queue.Queue[bytes]]":
        """Gives what the episode has had so far, and a queue of what follows."""
        with self._lock:
            client: queue.Queue[bytes] = queue.Queue(WAITING)
            self._clients.append(client)
            return b"".join(self._rows), client

    def leave(self, client: "queue.Queue[bytes]") -> None:
        """Ends what `listen` began."""
        with self._lock:
            self._clients.remove(client)

    def html(self) -> bytes:
        """The page of the present episode."""
        return self._page

    def close(self) -> None:
        """Ends the server; a line on stderr says how many rows were late, if any."""
        self._server.shutdown()
        self._server.server_close()
        if self.late:
            print(f"{self.late} of {self.shown} steps came late", file=sys.stderr)


def _handler(live: Live) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        """Gives the page at / and the events at /live."""

        def log_message(self, *_: Any) -> None:
            pass

        def do_GET(self) -> None:
            known = {"/": "text/html; charset=utf-8", "/live": "text/event-stream"}
            self.send_response(200 if self.path in known else 404)
            self.send_header("Content-Type", known.get(self.path, "text/plain"))
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
            except OSError:  # the browser has gone
                live.leave(client)

    return Handler


def row_of(coordinates: Array, target: Array, error: float, torques: Array) -> Array:
    """Gives the row of `Live.show`."""
    result: Array = np.concatenate([coordinates, target, [error], torques])
    return result
