"""Name and version of the package, as configurations, bags and records state them."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

PACKAGE = "mother_rover"


def package_version() -> str:
    """Return the installed version of the package, or ``unknown`` when run from a bare tree."""
    try:
        return version(PACKAGE)
    except PackageNotFoundError:
        return "unknown"
