"""Refuse commit subjects that are no imperative of at most 72 characters.

    python tools/check_commits.py [REVISION]        commits since REVISION or since this check
    python tools/check_commits.py --message FILE    the message that git hands to a hook

The first word is refused where it is clearly not an imperative: a gerund, a past tense, an article.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

LONGEST = 72
_NO_IMPERATIVE = re.compile(r"^(an?|the|this|it|\w+ing|\w+[^e]ed|\w+'s)$", re.IGNORECASE)
_IMPERATIVES = frozenset(
    {"bring", "ring", "string", "swing", "embed", "feed", "need", "seed", "speed"}
)


def complaint(subject: str) -> str:
    """Return what is wrong with a commit's subject; empty = nothing."""
    if len(subject) > LONGEST:
        return f"{len(subject)} characters, at most {LONGEST}"
    first = subject.split(" ", 1)[0]
    if not first[:1].isupper() or subject.endswith("."):
        return "begin with a capital letter, end without a full stop"
    if _NO_IMPERATIVE.match(first) and first.lower() not in _IMPERATIVES:
        return f"{first!r} is no imperative: 'Reject a trim while the winch is in a fault'"
    return ""


def _git(*arguments: str) -> str:
    root = Path(__file__).resolve().parent
    return subprocess.run(
        ["git", *arguments], cwd=root, check=True, capture_output=True, text=True
    ).stdout.strip()


def main(argv: Sequence[str]) -> int:
    """Check the commits since a revision, or one message."""
    parser = argparse.ArgumentParser(description="Check the subjects of commits.")
    parser.add_argument("revision", nargs="?", help="after which commits are checked")
    parser.add_argument("--message", type=Path, metavar="FILE", help="check this message alone")
    given = parser.parse_args(argv)
    if given.message:
        reason = complaint(given.message.read_text(encoding="utf-8").partition("\n")[0])
        if reason:
            print(reason)
        return 1 if reason else 0
    since = given.revision or _git(
        "log", "--diff-filter=A", "--format=%H", "--reverse", "--", Path(__file__).name
    ).partition("\n")[0]  # fmt: skip
    wrong = 0
    for line in _git("log", "--format=%h %s", f"{since}..HEAD").splitlines() if since else ():
        revision, _, subject = line.partition(" ")
        reason = complaint(subject)
        if reason:
            print(f"{revision} {subject!r}: {reason}")
            wrong += 1
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
