"""Worker processes: start, errors, and end."""

from __future__ import annotations

import multiprocessing
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rover_sim import worker_processes

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 60.0
ORPHANS = """
import multiprocessing, signal
from rover_sim import worker_processes
if __name__ == "__main__":
    with worker_processes(2) as pool:
        jobs = [pool.submit(signal.pause) for _ in range(4)]
        print(*(child.pid for child in multiprocessing.active_children()), flush=True)
        signal.pause()
"""


def wait_until_gone(watched: list[int]) -> None:
    """Wait until all processes of these descriptors (pidfd) have ended."""
    for one in watched:
        ended, _, _ = select.select([one], [], [], PATIENCE)
        assert ended, "a process lives on"
        os.close(one)


def test_each_worker_is_prepared_and_single_threaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    with worker_processes(1, os.chdir, tmp_path) as pool:
        assert pool.submit(os.getcwd).result() == str(tmp_path)
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert Path.cwd() != tmp_path


def test_an_error_ends_running_tasks_and_cancels_pending_ones():
    begin = time.monotonic()
    children: list[int] = []

    def interrupted() -> None:
        with worker_processes(2) as pool:
            for _ in range(5):
                pool.submit(signal.pause)
            children.extend(
                os.pidfd_open(child.pid or 0) for child in multiprocessing.active_children()
            )
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - begin < PATIENCE
    wait_until_gone(children)


def test_workers_end_with_their_parent_in_any_case(tmp_path: Path):
    script = tmp_path / "orphans.py"
    script.write_text(ORPHANS, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    parent = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert parent.stdout is not None
    workers = [os.pidfd_open(int(word)) for word in parent.stdout.readline().split()]
    assert len(workers) == 2
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    wait_until_gone(workers)
    parent.stdout.close()
