#!/usr/bin/env python3
"""Start executables of a folder: each prints its help, each node joins the graph and obeys Ctrl-C.

Usage: start_executables.py [--help-alone] FOLDER NAME ...      (by the Python under test)

With --help-alone each only prints its help.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import rclpy
from rclpy.node import Node

HELP_SECONDS = 120
JOIN_SECONDS = 120
STOP_SECONDS = 20
NAMED_OTHERWISE = ("drive_emulator", "hil_bridge", "mock_plant", "operator_console")  # nodes too


def prints_help(path: Path) -> str:
    """Return what is wrong with the executable's help, or nothing."""
    done = subprocess.run(
        [path, "--help"],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=HELP_SECONDS,
        check=False,
    )
    if done.returncode != 0:
        return f"--help ended with {done.returncode}\n{done.stdout}{done.stderr}"
    if "usage" not in done.stdout.lower():
        return f"--help names no usage\n{done.stdout}"
    return ""


def group_is_alive(group: int) -> bool:
    """Return whether any process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def joins_and_obeys(path: Path, observer: Node) -> str:
    """Return what is wrong with the node's start and stop, or nothing."""
    process = subprocess.Popen(
        [path],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + JOIN_SECONDS
        while path.name not in observer.get_node_names():
            if process.poll() is not None or time.monotonic() > deadline:
                process.kill()
                return f"did not join the graph\n{process.communicate()[0]}"
            rclpy.spin_once(observer, timeout_sec=0.1)
        process.send_signal(signal.SIGINT)
        try:
            output = process.communicate(timeout=STOP_SECONDS)[0]
        except subprocess.TimeoutExpired:
            return f"still runs {STOP_SECONDS} s after Ctrl-C"
        if process.returncode != 0 or "Traceback" in output:
            return f"ended with {process.returncode} after Ctrl-C\n{output}"
        return "left processes behind" if group_is_alive(process.pid) else ""
    finally:
        if group_is_alive(process.pid):
            os.killpg(process.pid, signal.SIGKILL)


def main() -> int:
    """Start them all; return the number of those that failed."""
    help_alone = sys.argv[1] == "--help-alone"
    folder, *names = sys.argv[2 if help_alone else 1 :]
    failures = 0
    rclpy.init()
    observer = Node("ci_observer")
    for name in names:
        path = Path(folder).absolute() / name
        wrong = prints_help(path) if path.is_file() else "is not there"
        is_node = name.endswith("_node") or name in NAMED_OTHERWISE
        if not wrong and is_node and not help_alone:
            wrong = joins_and_obeys(path, observer)
        failures += bool(wrong)
        print(f"  {path}: {wrong or 'ok'}", flush=True)
    observer.destroy_node()
    rclpy.shutdown()
    return failures


if __name__ == "__main__":
    sys.exit(main())
