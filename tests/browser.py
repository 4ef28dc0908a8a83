"""A headless Chromium with a software renderer, and a folder that it is served."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from tools import need, need_module

# SwiftShader needs no GPU; a container has no sandbox, and little shared memory.
_FLAGS = (
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--no-sandbox", "--disable-dev-shm-usage"),
)


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing."""


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a folder, on this machine alone."""
    handler = functools.partial(_Quiet, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def page(folder: Path) -> Iterator[Any]:
    """An empty page of a folder, where scripts can run."""
    playwright = need_module("playwright.sync_api")
    chromium = need("chromium", "chromium-browser", "google-chrome")
    (folder / "index.html").write_text("<!doctype html><title>test</title>", encoding="ascii")
    with served(folder) as address, playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=list(_FLAGS))
        try:
            found = browser.new_page()
            found.goto(f"{address}/index.html")
            yield found
        finally:
            browser.close()
