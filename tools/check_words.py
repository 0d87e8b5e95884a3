"""Refuse retired words: names, messages and texts use the terms of docs/glossary.md.

    python tools/check_words.py [PATH ...]      all tracked files, or those below the paths

Python is read by its syntax tree. What a file defines (classes, functions, arguments, variables,
attributes) is a name and is split into words, so that `hear_imu` contains `hear`. A string with a
blank that is no docstring is a message; a string of identifier characters is a name. What a library
defines is not checked. In other files, keys of YAML and definitions of JavaScript are names. Every
line of every file is text.

Exit code 1 lists each violation as `file:line: 'word' in NAME: write ...`.
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

GLOSSARY = Path("docs/glossary.md")
# What is not written in the project's words: the licence, data, libraries of others.
_FOREIGN = re.compile(r"(^LICENSE$|/vendor/|\.(png|gif|csv|npz|eds|svg)$)")
_TEXTS = {
    ".py",
    ".md",
    ".rst",
    ".yaml",
    ".yml",
    ".js",
    ".html",
    ".css",
    ".toml",
    ".cfg",
    ".sh",
    ".xml",
}

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
_PROSE = re.compile(r"[A-Za-z]+")
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:[./-][A-Za-z_][A-Za-z0-9_]*)*")
_YAML_KEY = re.compile(r"^\s*(?:- )?([A-Za-z_][\w.]*)\s*:")
_JS_NAME = re.compile(
    r"\b(?:const|let|var|function|class)\s+(?:\[|\{)?\s*([A-Za-z_$][\w$]*)|([A-Za-z_$][\w$]*)\s*[:(=]"
)


class RefusalScope(IntEnum):
    """Where a word is refused; each includes those before it."""

    NAMES = 1
    MESSAGES = 2
    ALL = 3


@dataclass(frozen=True)
class RetiredWord:
    """One retired word, or several in sequence.

    Attributes:
        words: in lower case.
        instead: what to write.
        scope: where it is refused.
    """

    words: tuple[str, ...]
    instead: str
    scope: RefusalScope


@dataclass(frozen=True)
class Glossary:
    """The tables of the glossary.

    Attributes:
        rules: by their first word.
        exceptions: names that keep a retired word, and the files or folders where they do.
    """

    rules: dict[str, list[RetiredWord]]
    exceptions: dict[str, frozenset[Path]]

    def is_excepted(self, text: str, path: Path) -> bool:
        """Whether a text of a file is a name that keeps its word there."""
        return not self.exceptions.get(text, frozenset()).isdisjoint((path, *path.parents))

    def broken(self, words: Sequence[str], scope: RefusalScope) -> Iterator[RetiredWord]:
        """Yield the rules that a text's words break, for a text of this scope."""
        for index, word in enumerate(words):
            for rule in self.rules.get(word, ()):
                length = len(rule.words)
                if rule.scope >= scope and tuple(words[index : index + length]) == rule.words:
                    yield rule


def read_glossary(text: str) -> Glossary:
    """Read the tables of the glossary's document.

    Raises:
        ValueError: a row is not readable.
    """
    rules: dict[str, list[RetiredWord]] = {}
    exceptions: dict[str, frozenset[Path]] = {}
    heading = ""
    for line in text.splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|") or set(cells[0]) <= {"-"}:
            continue
        if heading == "Retired words" and cells[0] != "in place of":
            retired, instead, where = cells
            for entry in retired.split(","):
                words = tuple(entry.strip().lower().split())
                rules.setdefault(words[0], []).append(
                    RetiredWord(words, instead, RefusalScope[where.upper()])
                )
        if heading == "Exceptions" and cells[0] != "name":
            name, places, _ = cells
            found = frozenset(Path(place.strip(" `")) for place in places.split(","))
            exceptions[name.strip("`")] = found
    if not rules:
        raise ValueError(f"{GLOSSARY} has no table of retired words")
    return Glossary(rules, exceptions)


def words_of(name: str) -> list[str]:
    """Return the words of an identifier, in lower case."""
    return [word.lower() for word in _WORD.findall(name)]


@dataclass(frozen=True)
class Piece:
    """A name, a message or a line of text.

    Attributes:
        line: from 1.
    """

    text: str
    scope: RefusalScope
    line: int


# --- Python --------------------------------------------------------------------------------------


def _docstrings(tree: ast.AST) -> set[int]:
    found = set()
    for node in ast.walk(tree):
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        found |= {
            id(each.value)
            for each in node.body
            if isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
        }
    return found


