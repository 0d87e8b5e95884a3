"""Executables of the suite as separate processes.

A process is started as ``python -m module``: it runs from a checkout and from an installation. It
has its own process group, so that remaining child processes are found. Its output is read
continuously; waits have a timeout, whose error contains the output.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import msg_schemas
from rover_runtime.stop_signals import deferred_stop_signals

# [s]. Generous for slow and busy computers; a successful wait is shorter.
DEFAULT_TIMEOUT = 60.0

# Folder from which the suite is imported.
_SUITE_ROOT = Path(msg_schemas.__file__).parents[1]

# The kernel sends a signal to a process when its parent dies.
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None


def _terminate_with_parent() -> None:
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def environment(domain: int, extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment of a process in a ROS domain on this computer only."""
    command_line = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    paths = [str(_SUITE_ROOT), *command_line]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths)),
        "PYTHONUNBUFFERED": "1",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_PYTHON_CHECK_FIELDS": "1",
        **(extra or {}),
    }


def ros_arguments(
    parameters: Mapping[str, object] | None = None,
    namespace: str = "",
    params_file: Path | None = None,
    remap: Mapping[str, str] | None = None,
) -> list[str]:
    """Return ``--ros-args`` with its arguments."""
    arguments = []
    for name, other in (remap or {}).items():
        arguments += ["-r", f"{name}:={other}"]
    if namespace:
        arguments += ["-r", f"__ns:=/{namespace.strip('/')}"]
    if params_file is not None:
        arguments += ["--params-file", str(params_file)]
    for name, value in (parameters or {}).items():
        arguments += ["-p", f"{name}:={_yaml(value)}"]
    return ["--ros-args", *arguments] if arguments else []


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    # Quoted: ROS would parse a text such as "1" or "a: b" as another type.
    return f"'{value}'" if isinstance(value, str) else str(value)


class Process:
    """One executable, its output and its exit code."""

    def __init__(
        self, module: str, arguments: Sequence[str], env: Mapping[str, str], cwd: Path
    ) -> None:
        self.module = module
        self._changed = threading.Condition()
        self._lines: list[str] = []
        self._popen = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            env=dict(env),
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            preexec_fn=_terminate_with_parent,  # noqa: PLW1509 - one system call, no lock
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            with self._changed:
                self._lines.append(line)
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    @property
    def pid(self) -> int:
        """Identifier of the process and its group."""
        return self._popen.pid

    @property
    def output(self) -> str:
        """Output so far, including stderr."""
        with self._changed:
            return "".join(self._lines)

    @property
    def is_running(self) -> bool:
        """Whether it is running."""
        return self._popen.poll() is None

    def wait_for_output(self, pattern: str, timeout: float = DEFAULT_TIMEOUT) -> re.Match[str]:
        """Wait for a pattern in the output; AssertionError if the process exits without it."""
        deadline = time.monotonic() + timeout
        with self._changed:
            while True:
                match = re.search(pattern, "".join(self._lines))
                if match:
                    return match
                ended = not self.is_running and not self._reader.is_alive()
                if ended or time.monotonic() > deadline:
                    how = "exited" if ended else f"did not within {timeout:g} s"
                    raise AssertionError(
                        f"{self.module} should print {pattern!r}, it {how}:\n"
                        + "".join(self._lines)
                    )
                self._changed.wait(0.2)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process alone."""
        self._popen.send_signal(number)

    def send_to_group(self, number: signal.Signals) -> None:
        """Send a signal to the whole group, as a terminal does with Ctrl-C."""
        os.killpg(self.pid, number)

    def exits_within(self, timeout: float) -> bool:
        """Whether it exits within a timeout [s], or has exited."""
        try:
            self._popen.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def wait(self, timeout: float = DEFAULT_TIMEOUT) -> int:
        """Wait for the exit and return its code; AssertionError after the timeout."""
        if not self.exits_within(timeout):
            raise AssertionError(
                f"{self.module} should have exited within {timeout:g} s:\n{self.output}"
            )
        self._reader.join(5.0)
        return int(self._popen.returncode)

    def stop(self, number: signal.Signals = signal.SIGINT, timeout: float = DEFAULT_TIMEOUT) -> int:
        """Send a signal and wait for the exit code."""
        self.send(number)
        return self.wait(timeout)

    def has_group_exited(self) -> bool:
        """Whether no process of the group is running."""
        try:
            os.killpg(self.pid, 0)
        except ProcessLookupError:
            return True
        return False

    def kill_group(self) -> None:
        """Kill the remaining processes of the group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._popen.wait()
        self._reader.join(5.0)


class Processes:
    """Starts executables in one ROS domain and checks that they exit without remains."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.domain = domain
        self.folder = folder
        self._started: list[Process] = []

    def start(
        self,
        module: str,
        parameters: Mapping[str, object] | None = None,
        *arguments: str,
        namespace: str = "",
        params_file: Path | None = None,
        remap: Mapping[str, str] | None = None,
        extra_environment: Mapping[str, str] | None = None,
    ) -> Process:
        """Start ``python -m module`` with arguments and ROS parameters."""
        command_line = [*arguments, *ros_arguments(parameters, namespace, params_file, remap)]
        env = environment(self.domain, extra_environment)
        with deferred_stop_signals():
            process = Process(module, command_line, env, self.folder)
            self._started.append(process)
        return process

    @property
    def output(self) -> str:
        """Output of all processes so far, by module."""
        return "".join(f"--- {process.module}:\n{process.output}" for process in self._started)

    def end(self) -> None:
        """Stop all processes; AssertionError if one does not exit or leaves children."""
        for process in self._started:
            if process.is_running:  # SIGINT may be lost while a process imports its modules
                process.send(signal.SIGTERM)
        complaints = []
        for process in self._started:
            try:
                process.wait()
            except AssertionError as error:
                complaints.append(str(error))
            if not process.has_group_exited():
                complaints.append(f"{process.module} left processes of its group running")
                process.kill_group()
        assert not complaints, "\n".join(complaints)


def clean_shared_memory() -> None:
    """Remove unused shared memory of killed DDS participants."""
    beside = Path(sys.executable).with_name("fastdds")
    tool = str(beside) if beside.exists() else shutil.which("fastdds")
    if tool is not None:
        subprocess.run([tool, "shm", "clean"], check=False, capture_output=True, timeout=60)
