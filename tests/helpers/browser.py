"""Headless Chromium under the control of a test, through the DevTools protocol, without further libraries."""

import fcntl
import json
import os
import select
import shutil
import signal
import time
from pathlib import Path
from typing import Any

import pytest


class Browser:
    """A headless Chromium process that is controlled through pipes with the DevTools protocol."""

    def __init__(self, program: str, folder: Path) -> None:
        command, self._commands = os.pipe()
        self._answers, answer = os.pipe()
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (command, answer)]
        arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"]
        arguments += ["--remote-debugging-pipe", f"--user-data-dir={folder}", "about:blank"]
        actions: list[Any] = [(os.POSIX_SPAWN_DUP2, end, number) for end, number in zip(ends, (3, 4), strict=True)]
        actions += [(os.POSIX_SPAWN_OPEN, 1, str(folder / "log"), os.O_WRONLY | os.O_CREAT, 0o600)]
        actions += [(os.POSIX_SPAWN_DUP2, 1, 2)]
        folder.mkdir()
        self.process = os.posix_spawn(program, [program, *arguments], os.environ, file_actions=actions, setpgroup=0)
        for end in (command, answer, *ends):
            os.close(end)
        self._count, self._received, self._session = 0, b"", {}
        self.events: list[dict[str, Any]] = []
        (page,) = [one for one in self.call("Target.getTargets")["targetInfos"] if one["type"] == "page"]
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = {"sessionId": attached["sessionId"]}
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters, **self._session}
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while (received := self._receive()).get("id") != self._count:
            self.events.append(received)
        assert "error" not in received, received
        return dict(received["result"])

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._received:
            assert select.select([self._answers], [], [], 20.0)[0], "the browser does not respond"
            got = os.read(self._answers, 1 << 16)
            assert got, "the browser has exited"
            self._received += got
        message, _, self._received = self._received.partition(b"\0")
        return dict(json.loads(message))

    def open(self, path: Path) -> None:
        """Open a file and wait until it is loaded."""
        self.events.clear()
        self.call("Page.navigate", url=path.as_uri())
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self._receive())

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression is true, for at most 10 s."""
        end = time.monotonic() + 10.0
        while not self.run(condition):
            assert time.monotonic() < end, f"the condition never became true: {condition}"
            time.sleep(0.02)

    def messages(self) -> list[Any]:
        """Return exceptions, console messages and log entries of the page."""
        kinds = ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded")
        return [event["params"] for event in self.events if event.get("method") in kinds]

    def close(self) -> None:
        """Kill the browser."""
        os.killpg(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        os.close(self._commands)
        os.close(self._answers)


def start(folder: Path) -> Browser:
    """Start Chromium with its profile in a new folder; skip the test if Chromium is not installed."""
    programs = [shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome")]
    program = next(filter(None, programs), None)
    if program is None:
        pytest.skip("Chromium is not installed, so the page cannot be opened")
    return Browser(program, folder)
