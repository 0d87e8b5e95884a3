"""What the documents point at is there: files, requirements, modules."""

import fnmatch
import re
from pathlib import Path

import architecture
import documented
import pytest

from msg_schemas.access import ACCESS, ALL
from msg_schemas.table import TOPICS, Intent
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


# ------------------------------------------------------------- the diagrams of the architecture

Said = tuple[str, str, str]
"""Who says something, what, and to whom."""


def drawn(number: int) -> str:
    """A diagram's text."""
    found = [
        block.text
        for block in documented.blocks(ROOT / "docs" / "architecture.md")
        if block.language == "mermaid"
    ]
    return found[number]


def said() -> set[Said]:
    """What the first diagram has nodes say."""
    arrows = re.findall(r'(\w+) -- "([^"]+)" --> (\w+)', drawn(0))
    return {(one, name, other) for one, names, other in arrows for name in names.split(", ")}


def test_what_nodes_are_drawn_to_say_they_may_say_and_hear():
    def may(granted: tuple[str, ...], name: str) -> bool:
        return granted == ALL or name in granted

    for one, name, other in said():
        first, second = ACCESS[one], ACCESS[other]
        told = may(first.publishes, name) and may(second.subscribes, name)
        called = may(first.calls, name) and name in second.serves
        assert told or called, f"{one} cannot tell {other} {name}"


def test_every_command_between_the_nodes_that_are_drawn_is_drawn():
    nodes = {node for one, _, other in said() for node in (one, other)}
    commands = [name for name, row in TOPICS.items() if row.intent is Intent.COMMAND]
    assert {
        (one, name, other)
        for one in nodes
        for other in nodes - {one}
        for name in commands
        if name in ACCESS[one].publishes and name in ACCESS[other].subscribes
    } <= said()


def behind(arrows: dict[str, set[str]], one: str) -> set[str]:
    """All that one knows, and what stands behind it."""
    return {other for each in arrows[one] for other in {each} | behind(arrows, each)}


def test_the_packages_are_drawn_as_they_know_one_another():
    text = re.sub(r'\["[^"]*"\]', "", drawn(1))
    arrows: dict[str, set[str]] = {name: set() for name in architecture.ARROWS}
    for one, other in re.findall(r"(\w+) --> (\w+)", text):
        arrows[one].add(other)
    for name in architecture.ARROWS:
        assert behind(arrows, name) == behind(architecture.ARROWS, name), name
    exceptional = {
        (name.partition(".")[0], other)
        for found in (architecture.EXCEPTIONS, architecture.EXCEPTIONAL_FOLDERS)
        for name, others in found.items()
        for other in others
    }
    assert set(re.findall(r"(\w+) -\.->\|[^|]*\| (\w+)", text)) == exceptional
