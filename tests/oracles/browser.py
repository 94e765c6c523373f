"""Browser: Chromium without a window, by the WebDriver protocol that chromedriver speaks (w3.org/TR/webdriver2)."""

import json
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request

import pytest

ARGUMENTS = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
             "--disable-dev-shm-usage", "--hide-scrollbars", "--no-first-run", "--disable-background-networking",
             "--window-size=1280,720"]  # fmt: skip
OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1"
MISSING = next((f"{name} is not installed (apt: chromium chromium-driver)" for name in ("chromium", "chromedriver")
                if shutil.which(name) is None), "")  # fmt: skip


def one_browser():
    """Yield a browser for the tests of a file, or skip them without Chromium; to be used as a fixture of file scope."""
    if MISSING:
        pytest.skip(MISSING)
    made = Browser()
    yield made
    made.close()


class Browser:
    """Headless browser window that can reach only the local host."""

    def __init__(self, *more):
        with socket.socket() as place:
            place.bind(("127.0.0.1", 0))
            port = place.getsockname()[1]
        self._origin, self._left = "", set()  # of the page, and of pages that were left
        self._process = subprocess.Popen(["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL)
        self._root = f"http://127.0.0.1:{port}"
        options = {"binary": shutil.which("chromium"), "args": [*ARGUMENTS, OFFLINE, *more]}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        for _ in range(600):
            try:
                session = self._ask("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
                break
            except (ConnectionError, urllib.error.URLError):
                time.sleep(0.1)
        self._root += f"/session/{session['sessionId']}"

    def _ask(self, method, path, data=None):
        body = None if data is None else json.dumps(data).encode()
        request = urllib.request.Request(self._root + path, body, {"Content-Type": "application/json"}, method=method)
        with urllib.request.urlopen(request, timeout=120) as answer:
            return json.load(answer)["value"]

    def open(self, address, ready="window.replay !== undefined"):
        """Open a page and wait until it is ready."""
        origin = "/".join(address.split("/")[:3])
        self._left = (self._left | {self._origin}) - {origin, ""}
        self._origin = origin
        self._ask("POST", "/url", {"url": address})
        self.wait(ready)

    def run(self, script, *arguments):
        """Return the result of a script."""
        return self._ask("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, condition, seconds=60):
        """Wait until an expression is true."""
        for _ in range(10 * seconds):
            if self.run(f"return Boolean({condition})"):
                return
            time.sleep(0.1)
        raise TimeoutError(condition)

    def press(self, identity, part):
        """Press the mouse on an element at a share of its width."""
        box = self.run("const b = document.getElementById(arguments[0]).getBoundingClientRect();"
                       "return [b.left, b.top, b.width, b.height]", identity)  # fmt: skip
        x, y = round(box[0] + part * box[2]), round(box[1] + box[3] / 2)
        steps = [{"type": "pointerMove", "duration": 0, "x": x, "y": y}, {"type": "pointerDown", "button": 0},
                 {"type": "pointerUp", "button": 0}]  # fmt: skip
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": steps}
        self._ask("POST", "/actions", {"actions": [mouse]})

    def drag(self, start, way, before_the_end=lambda: None):
        """Press the mouse at a point (x, y) in pixels, move it along a way, and let go after a function was called."""
        ends = [start, [a + b for a, b in zip(start, way, strict=True)]]
        moves = [{"type": "pointerMove", "duration": 50, "x": round(x), "y": round(y)} for x, y in ends]
        for steps in ([moves[0], {"type": "pointerDown", "button": 0}, moves[1]], [{"type": "pointerUp", "button": 0}]):
            mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": steps}
            self._ask("POST", "/actions", {"actions": [mouse]})
            before_the_end()
            before_the_end = lambda: None  # noqa: E731

    def size(self, width, height):
        """Set the size of the viewport, pixels, as on a phone below 500 pixels."""
        sizes = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self.devtools("Emulation.setDeviceMetricsOverride", **sizes)

    def scheme(self, name):
        """Set the colour scheme, light or dark."""
        self.devtools("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    def devtools(self, command, **parameters):
        """Return the result of a command of the DevTools protocol of Chromium."""
        return self._ask("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def write(self, text):
        """Type a text."""
        keys = [{"type": kind, "value": letter} for letter in text for kind in ("keyDown", "keyUp")]
        self._ask("POST", "/actions", {"actions": [{"type": "key", "id": "keys", "actions": keys}]})

    def said(self):
        """Return new messages of the console, without refused connections of pages that were left.

        Until such a page is left, it asks a server that a test has closed.
        """
        messages = [each["message"] for each in self._ask("POST", "/se/log", {"type": "browser"})]
        left = tuple(f"{origin}/" for origin in self._left)
        return [each for each in messages if not ("ERR_CONNECTION_REFUSED" in each and each.startswith(left))]

    def picture(self):
        """Return a screenshot, base64 of a PNG."""
        return self._ask("GET", "/screenshot")

    def close(self):
        """Close browser and driver."""
        try:
            self._ask("DELETE", "")
        finally:
            self._process.terminate()
            self._process.wait()
