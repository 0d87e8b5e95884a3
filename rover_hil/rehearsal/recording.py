"""The recorder beside a rehearsal: the suite's own executable, a process of its own."""

from __future__ import annotations

import ctypes
import re
import signal
import subprocess
import sys
from pathlib import Path

RECORDER = "rover_bags.record"
"""Started as a module, so that it runs from an installation and from the bare tree."""
_ENDING = 60.0  # longest that closing the bag may take [s]
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None


def _end_with_the_rehearsal() -> None:
    """Have the kernel end the recorder cleanly where the rehearsal is killed."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGINT)


class Recording:
    """One bag.

    Args:
        folder: where it and the recorder's own words go.
        namespace: of the nodes that are recorded.
    """

    def __init__(self, folder: Path, namespace: str) -> None:
        self.bag = folder / "bag"
        self._log = folder / "recorder.log"
        command = [sys.executable, "-m", RECORDER, "--output", str(self.bag)]
        if namespace.strip("/"):
            command += ["--ros-args", "-r", f"__ns:=/{namespace.strip('/')}"]
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                start_new_session=True,  # a Ctrl-C at the terminal is for the rehearsal first
                preexec_fn=_end_with_the_rehearsal,  # noqa: PLW1509 - one system call, no lock
            )  # fmt: skip

    @property
    def is_running(self) -> bool:
        """Whether it still records."""
        return self._process.poll() is None

    def close(self) -> str:
        """End it; returns what it says of the bag.

        Raises:
            OSError: the bag is not whole.
        """
        if self.is_running:
            self._process.send_signal(signal.SIGINT)
        try:
            code = self._process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            raise OSError(f"the recorder did not end within {_ENDING:g} s") from None
        said = self._log.read_text(encoding="utf-8", errors="replace")
        found = re.search(r"^recorded (.*) into .*$", said, re.MULTILINE)
        if code != 0 or found is None:
            last = said.strip().splitlines()[-1:] or ["it said nothing"]
            raise OSError(f"the recorder ended with exit code {code}: {last[0]}")
        return found[1]
