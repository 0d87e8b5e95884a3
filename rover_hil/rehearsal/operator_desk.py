"""The operator: asked at the terminal, or played by a program that acts as the hands."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Callable
from typing import TextIO

from rover_hil.rehearsal.stand import CannotDoError

_LOOK = 0.2  # how often it is looked whether the rehearsal is over [s]
_YES, _NO = 0, 1


class OperatorDesk:
    """Asks, and hears what the operator says.

    Args:
        hands: program that is called with a key and a text, and ends with 0 (done, yes), 1 (no) or
            anything else (it cannot); empty: the operator is asked at the terminal.
        patience: time that such a program has [s].
        is_over: whether the rehearsal is over.
        keyboard: where the operator answers; None: there is no operator.
    """

    def __init__(
        self,
        hands: str,
        patience: float,
        is_over: Callable[[], bool],
        keyboard: TextIO | None = None,
    ) -> None:
        self._hands = hands
        self._patience = patience
        self._is_over = is_over
        self._keyboard = keyboard
        self._typed = b""

    def do(self, key: str, what: str) -> None:
        """Have something done by hand.

        Raises:
            CannotDoError: it was not done.
        """
        if self._hands:
            code, said = self._call_hands(key, what)
            if code != _YES:
                raise CannotDoError(f"{what} The hands could not, exit code {code}{said}")
            return
        answer = self._answer(what, "done [d], or cannot be done [n]? ", "dn")
        if answer == "n":
            raise CannotDoError(f"{what} The operator says that it cannot be done")

    def judge(self, key: str, question: str) -> bool:
        """Have something judged.

        Raises:
            CannotDoError: it cannot be judged.
        """
        if self._hands:
            code, said = self._call_hands(key, question)
            if code not in {_YES, _NO}:
                raise CannotDoError(f"{question} The hands could not, exit code {code}{said}")
            return code == _YES
        answer = self._answer(question, "yes [y], no [n], or cannot be said [c]? ", "ync")
        if answer == "c":
            raise CannotDoError(f"{question} The operator says that it cannot be said")
        return answer == "y"

    def _call_hands(self, key: str, what: str) -> tuple[int, str]:
        try:
            done = subprocess.run(
                [self._hands, key, what], capture_output=True, text=True, check=False,
                timeout=self._patience, stdin=subprocess.DEVNULL,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CannotDoError(f"{what} The hands could not: {error}") from None
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        return done.returncode, f": {said[0]}" if said else ""

    def _answer(self, what: str, choice: str, letters: str) -> str:
        keyboard = self._keyboard
        if keyboard is None:
            raise CannotDoError(f"{what} There is no operator at a terminal")
        print(f"\n>>> {what}\n    {choice}", end="", file=sys.stderr, flush=True)
        while not self._is_over():
            if b"\n" not in self._typed:
                if not select.select([keyboard], [], [], _LOOK)[0]:
                    continue
                # Past the stream's own buffer, which would hide lines from select.
                more = os.read(keyboard.fileno(), 4096)
                if not more:
                    break
                self._typed += more
                continue
            line, _, self._typed = self._typed.partition(b"\n")
            said = line.decode(errors="replace").strip().lower()[:1]
            if said and said in letters:
                return said
            print(f"    one of {', '.join(letters)}: ", end="", file=sys.stderr, flush=True)
        raise CannotDoError(f"{what} The operator gave no answer")
