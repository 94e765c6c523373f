"""Web server of a live page, on the local host: a token in the address, limited connections, no foreign page."""

import hmac
import http.server
import json
import secrets
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from flexman_gym.common.errors import error_text, value_error

MAX_BODY = 65536  # bytes; longest control message
MAX_CONNECTIONS = 64  # connections at the same time; further ones are closed at once
REQUEST_TIME = 10.0  # s; longest time of a request, and of a message that a browser does not take
HOSTS = ("127.0.0.1", "localhost")  # host names under which the page answers, against DNS rebinding
# pages that may show the page in a frame: notebooks of Jupyter on this computer, and of VS Code
ANCESTORS = "http://127.0.0.1:* http://localhost:* https://127.0.0.1:* https://localhost:* vscode-webview: vscode-file:"
HEADERS = {  # of every answer: nothing is stored, and the page loads nothing from elsewhere
    "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    f"img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors {ANCESTORS}",
}  # fmt: skip
TEXT, PAGE, JSON, EVENTS = "text/plain", "text/html; charset=utf-8", "application/json", "text/event-stream"
Control = Callable[[dict[str, Any]], dict[str, Any]]


class Source(Protocol):
    """Contents of a server: the page, its stream of events, and the function of control messages.

    Attributes:
        html: the page.
        control: function of a control message, that returns the answer; None for a page without controls.
    """

    html: bytes
    control: Control | None

    def stream(self, write: Callable[[bytes], Any]) -> None:
        """Write events until the server closes; `write` raises OSError if the browser closes the connection."""


class LiveServer(http.server.ThreadingHTTPServer):
    """Server of the page at /TOKEN/, of its events at /TOKEN/live, and of control messages at /TOKEN/control.

    The token is random: other processes and users of this computer do not have it. Every other path, and a request
    under a foreign host name or from a foreign page, is answered with the status 403.

    Args:
        source: the contents.
        port: port of the server; 0 for a free port.

    Attributes:
        token: token in the address.
        url: address of the page.

    Raises:
        ValueError: for a port in use.
    """

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS

    def __init__(self, source: Source, port: int = 0) -> None:
        self.source, self.token = source, secrets.token_urlsafe(16)
        self._free = threading.Semaphore(MAX_CONNECTIONS)
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as error:  # such as a port in use
            raise value_error("port", port, f"a free port, or 0 for any free port ({error.strerror})") from None
        self.url = f"http://127.0.0.1:{self.server_address[1]}/{self.token}/"
        threading.Thread(target=self.serve_forever, args=(0.1,), daemon=True).start()

    def close(self) -> None:
        """Stop the server."""
        self.shutdown()
        self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a thread, or close it if there are too many."""
        if not self._free.acquire(blocking=False):
            return self.shutdown_request(request)
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread can be started
            self._free.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print the traceback of an error; the browser closing a connection is none."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(http.server.BaseHTTPRequestHandler):
    """Handler of one request."""

    server: LiveServer
    timeout = REQUEST_TIME  # of each read and write

    def setup(self) -> None:
        super().setup()
        self._deadline = threading.Timer(REQUEST_TIME, self._drop)
        self._deadline.daemon = True
        self._deadline.start()

    def finish(self) -> None:
        self._deadline.cancel()
        super().finish()

    def _drop(self) -> None:
        """End a request that has not arrived as a whole in time."""
        with suppress(OSError):  # it has just been closed
            self.connection.shutdown(socket.SHUT_RDWR)

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        self._deadline.cancel()
        place, source = self._place(), self.server.source
        if place == "":
            self._answer(200, PAGE, source.html)
        elif place == "live":
            self._answer(200, EVENTS)
            source.stream(self.wfile.write)
        elif place is None:
            self._answer(403, TEXT, b"open the whole address that was printed")
        else:
            self._answer(404, TEXT)

    def do_POST(self) -> None:
        code, answer = self._controlled()
        self._deadline.cancel()
        self._answer(code, JSON, json.dumps(answer).encode())

    def _controlled(self) -> tuple[int, dict[str, Any]]:
        """Return status and answer of a control message; one of another page, or not JSON, is refused."""
        place, control = self._place(), self.server.source.control
        host, kind = self.headers.get("Host", ""), self.headers.get("Content-Type", "")
        if place is None or self.headers.get("Origin", f"http://{host}") != f"http://{host}":
            return 403, {"error": "only the page of this server may control it"}
        if place != "control" or control is None or kind != JSON:
            return 404, {"error": "give JSON to /control of a page with controls"}
        try:
            size = int(self.headers.get("Content-Length", ""))
            data = json.loads(self.rfile.read(size)) if 0 <= size <= MAX_BODY else None
            if not isinstance(data, dict):
                raise ValueError(f"message: this is not allowed; give a mapping of at most {MAX_BODY} bytes")
        except (ValueError, OSError, RecursionError) as error:
            return 400, {"error": str(error)}
        self._deadline.cancel()
        try:
            return 200, control(data)
        except Exception as error:
            return (400 if isinstance(error, ValueError | OSError) else 500), {"error": error_text(error)}

    def _place(self) -> str | None:
        """Return the path below the token; None for a wrong token, or a host name of another computer (rebinding)."""
        token, _, place = self.path.removeprefix("/").partition("/")
        known = hmac.compare_digest(token.encode(), self.server.token.encode())
        hosts = [each.rpartition(":")[0] for each in self.headers.get_all("Host", [])]
        return place if known and len(hosts) == 1 and hosts[0] in HOSTS else None

    def _answer(self, code: int, kind: str, body: bytes = b"") -> None:
        self.send_response(code)
        for name, value in {**HEADERS, "Content-Type": kind}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
