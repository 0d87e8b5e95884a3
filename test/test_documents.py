"""Files, requirements and modules that the documents name exist."""

import fnmatch
import re
import runpy
from pathlib import Path

import architecture
import documented
import pytest

from msg_schemas.access import ACCESS, ALL
from msg_schemas.specifications import Intent
from msg_schemas.table import TOPICS
from rover_verify.requirements.requirements import load_requirements

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
REQUIREMENT = re.compile(r"`([A-Z]+(?:-[A-Z]+)*-(?:\d\d|\*))`")
FILE = re.compile(r"`((?:\w+/)+\w+\.(?:py|yaml|md))`")
MODULE = re.compile(r"`(\w+\.py)`")
MODULES = {
    path.name
    for folder in (*architecture.ARROWS, "docs", "test", "tools")
    for path in (ROOT / folder).rglob("*.py")
}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_and_files_are_there(document: Path):
    text = document.read_text(encoding="utf-8")
    missing = [link for link in LINK.findall(text) if not (document.parent / link).exists()]
    missing += [name for name in FILE.findall(text) if not (ROOT / name).exists()]
    missing += [
        name for name in MODULE.findall(text) if name not in MODULES and not (ROOT / name).exists()
    ]
    assert not missing


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_requirements_are_listed(document: Path):
    known = [requirement.id for requirement in load_requirements()]
    named = REQUIREMENT.findall(document.read_text(encoding="utf-8"))
    assert not [name for name in named if not fnmatch.filter(known, name)]


def test_modules_of_the_physics_are_there():
    text = (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")
    modules = {path.stem for path in (ROOT / "rover_sim" / "physics").rglob("*.py")}
    named = set(re.findall(r"`([a-z][a-z_0-9]+)`", text)) - {"map", "base_link"}
    assert named
    assert named <= modules


def test_the_architecture_lists_each_folder_of_the_tree():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    listed = {name.split("/")[0] for name in re.findall(r"`([\w./]+)/`", text)}
    lines = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    ignored = [".git", *(line.strip("/") for line in lines if line and not line.startswith("#"))]
    folders = {
        path.name
        for path in ROOT.iterdir()
        if path.is_dir() and not any(fnmatch.fnmatch(path.name, pattern) for pattern in ignored)
    }
    assert "rover_sim" in folders
    assert folders <= listed


def test_the_site_needs_no_network_for_its_diagrams():
    assert runpy.run_path(str(ROOT / "docs" / "conf.py"))["mermaid_output_format"] == "svg"


# ------------------------------------------------------------- the diagrams of the architecture

Edge = tuple[str, str, str]
"""Publisher or client, topic or service, subscriber or server."""


def drawn(number: int) -> str:
    """A diagram's text."""
    found = [
        block.text
        for block in documented.blocks(ROOT / "docs" / "architecture.md")
        if block.language == "mermaid"
    ]
    return found[number]


def drawn_edges() -> set[Edge]:
    """Topics and services between the nodes, of the first two diagrams."""
    arrows = re.findall(r'(\w+) -- "([^"]+)" --> (\w+)', drawn(0) + drawn(1))
    return {(one, name, other) for one, names, other in arrows for name in names.split(", ")}


def test_the_access_table_permits_every_edge_that_is_drawn():
    def may(granted: tuple[str, ...], name: str) -> bool:
        return granted == ALL or name in granted

    for one, name, other in drawn_edges():
        first, second = ACCESS[one], ACCESS[other]
        published = may(first.publishes, name) and may(second.subscribes, name)
        called = may(first.calls, name) and name in second.serves
        assert published or called, f"{one} has no access to {name} of {other}"


def test_every_command_between_the_nodes_that_are_drawn_is_drawn():
    nodes = {node for one, _, other in drawn_edges() for node in (one, other)}
    commands = [name for name, row in TOPICS.items() if row.intent is Intent.COMMAND]
    assert {
        (one, name, other)
        for one in nodes
        for other in nodes - {one}
        for name in commands
        if name in ACCESS[one].publishes and name in ACCESS[other].subscribes
    } <= drawn_edges()


def reachable(arrows: dict[str, set[str]], one: str) -> set[str]:
    """All that a package imports, transitively."""
    return {other for each in arrows[one] for other in {each} | reachable(arrows, each)}


def test_the_diagram_of_packages_draws_the_permitted_imports():
    text = re.sub(r'\["[^"]*"\]', "", drawn(2))
    arrows: dict[str, set[str]] = {name: set() for name in architecture.ARROWS}
    for one, other in re.findall(r"(\w+) --> (\w+)", text):
        arrows[one].add(other)
    for name in architecture.ARROWS:
        assert reachable(arrows, name) == reachable(architecture.ARROWS, name), name
    exceptional = {
        (name.partition(".")[0], other)
        for found in (architecture.EXCEPTIONS, architecture.EXCEPTIONAL_FOLDERS)
        for name, others in found.items()
        for other in others
    }
    assert set(re.findall(r"(\w+) -\.->\|[^|]*\| (\w+)", text)) == exceptional
