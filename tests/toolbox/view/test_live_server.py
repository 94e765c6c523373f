"""Web server of a live page: nobody acts without the token of its address, and no connection holds it up."""

import http.client
import json
import re
import socket
import threading
import urllib.parse
import urllib.request

import pytest

from flexman_gym.toolbox.view import live_server
from flexman_gym.toolbox.view.live_server import HOSTS, MAX_CONNECTIONS, LiveServer

from oracles.waiting import wait_until


class Source:
    """A page with controls, that records its messages, and a stream of one event."""

    html = b"page"

    def __init__(self):
        self.messages, self.error, self.streams = [], None, 0
        self.opened = threading.Event()

    def control(self, message):
        self.messages.append(message)
        if self.error is not None:
            raise self.error
        return {"done": len(self.messages)}

    def stream(self, write):
        self.streams += 1
        write(b"data: 1\n\n")
        self.opened.set()
        while True:
            write(b":\n\n" * 1000)


@pytest.fixture
def server():
    made = LiveServer(Source())
    yield made
    made.close()


def ask(server, path, body=None, **headers):
    """Return status and body of a request to a path below the root."""
    place = urllib.parse.urlsplit(server.url).netloc
    connection = http.client.HTTPConnection(place, timeout=60)
    given = {"Host": place, "Content-Type": "application/json"} | headers
    connection.request("GET" if body is None else "POST", path, body, given)
    answer = connection.getresponse()
    return answer.status, answer.read()


def connect(server):
    """Return a connection on which nothing has been sent."""
    return socket.create_connection(server.server_address, timeout=60)


def closed(connection):
    """Return True once the server closes a connection."""
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


def test_without_the_token_nothing_is_read_or_done(server):
    """Neither with none, nor with a wrong one, nor with a part of it; with the token the same requests are answered."""
    token = server.token
    wrong = ["", "x", token[:-1], f"{token}x", token[::-1], "é" * len(token), f"?token={token}", f"x/{token}"]
    for name in wrong:
        for path in ("", "live", "control"):
            whole = urllib.parse.quote(f"/{name}/{path}" if name else f"/{path}", safe="/?=")
            status, text = ask(server, whole)
            assert status == 403 and token.encode() not in text, whole
            assert ask(server, whole, '{"pause": true}')[0] == 403
    assert server.source.messages == [] and server.source.streams == 0
    assert ask(server, f"/{token}/") == (200, b"page") and ask(server, f"/{token}/else")[0] == 404
    assert ask(server, f"/{token}/control", '{"pause": true}') == (200, b'{"done": 1}')
    assert server.url == f"http://127.0.0.1:{server.server_address[1]}/{token}/"
    assert server.server_address[0] == "127.0.0.1"


def test_tokens_are_long_and_differ(server):
    other = LiveServer(Source())
    other.close()
    assert other.token != server.token and len(server.token) >= 22 and re.fullmatch(r"[\w-]+", server.token)


def test_the_token_is_compared_in_constant_time(server, monkeypatch):
    compared, compare = [], live_server.hmac.compare_digest
    monkeypatch.setattr(live_server.hmac, "compare_digest", lambda *both: compared.append(both) or compare(*both))
    ask(server, "/abc/")
    assert compared == [(b"abc", server.token.encode())]


