"""What the documents point at is there: files, requirements, modules."""

import fnmatch
import re
from pathlib import Path

import pytest

from rover_verify.requirements import load_requirements

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
REQUIREMENT = re.compile(r"`([A-Z]+(?:-[A-Z]+)*-(?:\d\d|\*))`")
FILE = re.compile(r"`((?:\w+/)+\w+\.(?:py|yaml|md))`")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_and_files_are_there(document: Path):
    text = document.read_text(encoding="utf-8")
    missing = [link for link in LINK.findall(text) if not (document.parent / link).exists()]
    missing += [name for name in FILE.findall(text) if not (ROOT / name).exists()]
    assert not missing


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_requirements_are_listed(document: Path):
    known = [requirement.id for requirement in load_requirements()]
    named = REQUIREMENT.findall(document.read_text(encoding="utf-8"))
    assert not [name for name in named if not fnmatch.filter(known, name)]


def test_modules_of_the_physics_are_there():
    text = (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")
    modules = {path.stem for path in (ROOT / "rover_sim" / "physics").glob("*.py")}
    named = set(re.findall(r"`([a-z][a-z_0-9]+)`", text)) - {"map", "base_link"}
    assert named
    assert named <= modules
