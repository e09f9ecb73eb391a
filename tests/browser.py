"""A headless Chromium and a JupyterLab of their own for the tests that look at pages."""

from __future__ import annotations

import contextlib
import os
import pathlib
import secrets
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tutorial_lib.errors import TutorialError
from tutorial_lib.view.benchmark import PLAYER, open_chromium

__all__ = ["PLAYER", "chromium", "jupyterlab", "new_page", "picture", "running_cell", "wait_until_ready"]
ROOT = pathlib.Path(__file__).parents[1]


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser, or a skipped test where there is none."""
    with contextlib.ExitStack() as stack:
        try:
            browser = stack.enter_context(open_chromium())
        except TutorialError as error:
            pytest.skip(str(error))
        yield browser


def new_page(browser: Any, **choices: Any) -> Any:
    """A page that keeps its errors in ``page.errors`` and every address it asked for in ``page.asked``."""
    choices.setdefault("viewport", {"width": 1000, "height": 800})
    page = browser.new_context(**choices).new_page()
    page.errors, page.asked = [], []
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.on("console", lambda message: page.errors.append(message.text) if message.type == "error" else None)
    page.on("request", lambda request: page.asked.append(request.url))
    return page


def wait_until_ready(page: Any, count: int = 1, timeout: float = 30) -> None:
    """Until ``count`` players on the page have drawn their first picture."""
    page.wait_for_function(
        "n => [...document.querySelectorAll('[data-motion-player]')].filter(e => e.player?.drawn).length >= n",
        arg=count,
        timeout=1000 * timeout,
    )


def picture(page: Any, index: int = 0) -> bytes:
    """The pixels of a player's canvas, as a PNG file's bytes."""
    return page.locator("[data-motion-player] canvas").nth(index).screenshot()


@contextmanager
def jupyterlab(folder: pathlib.Path) -> Iterator[str]:
    """A JupyterLab on the loopback address, with settings of its own, that serves ``folder``; its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    token, home = secrets.token_hex(16), folder / ".jupyter-home"
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])),
        "IPYTHONDIR": str(home / "ipython"),
        **{f"JUPYTER_{kind}_DIR": str(home / kind.lower()) for kind in ("CONFIG", "DATA", "RUNTIME")},
        "JUPYTERLAB_SETTINGS_DIR": str(home / "settings"),
        "JUPYTERLAB_WORKSPACES_DIR": str(home / "workspaces"),
    }
    command = [
        sys.executable, "-m", "jupyterlab", "--no-browser", "--ip=127.0.0.1", f"--port={port}",
        "--ServerApp.port_retries=0",
        f"--IdentityProvider.token={token}", f"--ServerApp.root_dir={folder}", "--LabApp.expose_app_in_browser=True",
        "--LabApp.news_url=", "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate", "--allow-root",
        "--LabApp.extension_manager=readonly",
    ]  # fmt: skip
    home.mkdir()
    with open(home / "log", "w") as log:
        server = subprocess.Popen(command, env=environment, stdout=log, stderr=log, cwd=folder)
        try:
            address = f"http://127.0.0.1:{port}"
            for _ in range(240):
                try:
                    urllib.request.urlopen(f"{address}/api?token={token}", timeout=2).close()
                    break
                except OSError:
                    if server.poll() is not None:
                        break
                    time.sleep(0.25)
            else:
                server.kill()
            if server.poll() is not None:
                raise RuntimeError("JupyterLab did not start:\n" + (home / "log").read_text()[-2000:])
            yield f"{address}/lab/tree/{{}}?token={token}&reset"
        finally:
            server.terminate()  # it ends its kernels, too
            try:
                server.wait(15)
            except subprocess.TimeoutExpired:
                server.kill()
                server.wait()


@contextmanager
def running_cell(browser: Any, folder: pathlib.Path, cell: str) -> Iterator[Any]:
    """A page of JupyterLab in which a notebook with one cell is being run."""
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("jupyterlab")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell)])
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(notebook, folder / "live.ipynb")
    with jupyterlab(folder) as address:
        page = new_page(browser, viewport={"width": 1100, "height": 1000})
        page.goto(address.format("live.ipynb"))
        page.locator(".jp-Notebook").wait_for(timeout=60_000)
        page.wait_for_function(
            "window.jupyterapp?.shell?.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'",
            timeout=60_000,
        )
        page.errors.clear()  # JupyterLab's own, of its start
        page.evaluate("void jupyterapp.commands.execute('notebook:run-all-cells')")
        yield page
