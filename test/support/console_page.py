"""A page of the console in a real browser without a window; skips where there is none."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page

PATIENCE = 60_000  # [ms]
_NAMES = ("chromium", "chromium-browser", "google-chrome")


def sync_api() -> Any:
    """The library that drives the browser; skips where it is not installed."""
    return pytest.importorskip("playwright.sync_api")


@contextmanager
def browser_page(width: int = 1440, height: int = 900) -> Iterator[Page]:
    """A fresh page; what it asks of other machines fails the test, and so do its own errors."""
    path = next(filter(None, map(shutil.which, _NAMES)), None)
    if path is None:
        pytest.skip("no Chromium on this machine (Debian's package chromium)")
    troubles: list[str] = []
    # The libraries of the ROS wheels are not the browser's.
    own = {name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"}
    with sync_api().sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, env=own)
        try:
            page = browser.new_page(viewport={"width": width, "height": height})
            page.set_default_timeout(PATIENCE)
            page.on("pageerror", lambda error: troubles.append(f"error: {error}"))
            page.on("request", lambda request: _look_at(request.url, troubles))
            yield page
        finally:
            browser.close()
    assert not troubles


def _look_at(url: str, troubles: list[str]) -> None:
    if not url.startswith(("http://127.0.0.1:", "ws://127.0.0.1:", "data:")):
        troubles.append(f"asked elsewhere: {url}")
