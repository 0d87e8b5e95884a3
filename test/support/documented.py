"""What the documents show: fenced blocks, and the commands in those for a shell."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
SHELL = "bash"
_FENCE = re.compile(r"```(\S*)")
_TYPED = re.compile(r"`([^`]+)`")
_FILE = re.compile(r"<!-- file: (\S+) -->")
_ENDS = frozenset({"&&", ";", "&", "|", "||", "(", ")"})


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        language: that it says it is in.
        file: from which it is, as a comment right before it says; empty: it is its own.
    """

    document: str
    line: int
    language: str
    text: str
    file: str = ""

    @property
    def place(self) -> str:
        """Where it stands, for tests' names."""
        return f"{self.document}:{self.line}"


@dataclass(frozen=True)
class Command:
    """One command for a shell: a program and its arguments."""

    words: tuple[str, ...]
    place: str
    block: Block

    @property
    def program(self) -> str:
        """What is run."""
        return self.words[0]

    def __str__(self) -> str:
        return f"{self.place} {shlex.join(self.words)}"


def blocks(document: Path) -> list[Block]:
    """The fenced blocks of a document."""
    found: list[Block] = []
    name = str(document.relative_to(ROOT))
    begin, language, before, held = 0, "", "", [""]
    for number, line in enumerate(document.read_text(encoding="utf-8").splitlines(), start=1):
        fence = _FENCE.match(line)
        if begin and line == "```":
            found.append(Block(name, begin, language, "".join(held), before))
            begin = 0
        elif begin:
            held.append(line + "\n")
        elif fence is not None:
            begin, language, held = number, fence[1], []
        elif line.strip():
            marker = _FILE.fullmatch(line.strip())
            before = "" if marker is None else marker[1]
    assert not begin, f"{name}:{begin} is not closed"
    return found


def indented(document: Path) -> list[str]:
    """Lines that are code by their indentation alone, without a language."""
    found, fenced, previous = [], False, ""
    for number, line in enumerate(document.read_text(encoding="utf-8").splitlines(), start=1):
        fenced ^= line.startswith("```")
        if not fenced and line.startswith("    ") and line.strip() and not previous.strip():
            found.append(f"{document.name}:{number}: {line.strip()}")
        previous = line
    return found


def commands() -> list[Command]:
    """Every command of every document, in order."""
    return [
        command
        for document in DOCUMENTS
        for block in blocks(document)
        if block.language == SHELL
        for command in commands_of(block)
    ]


def commands_of(block: Block) -> Iterator[Command]:
    """The commands of a block for a shell."""
    number, held = block.line, ""
    for line in block.text.splitlines():
        number += 1
        held += line.removesuffix("\\")
        if line.endswith("\\"):
            continue
        lexer = shlex.shlex(held, posix=True, punctuation_chars="&|;()")
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if word not in _ENDS:
                words.append(word)
            elif words:
                yield Command(tuple(words), f"{block.document}:{number}", block)
                words = []
        held = ""


def typed_in_text(programs: tuple[str, ...]) -> list[Command]:
    """Commands with arguments that stand within sentences and tables, of these programs."""
    found: dict[tuple[str, ...], Command] = {}
    for document in DOCUMENTS:
        fenced = False
        for number, line in enumerate(document.read_text(encoding="utf-8").splitlines(), start=1):
            fenced ^= line.startswith("```")
            for text in () if fenced else _TYPED.findall(line):
                if text.split()[0] not in programs:
                    continue
                words = tuple(shlex.split(text))
                if len(words) > 1:
                    place = f"{document.relative_to(ROOT)}:{number}"
                    block = Block(str(document), number, SHELL, text)
                    found.setdefault(words, Command(words, place, block))
    return list(found.values())


def section(document: str, heading: str) -> list[Command]:
    """The commands under a heading of a document, up to the next heading."""
    path = ROOT / document
    lines = path.read_text(encoding="utf-8").splitlines()
    headings = [number for number, line in enumerate(lines, start=1) if line.startswith("## ")]
    (begin,) = [number for number in headings if lines[number - 1] == f"## {heading}"]
    end = min((number for number in headings if number > begin), default=len(lines))
    found = [
        command
        for block in blocks(path)
        if block.language == SHELL and begin < block.line < end
        for command in commands_of(block)
    ]
    assert found, f"{document} has no commands under {heading}"
    return found
