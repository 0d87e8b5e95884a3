"""Prompts to the operator: at the terminal, or to a program in the operator's place."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Callable
from typing import TextIO

from msg_schemas.regular_files import file_problem
from rover_hil.rehearsal.environment import PreconditionError

_POLL_PERIOD = 0.2  # at which the stop of the rehearsal is checked [s]
_YES, _NO = 0, 1


class OperatorPrompts:
    """Prompts the operator and reads the answers.

    Args:
        operator_program: program in the operator's place, called with a key and a text; its exit
            code is 0 (done, yes), 1 (no), or any other (impossible); empty: prompts go to the
            terminal.
        timeout: of that program [s].
        is_stopped: whether the rehearsal has been stopped.
        terminal: where the operator answers; None: there is no operator.
    """

    def __init__(
        self,
        operator_program: str,
        timeout: float,
        is_stopped: Callable[[], bool],
        terminal: TextIO | None = None,
    ) -> None:
        self._operator_program = operator_program
        self._timeout = timeout
        self._is_stopped = is_stopped
        self._terminal = terminal
        self._typed = b""

    def prompt(self, key: str, instruction: str) -> None:
        """Have the operator carry out an instruction.

        Raises:
            PreconditionError: it was not carried out.
        """
        if self._operator_program:
            code, output = self._call_program(key, instruction)
            if code != _YES:
                raise PreconditionError(
                    f"{instruction} The operator program failed, exit code {code}{output}"
                )
            return
        answer = self._answer(instruction, "done [d], or impossible [n]? ", "dn")
        if answer == "n":
            raise PreconditionError(f"{instruction} The operator answered: impossible")

    def inspect(self, key: str, question: str) -> bool:
        """Have the operator answer a question with yes or no.

        Raises:
            PreconditionError: there is no answer.
        """
        if self._operator_program:
            code, output = self._call_program(key, question)
            if code not in {_YES, _NO}:
                raise PreconditionError(
                    f"{question} The operator program failed, exit code {code}{output}"
                )
            return code == _YES
        answer = self._answer(question, "yes [y], no [n], or cannot decide [c]? ", "ync")
        if answer == "c":
            raise PreconditionError(f"{question} The operator answered: cannot decide")
        return answer == "y"

    def _call_program(self, key: str, instruction: str) -> tuple[int, str]:
        try:
            done = subprocess.run(
                [self._operator_program, key, instruction], capture_output=True, text=True,
                check=False, timeout=self._timeout, stdin=subprocess.DEVNULL,
            )  # fmt: skip
        except OSError as error:
            why = file_problem(error)
            raise PreconditionError(f"{instruction} The operator program failed: {why}") from None
        except subprocess.TimeoutExpired as error:
            raise PreconditionError(f"{instruction} The operator program failed: {error}") from None
        output = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        return done.returncode, f": {output[0]}" if output else ""

    def _answer(self, instruction: str, choice: str, letters: str) -> str:
        terminal = self._terminal
        if terminal is None:
            raise PreconditionError(f"{instruction} There is no operator at a terminal")
        print(f"\n>>> {instruction}\n    {choice}", end="", file=sys.stderr, flush=True)
        while not self._is_stopped():
            if b"\n" not in self._typed:
                if not select.select([terminal], [], [], _POLL_PERIOD)[0]:
                    continue
                # Bypass the stream's own buffer, which would hide lines from select.
                more = os.read(terminal.fileno(), 4096)
                if not more:
                    break
                self._typed += more
                continue
            line, _, self._typed = self._typed.partition(b"\n")
            answer = line.decode(errors="replace").strip().lower()[:1]
            if answer and answer in letters:
                return answer
            print(f"    one of {', '.join(letters)}: ", end="", file=sys.stderr, flush=True)
        raise PreconditionError(f"{instruction} The operator gave no answer")
