"""Property tests as targets of a fuzzer: each takes bytes, from which hypothesis draws."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

TESTS = Path(__file__).parents[1]
CORPUS = TESTS / "corpus"
"""Inputs that reached new code or broke something, in a folder for each target."""

Target = Callable[[bytes], object]


def folder_of(node: str) -> Path:
    """The folder with the kept inputs of a test, named as pytest does: `file.py::function`."""
    path, _, function = node.partition("::")
    return CORPUS / f"{Path(path).stem}.{function}"


def load_target(folder: Path) -> Target:
    """The target of a folder with kept inputs.

    Raises:
        LookupError: there is no such test.
    """
    stem, _, function = folder.name.partition(".")
    paths = list(TESTS.rglob(f"{stem}.py"))
    if len(paths) != 1:
        raise LookupError(f"{stem}.py is {len(paths)} files: should be one")
    if str(TESTS / "support") not in sys.path:
        sys.path.append(str(TESTS / "support"))
    spec = importlib.util.spec_from_file_location(f"fuzzed_{stem}", paths[0])
    if spec is None or spec.loader is None:
        raise LookupError(f"{paths[0]} cannot be imported")
    module = sys.modules.setdefault(spec.name, importlib.util.module_from_spec(spec))
    if not hasattr(module, function):
        spec.loader.exec_module(module)
    if not hasattr(module, function):
        raise LookupError(f"{paths[0]} has no {function}")
    target: Target = getattr(module, function).hypothesis.fuzz_one_input
    return target
