"""Tasks come back in order, whoever does them and whatever becomes of the workers."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import pytest

from enumerate.pool import Pending, open_pool, run_in_order

FORKS = pytest.mark.skipif(sys.platform != "linux", reason="workers are threads there")


def test_results_come_in_the_order_of_the_items_whatever_finishes_first() -> None:
    gate = threading.Event()

    def task(item: int) -> int:
        if item == 0:
            assert gate.wait(10.0)
        else:
            gate.set()
        return item * item

    with ThreadPoolExecutor(2) as pool:
        assert list(run_in_order(pool, task, range(5))) == [0, 1, 4, 9, 16]
    gate.set()
    assert list(run_in_order(None, task, range(5))) == [0, 1, 4, 9, 16]


def test_without_an_executor_nothing_runs_before_it_is_asked_for() -> None:
    seen: list[int] = []
    results = run_in_order(None, seen.append, range(9))
    next(results)
    assert seen == [0]


def test_tasks_not_begun_are_cancelled_when_the_consumer_stops() -> None:
    begun: list[int] = []
    free = threading.Event()

    def task(item: int) -> int:
        begun.append(item)
        if item == 1:
            assert free.wait(10.0)
        return item

    with ThreadPoolExecutor(1) as pool:
        results = run_in_order(pool, task, range(50))
        assert next(results) == 0
        results.close()  # type: ignore[attr-defined]
        free.set()
    assert len(begun) <= 3


def test_a_failing_task_raises_where_its_result_is_due() -> None:
    def task(item: int) -> float:
        return 1.0 / (item - 2)

    with ThreadPoolExecutor(2) as pool:
        results = run_in_order(pool, task, range(5))
        assert [next(results), next(results)] == [-0.5, -1.0]
        with pytest.raises(ZeroDivisionError):
            next(results)


def square(item: int) -> int:
    return item * item


def lost_in_a_worker(item: int) -> int:
    if item == 2 and multiprocessing.parent_process() is not None:
        os._exit(1)
    return item * item


def handler_of_interrupts(_: int) -> bool:
    return signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def leave_a_mark(file: Path) -> None:
    file.touch()
    time.sleep(0.05)


def test_one_worker_is_the_caller() -> None:
    with open_pool(1) as pool:
        assert pool is None


@FORKS
def test_workers_are_processes_that_leave_ctrl_c_to_the_caller() -> None:
    with open_pool(2) as pool:
        assert isinstance(pool, ProcessPoolExecutor)
        assert list(run_in_order(pool, handler_of_interrupts, range(3))) == [True] * 3
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def test_without_fork_workers_are_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    with open_pool(2) as pool:
        assert isinstance(pool, ThreadPoolExecutor)
        assert list(run_in_order(pool, square, range(3))) == [0, 1, 4]


@FORKS
@pytest.mark.parametrize(
    "error", [OSError(38, "Function not implemented"), ImportError("sem_open")]
)
def test_without_shared_memory_workers_are_threads(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def refuse(_: object) -> None:
        raise error

    monkeypatch.setattr(multiprocessing.context.ForkContext, "Event", refuse)
    with open_pool(2) as pool:
        assert list(run_in_order(pool, square, range(3))) == [0, 1, 4]
        assert isinstance(pool, ThreadPoolExecutor)


def squares_of_two_workers() -> list[int]:
    with open_pool(2) as pool:
        return list(run_in_order(pool, square, range(3)))


@FORKS
def test_a_daemon_may_plan_with_workers() -> None:
    with multiprocessing.get_context("fork").Pool(1) as pool:  # its processes are daemons
        assert pool.apply(squares_of_two_workers) == [0, 1, 4]


@FORKS
def test_a_system_that_gives_no_process_leaves_all_to_the_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(_: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(multiprocessing.context.ForkProcess, "start", refuse)
    with open_pool(2) as pool:
        assert list(run_in_order(pool, square, range(3))) == [0, 1, 4]


@FORKS
def test_what_lost_workers_leave_is_done_here() -> None:
    with open_pool(2) as pool:
        assert list(run_in_order(pool, lost_in_a_worker, range(6))) == [0, 1, 4, 9, 16, 25]
        assert Pending(pool, square, 7).result() == 49  # the pool takes nothing any more


@FORKS
def test_results_that_nobody_takes_are_not_waited_for(tmp_path: Path) -> None:
    files = [tmp_path / str(i) for i in range(40)]
    with open_pool(2) as pool:
        pending = [Pending(pool, leave_a_mark, file) for file in files]
        pending[0].result()
        for each in pending:
            each.cancel()
    assert 1 <= len(list(tmp_path.iterdir())) < len(files) // 2


@pytest.fixture
def abandoned() -> Iterator[list[int]]:
    """Two workers of a process that was killed."""
    program = (
        "import os, signal\n"
        "from enumerate.pool import open_pool, run_in_order\n"
        "from tests.test_pool import slow_pid\n"
        "with open_pool(2) as pool:\n"
        "    print(*set(run_in_order(pool, slow_pid, range(4))), flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    root = Path(__file__).parent.parent
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=root, timeout=60
    )
    pids = [int(word) for word in done.stdout.split()]
    yield pids
    for pid in pids:
        if is_running(pid):
            os.kill(pid, signal.SIGKILL)


def slow_pid(_: int) -> int:
    time.sleep(0.1)
    return os.getpid()


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


@FORKS
def test_workers_end_with_a_caller_that_is_killed(abandoned: list[int]) -> None:
    assert len(abandoned) == 2
    deadline = time.monotonic() + 20.0
    while any(map(is_running, abandoned)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, abandoned))
