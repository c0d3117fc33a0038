"""Headless Chromium, controlled over the DevTools protocol."""

import base64
import contextlib
import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Self

import pytest
from websockets.sync.client import ClientConnection, connect

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")


def chromium_or_skip() -> str:
    """Path of the browser; skips the test if none is installed."""
    found = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if found is None:
        pytest.skip("needs Chromium")
    return found


class Browser:
    """One page in a separate browser process."""

    def __init__(self, url: str, *, width_px: int = 800, height_px: int = 600) -> None:
        self._folder = tempfile.mkdtemp(prefix="caris-chromium-")
        self._process = subprocess.Popen(
            [
                chromium_or_skip(), "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run",
                "--remote-debugging-port=0", f"--user-data-dir={self._folder}",
                f"--window-size={width_px},{height_px}", "--disable-background-networking", "about:blank",
            ],
            stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
            env={**os.environ, "TMPDIR": self._folder, "HOME": self._folder},
        )  # fmt: skip
        self._last_id = 0
        self._open = contextlib.ExitStack()
        self._socket: ClientConnection = self._open.enter_context(connect(self._address(), max_size=None))
        target = self._command("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._command("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        size = {"width": width_px, "height": height_px}
        self.command("Emulation.setDeviceMetricsOverride", deviceScaleFactor=1, mobile=False, **size)
        self.command("Page.navigate", url=url)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: object) -> None:
        self._command("Browser.close")
        self._open.close()
        self._process.wait(10)
        assert self._process.stderr is not None
        self._process.stderr.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def value(self, expression: str) -> Any:
        """Result of a JavaScript expression in the page."""
        return self.command("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def picture(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.command("Page.captureScreenshot")["data"]))

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a DevTools command to the page."""
        return self._command(method, session=self._session, **parameters)

    def _command(self, method: str, *, session: str = "", **parameters: Any) -> dict[str, Any]:
        self._last_id += 1
        request = {"id": self._last_id, "method": method, "params": parameters} | (
            {"sessionId": session} if session else {}
        )
        self._socket.send(json.dumps(request))
        while True:
            answer = json.loads(self._socket.recv(30))
            if answer.get("id") == self._last_id:
                assert "error" not in answer, answer["error"]
                result: dict[str, Any] = answer["result"]
                return result

    def _address(self) -> str:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if "DevTools listening on " in line:
                return line.split("DevTools listening on ")[1].strip()
        raise RuntimeError("the browser did not start")
