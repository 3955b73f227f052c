"""Take the pictures of TensorBoard and of the report page: ``python -m docs.tools.screenshots`` needs Chromium."""

import base64
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from quadpend_train.cli.main import main
from tests.helpers.browser import Browser

DOCS = Path(__file__).parents[1]
TAGS = "ep_rew_mean|reward/(tracking|upright)|penalised_rmse|survival"
CLOSE = "[...document.querySelectorAll('button')].find((x) => x.textContent.includes('Settings')).click()"
TRAIN = ["train", "--settings", "ppo", "--total-timesteps", "1500000", "--eval-freq", "150000"]
EVALUATE = ["evaluate", "adrc-paper", "flatness", "apg-0", "--scenarios", "calm", "windy", "gusts"]


def take(browser: Browser, url: str, path: Path, size: tuple[int, int], ready: str, then: str = "0") -> None:
    """Write a picture of a page.

    Args:
        browser: Browser that opens the page.
        url: Address of the page.
        path: PNG file.
        size: Width and height, px.
        ready: JavaScript expression that is true as soon as the page is complete, within a minute.
        then: JavaScript expression to evaluate before the picture is taken.
    """
    browser.call("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False)
    browser.call("Page.navigate", url=url)
    end = time.monotonic() + 60.0
    while not browser.run(ready) and time.monotonic() < end:
        time.sleep(0.5)
    browser.run(then)
    time.sleep(3.0)  # for the transitions of the page
    path.write_bytes(base64.b64decode(browser.call("Page.captureScreenshot")["data"]))


def tensorboard(browser: Browser, runs: Path) -> None:
    """Write `docs/tensorboard.png`."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    address = f"http://127.0.0.1:{port}/"
    command = [
        sys.executable,
        "-m",
        "tensorboard.main",
        "--logdir",
        str(runs),
        "--port",
        str(port),
        "--load_fast=false",
    ]
    server = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        while not _answers(f"{address}data/runs") and server.poll() is None:
            time.sleep(0.5)
        ready = "document.querySelectorAll('scalar-card').length > 2 && !document.querySelector('mat-spinner')"
        take(browser, f"{address}?tagFilter={TAGS}#timeseries", DOCS / "tensorboard.png", (1280, 1000), ready, CLOSE)
    finally:
        server.terminate()
        server.wait()


def _answers(address: str) -> bool:
    """Return whether a server has data at an address."""
    try:
        with urllib.request.urlopen(address) as answer:
            return len(answer.read()) > len("[]")
    except OSError:
        return False


if __name__ == "__main__":
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        sys.exit("pictures of pages need Chromium")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        main([*TRAIN, "--out", str(folder / "runs/demo")])
        main([*EVALUATE, "--episodes", "50", "--out", str(folder / "results"), "--cache", str(folder / "cache")])
        shown = Browser(program, folder / "browser")
        try:
            report = (folder / "results/report.html").as_uri()
            take(shown, report, DOCS / "report.png", (1280, 1400), "document.readyState === 'complete'")
            tensorboard(shown, folder / "runs")
        finally:
            shown.close()