def test_foreign_hosts_and_pages_are_refused_with_the_token_too(server):
    path, order = f"/{server.token}/control", '{"pause": true}'
    port = server.server_address[1]
    for headers in ({"Host": "evil.example:80"}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
        assert ask(server, path, order, **headers)[0] == 403
    for host in HOSTS:
        place = f"{host}:{port}"
        assert ask(server, path, order, Host=place, Origin=f"http://{place}")[0] == 200
    with connect(server) as connection:
        connection.sendall(f"GET /{server.token}/ HTTP/1.0\r\nHost: 127.0.0.1\r\nHost: 127.0.0.1:1\r\n\r\n".encode())
        assert connection.recv(100).startswith(b"HTTP/1.0 403")


def test_only_pages_of_this_computer_may_show_the_page_in_a_frame(server):
    with urllib.request.urlopen(server.url) as answer:
        policy = answer.headers["Content-Security-Policy"]
    ancestors = next(each for each in policy.split("; ") if each.startswith("frame-ancestors ")).split()[1:]
    assert {"http://127.0.0.1:*", "http://localhost:*", "vscode-webview:"} <= {*ancestors} and "*" not in ancestors
    assert all(urllib.parse.urlsplit(each).hostname in (*HOSTS, None) for each in ancestors)


@pytest.mark.parametrize(("error", "status", "text"), [
    (ValueError("push: 1 is not allowed"), 400, "push: 1 is not allowed"),
    (OSError(28, "no space"), 400, "[Errno 28] no space"),
    (RuntimeError("two\nlines"), 500, "RuntimeError: two lines"), (KeyError("x"), 500, "KeyError: 'x'"),
    (MemoryError(), 500, "MemoryError"), (ZeroDivisionError("by zero"), 500, "ZeroDivisionError: by zero"),
], ids=lambda each: type(each).__name__)  # fmt: skip
def test_an_error_of_a_command_is_the_answer(error, status, text, server, capfd):
    server.source.error = error
    found, body = ask(server, f"/{server.token}/control", '{"a": 1}')
    assert (found, json.loads(body)) == (status, {"error": text}) and capfd.readouterr().err == ""


def test_dropped_connections_print_nothing(server, capfd):
    """A stream that is closed while it is written, and requests that end in the middle."""
    with connect(server) as connection:
        connection.sendall(f"GET /{server.token}/live HTTP/1.0\r\nHost: 127.0.0.1:1\r\n\r\n".encode())
        assert server.source.opened.wait(60)
    order = f"POST /{server.token}/control HTTP/1.0\r\nContent-Length: 9\r\n\r\n"
    for part in ("GET", "GET / HTTP/1.0\r\nHost: x\r\n", order):
        with connect(server) as connection:
            connection.sendall(part.encode())
    assert ask(server, f"/{server.token}/")[0] == 200
    wait_until(lambda: not any("process_request" in thread.name for thread in threading.enumerate()))
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_a_connection_that_sends_no_whole_request_is_closed(server, monkeypatch):
    """Neither silence, nor a header that grows byte by byte, nor a body that does not come, holds a thread for long."""
    monkeypatch.setattr(live_server, "REQUEST_TIME", 0.2)
    host = b"Host: 127.0.0.1:1\r\n"
    for start in (b"", b"GET / HTTP/1.0\r\n", f"POST /{server.token}/control HTTP/1.0\r\n".encode() + host
                  + b"Content-Type: application/json\r\nContent-Length: 99\r\n\r\n{"):  # fmt: skip
        with connect(server) as connection:
            connection.sendall(start)
            wait_until(lambda connection=connection: closed(connection))
    with connect(server) as connection:
        connection.sendall(b"GET / HTTP/1.0\r\nX: ")
        with pytest.raises(ConnectionError):
            wait_until(lambda: connection.sendall(b"x"))  # each byte is in time
    assert server.source.messages == []


def test_the_number_of_connections_is_bounded(server):
    """One more is closed at once, and is answered as soon as another one has ended."""
    held = [connect(server) for _ in range(MAX_CONNECTIONS)]
    wait_until(lambda: not server._free._value)
    with connect(server) as more:
        assert closed(more)
    held.pop().close()
    wait_until(lambda: server._free._value)
    assert ask(server, f"/{server.token}/") == (200, b"page")
    for each in held:
        each.close()


def test_a_port_in_use_is_refused(server):
    port = server.server_address[1]
    with pytest.raises(ValueError, match=f"port: {port} is not allowed; give a free port, or 0"):
        LiveServer(Source(), port)
