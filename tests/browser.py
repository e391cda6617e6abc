"""A real browser without a window, driven through its own debugging pipe: pages opened, asked, pointed at, printed."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")

_PATIENCE = 60.0
"""Longest wait for an answer [s]."""


def browser_path() -> str | None:
    """The browser that is installed, None where there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page of a browser. ``console`` collects errors and warnings, ``requests`` every address asked for."""

    def __init__(self, profile: Path, width: int = 1200, height: int = 900) -> None:
        ours, theirs = os.pipe(), os.pipe()  # their commands come on 3, their answers go to 4
        self._out, self._in = ours[1], theirs[0]
        flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--remote-debugging-pipe",
                 "--disable-background-networking", "--no-first-run", f"--user-data-dir={profile}",
                 "--hide-scrollbars", f"--window-size={width},{height}", "about:blank"]  # fmt: skip
        path = browser_path()
        # A shell puts the pipes where the browser looks for them.
        start = f'exec "$0" "$@" 3<&{ours[0]} 4>&{theirs[1]}'
        self._process = subprocess.Popen(
            ["bash", "-c", start, path, *flags], pass_fds=(ours[0], theirs[1]), stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(ours[0])
        os.close(theirs[1])
        self._number, self._buffer, self._session = 0, b"", None
        self.console: list[str] = []
        self.requests: list[str] = []
        target = self._send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._send(f"{domain}.enable")
        self.resize(width, height)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._out)
        os.close(self._in)

    def open(self, path: Path) -> None:
        """Opens a file and waits until it has been loaded and drawn."""
        self.console.clear()
        self.requests.clear()
        self._send("Page.navigate", url=path.resolve().as_uri())
        deadline = time.monotonic() + _PATIENCE
        while self.value("document.readyState") != "complete" or not self.value("location.href").endswith(path.name):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{path}: was not loaded")
            time.sleep(0.02)
        self.settle()

    def settle(self) -> None:
        """Waits until what was asked of the page has been drawn."""
        self.value("new Promise(done => requestAnimationFrame(() => setTimeout(() => done(0), 30)))")

    def value(self, expression: str) -> object:
        """The value of a JavaScript expression in the page; RuntimeError where it throws."""
        answer = self._send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def pointer(self, kind: str, x: float, y: float, buttons: int = 0) -> None:
        """A movement or press of the pointer: ``mouseMoved``, ``mousePressed``, ``mouseReleased``."""
        button = "left" if kind != "mouseMoved" or buttons else "none"
        self._send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons, clickCount=1)

    def drag(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        self.pointer("mousePressed", *begin, buttons=1)
        for part in (0.25, 0.5, 0.75, 1.0):
            self.pointer("mouseMoved", *(a + part * (b - a) for a, b in zip(begin, end, strict=True)), buttons=1)
        self.pointer("mouseReleased", *end)
        self.settle()

    def resize(self, width: int, height: int, is_phone: bool = False) -> None:
        self._send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
                   mobile=is_phone)  # fmt: skip

    def prefer(self, scheme: str = "light", media: str = "") -> None:
        """Which colours the user likes, ``light`` or ``dark``; media: ``print`` as paper is drawn."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self._send("Emulation.setEmulatedMedia", media=media, features=features)
        self.settle()

    def picture(self, whole: bool = False) -> bytes:
        """PNG of what is seen, or of the whole page."""
        return base64.b64decode(self._send("Page.captureScreenshot", captureBeyondViewport=whole)["data"])

    def paper(self) -> bytes:
        """The page as PDF."""
        return base64.b64decode(self._send("Page.printToPDF", printBackground=True)["data"])

    def _send(self, method: str, **parameters: object) -> dict:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive(method)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._note(answer)

    def _receive(self, method: str) -> dict:
        deadline = time.monotonic() + _PATIENCE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], max(deadline - time.monotonic(), 0))
            part = os.read(self._in, 1 << 16) if ready else b""
            if not part:
                raise TimeoutError(f"{method}: the browser does not answer")
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, event: dict) -> None:
        what, said = event.get("method", ""), event.get("params", {})
        if what == "Runtime.exceptionThrown":
            self.console.append(json.dumps(said["exceptionDetails"]))
        elif what == "Runtime.consoleAPICalled" and said["type"] in ("error", "warning", "assert"):
            self.console.append(json.dumps(said["args"]))
        elif what == "Log.entryAdded" and said["entry"]["level"] in ("error", "warning"):
            self.console.append(said["entry"]["text"])
        elif what == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])
