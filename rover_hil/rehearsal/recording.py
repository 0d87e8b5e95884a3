"""Recorder of a rehearsal: the suite's `bag_record` in a child process."""

from __future__ import annotations

import ctypes
import re
import signal
import subprocess
import sys
from pathlib import Path

RECORDER = "rover_bags.recording.record"
"""Started as a module: it runs from an installation and from a checkout."""
_CLOSE_TIMEOUT = 60.0  # to close the bag [s]
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None


def _interrupt_with_parent() -> None:
    """Have the kernel interrupt the recorder if the rehearsal is killed."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGINT)


class Recording:
    """Recording of one bag.

    Args:
        folder: for the bag and the log of the recorder.
        namespace: of the recorded nodes.
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
                start_new_session=True,  # Ctrl-C reaches the rehearsal first
                preexec_fn=_interrupt_with_parent,  # noqa: PLW1509 - one system call, no lock
            )  # fmt: skip

    @property
    def is_running(self) -> bool:
        """Whether it still records."""
        return self._process.poll() is None

    def close(self) -> str:
        """Stop the recorder; returns its summary of the bag.

        Raises:
            OSError: the bag is incomplete.
        """
        if self.is_running:
            self._process.send_signal(signal.SIGINT)
        try:
            code = self._process.wait(_CLOSE_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            raise OSError(f"the recorder did not stop within {_CLOSE_TIMEOUT:g} s") from None
        output = self._log.read_text(encoding="utf-8", errors="replace")
        found = re.search(r"^recorded (.*) into .*$", output, re.MULTILINE)
        if code != 0 or found is None:
            last = output.strip().splitlines()[-1:] or ["no output"]
            raise OSError(f"the recorder stopped with exit code {code}: {last[0]}")
        return found[1]