def python_pieces(source: str) -> Iterator[Piece]:
    """Yield what a module defines, and its strings; comments and docstrings come as text."""
    tree = ast.parse(source)
    docstrings = _docstrings(tree)
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield Piece(node.name, RefusalScope.NAMES, node.lineno)
        elif isinstance(node, ast.arg):
            yield Piece(node.arg, RefusalScope.NAMES, node.lineno)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield Piece(node.id, RefusalScope.NAMES, node.lineno)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield Piece(node.attr, RefusalScope.NAMES, node.lineno)
        elif isinstance(node, ast.alias) and node.asname:
            yield Piece(
                node.asname, RefusalScope.NAMES, node.lineno if hasattr(node, "lineno") else 1
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) in docstrings:
                continue
            is_name = _IDENTIFIER.fullmatch(node.value) is not None
            scope = RefusalScope.NAMES if is_name else RefusalScope.MESSAGES
            yield Piece(node.value, scope, node.lineno)
    yield from _lines(source)


# --- everything else -----------------------------------------------------------------------------


def _lines(source: str) -> Iterator[Piece]:
    for number, line in enumerate(source.splitlines(), 1):
        yield Piece(line, RefusalScope.ALL, number)


def yaml_pieces(source: str) -> Iterator[Piece]:
    """Yield the keys of a YAML file, and its lines as text."""
    for number, line in enumerate(source.splitlines(), 1):
        key = _YAML_KEY.match(line)
        if key:
            yield Piece(key[1], RefusalScope.NAMES, number)
    yield from _lines(source)


def javascript_pieces(source: str) -> Iterator[Piece]:
    """Yield what a script defines, and its lines as text."""
    for number, line in enumerate(source.splitlines(), 1):
        code = line.split("//")[0]
        for match in _JS_NAME.finditer(code):
            yield Piece(match[1] or match[2], RefusalScope.NAMES, number)
    yield from _lines(source)


def pieces_of(path: Path, source: str) -> Iterator[Piece]:
    """Yield what a file holds to the glossary: its own name, names, messages and lines."""
    yield Piece(path.stem, RefusalScope.NAMES, 1)
    read = {".py": python_pieces, ".yaml": yaml_pieces, ".js": javascript_pieces}
    yield from read.get(path.suffix, _lines)(source)


def violations(glossary: Glossary, path: Path, source: str) -> list[str]:
    """Return one sentence for each retired word in a file."""
    found: dict[tuple[int, str], str] = {}
    for piece in pieces_of(path, source):
        if glossary.is_excepted(piece.text, path):
            continue
        if piece.scope is RefusalScope.NAMES:
            words = words_of(piece.text)
        else:
            words = [word.lower() for word in _PROSE.findall(piece.text)]
        for rule in glossary.broken(words, piece.scope):
            word = " ".join(rule.words)
            shown = piece.text.strip() if len(piece.text) <= 60 else f"{piece.text.strip()[:57]}..."
            found.setdefault(
                (piece.line, word),
                f"{path}:{piece.line}: '{word}' in {shown!r}: write {rule.instead}",
            )
    return [found[key] for key in sorted(found)]


def tracked_files(root: Path, paths: Sequence[str]) -> list[Path]:
    """Return the files of the tree that are written in the project's words."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *paths],
        cwd=root, check=True, capture_output=True, text=True,
    ).stdout.splitlines()  # fmt: skip
    return [
        Path(name)
        for name in listed
        if Path(name).suffix in _TEXTS and not _FOREIGN.search(name) and (root / name).exists()
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Check the tree that holds this file."""
    parser = argparse.ArgumentParser(description="Refuse the retired words of docs/glossary.md.")
    parser.add_argument("paths", nargs="*", metavar="PATH", help="files or folders; default: all")
    arguments = parser.parse_args(argv)
    root = Path(__file__).resolve().parents[1]
    glossary = read_glossary((root / GLOSSARY).read_text(encoding="utf-8"))
    found: list[str] = []
    for path in tracked_files(root, arguments.paths):
        if path in {GLOSSARY, Path("test/test_check_words.py")}:
            continue  # they quote the words
        found += violations(glossary, path, (root / path).read_text(encoding="utf-8"))
    for sentence in found:
        print(sentence)
    if found:
        print(f"{len(found)} retired words; docs/glossary.md names the terms to write")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
