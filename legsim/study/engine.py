"""Runs the tasks of a graph, each when what it needs is done: one after the other here, or on the
workers of a Dask cluster.

Tasks leave their results in files and find them again, so that nothing is lost with the process
that computed it: whoever runs the graph again only computes what is missing. A task that fails
takes with it the tasks that need it, and no other.
"""

import contextlib
import logging
import os
import signal
import time
import traceback
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from legsim import __version__
from legsim.core.errors import LegsimError

_PATIENCE_S = 30
"""for the first worker of a scheduler"""

_GONE_S = 300
"""for another worker when all of a scheduler are gone"""

_LOOK_S = 2
"""between two looks at whether workers are there"""

_PRELOAD = (
    "import logging; logging.getLogger('distributed.worker.state_machine').setLevel(logging.ERROR)"
)
"""What Dask runs in each worker that it starts here. That logger's one warning is of tasks that end
with their worker, which is how a study that is interrupted or terminated ends."""


@dataclass(frozen=True, slots=True)
class Task:
    """A call that can run in any process: a function of a module, and arguments that can be
    pickled.
    """

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    needs: tuple[str, ...] = ()
    """names of tasks that must have ended well before"""


@dataclass(frozen=True, slots=True)
class Step:
    """A task that begins here, or has ended somewhere."""

    name: str
    ended: int
    """tasks, with this one if it has"""
    total: int
    seconds: float | None
    """that it took; None where it begins"""
    failure: str = ""
    """a line; empty where it went well"""


OnStep = Callable[[Step], None]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of the tasks."""

    results: dict[str, Any]
    """by name, of those that ended well"""
    failures: dict[str, str]
    """by name, a line each"""


@dataclass(frozen=True, slots=True)
class _Failure:
    why: str


@dataclass(frozen=True, slots=True)
class _Warned:
    """What a task on a worker came to, in how many seconds, and the warnings that it gave there."""

    value: Any
    seconds: float
    messages: tuple[str, ...]


def run_here(tasks: Sequence[Task], on_step: OnStep, **options: Any) -> Outcome:
    """One task after the other, in this process; ``tasks`` are in an order that satisfies their
    needs.

    ``options`` are given to every function besides its arguments: what cannot be sent to another
    process.
    """
    ended: dict[str, Any] = {}
    for task in tasks:
        on_step(Step(task.name, len(ended), len(tasks), None))
        begun = time.monotonic()
        ended[task.name] = _attempt(task, [ended[name] for name in task.needs], **options)
        on_step(_end(task.name, ended, len(tasks), time.monotonic() - begun))
    return _outcome(ended)


def run_on_cluster(
    tasks: Sequence[Task],
    on_step: OnStep,
    *,
    scheduler: str | None,
    workers: int,
    shared_folder: Path,
) -> Outcome:
    """As many tasks at once as the cluster has workers.

    A worker that is lost costs the task that it was at, which another one starts again; three
    workers lost at one task fail it. When all workers are gone, or the scheduler is, a warning says
    so; without another one for five minutes all tasks that have not ended fail.

    Args:
        scheduler: address of a Dask scheduler whose workers see ``shared_folder``; None starts
            ``workers`` processes here.

    Raises:
        LegsimError: Dask is not installed, the scheduler does not answer, has no workers, or its
            workers do not see the folder or have another version of legsim.
    """
    try:
        import distributed
    except ImportError:
        raise LegsimError(
            "a study on a cluster needs Dask: pip install 'legsim[cluster]'"
        ) from None
    with _client(distributed, scheduler, workers) as client:
        if scheduler is not None:
            _check_workers(client, shared_folder)
        ended: dict[str, Any] = {}
        waiting = {task.name: task for task in tasks}
        running: dict[str, str] = {}
        pending = distributed.as_completed(with_results=False)

        def send() -> None:
            # a task is only sent when what it needs has come back: a result that a worker alone
            # holds would be lost with it; and when a worker is free: Dask, which does not know that
            # a task takes minutes, would queue it behind another one's
            free = max(1, sum(client.nthreads().values())) - (len(running) - len(ended))
            ready = [t for t in waiting.values() if all(name in ended for name in t.needs)]
            for task in ready[: max(0, free)]:
                del waiting[task.name]
                future = client.submit(
                    _attempt_elsewhere,
                    task,
                    [ended[name] for name in task.needs],
                    pure=False,
                    key=_key(task),
                )
                running[future.key] = task.name
                pending.add(future)

        send()
        for future in _arriving(pending, client):
            name = running[future.key]
            came = (
                future.result()
                if future.status == "finished"
                else _Warned(_Failure(_lost(future)), 0.0, ())
            )
            # else Dask would run it again when the worker that holds its result is lost
            future.release()
            ended[name] = _unwrapped(came)
            on_step(_end(name, ended, len(tasks), came.seconds))
            send()
        for name in (task.name for task in tasks if task.name not in ended):
            ended[name] = _Failure(_no_workers(client))
            on_step(_end(name, ended, len(tasks), 0.0))
    return _outcome({task.name: ended[task.name] for task in tasks})


def _end(name: str, ended: dict[str, Any], total: int, seconds: float) -> Step:
    value = ended[name]
    return Step(name, len(ended), total, seconds, value.why if isinstance(value, _Failure) else "")


def _key(task: Task) -> str:
    """A name that no other study on the same scheduler has."""
    return f"{task.name}-{uuid.uuid4().hex[:8]}"


def _attempt(task: Task, needed: Sequence[Any], **options: Any) -> Any:
    lost = [n for n in needed if isinstance(n, _Failure)]
    if lost:
        return _Failure(f"not tried, since what it needs failed ({lost[0].why})")
    try:
        return task.function(*task.arguments, **options)
    except (
        Exception
    ) as error:  # what is wrong with one run, or with legsim there, must not cost the others
        if os.environ.get("LEGSIM_DEBUG"):
            raise
        return _Failure(_why(error))


def _why(error: Exception) -> str:
    """In one line."""
    if isinstance(error, LegsimError):
        return str(error)
    if isinstance(error, MemoryError):
        return "the memory is full; use a smaller preset or fewer workers"
    inner = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return f"{what}, in {inner.filename}, line {inner.lineno} (--debug shows the way there)"


def _attempt_elsewhere(task: Task, needed: Sequence[Any]) -> _Warned:
    """Runs on a worker, whose own warnings nobody would read."""
    begun = time.monotonic()
    with warnings.catch_warnings(record=True) as caught:
        value = _attempt(task, needed)
    return _Warned(
        value, time.monotonic() - begun, tuple(dict.fromkeys(str(w.message) for w in caught))
    )


def _unwrapped(ended: _Warned) -> Any:
    """The value, after its warnings are given here."""
    for message in ended.messages:
        warnings.warn(message, stacklevel=2)
    return ended.value


def _arriving(pending: Any, client: Any) -> Iterator[Any]:
    """Futures as they end; breaks off where there was no worker for :data:`_GONE_S`."""
    looked, seen, warned = time.monotonic(), time.monotonic(), False
    while not pending.is_empty():
        if pending.has_ready():
            seen, warned = time.monotonic(), False
            yield next(pending)
            continue
        time.sleep(0.02)
        if time.monotonic() < looked + _LOOK_S:
            continue
        looked = time.monotonic()
        if _has_workers(client):
            seen, warned = looked, False
        elif not warned:
            warned = True
            warnings.warn(
                f"no worker of {client.scheduler.address} is left: waiting {_GONE_S} s for another "
                "(`dask worker`)",
                stacklevel=3,
            )
        elif looked > seen + _GONE_S:
            return


def _has_workers(client: Any) -> bool:
    """Whether the scheduler answers and has any."""
    try:
        return client.status == "running" and bool(client.nthreads())
    except (OSError, TimeoutError):
        return False


def _no_workers(client: Any) -> str:
    return (
        f"{client.scheduler.address} has had no worker for {_GONE_S} s; start some with `dask "
        "worker` and the study again, which goes on where it was"
    )


def _lost(future: Any) -> str:
    try:
        error = future.exception()
    except Exception as cancelled:  # its scheduler is gone
        error = cancelled
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"


def _outcome(ended: dict[str, Any]) -> Outcome:
    failures = {name: value.why for name, value in ended.items() if isinstance(value, _Failure)}
    return Outcome({name: value for name, value in ended.items() if name not in failures}, failures)


@contextlib.contextmanager
def _client(distributed: Any, scheduler: str | None, workers: int) -> Iterator[Any]:
    """A client of the scheduler, or of a cluster of processes that ends with it."""
    # a lost worker shows in what becomes of its task; the log would repeat it in forty lines
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if scheduler is None:
        # tasks use a device's threads, not the worker's; their memory is not Python's, which Dask
        # would take for a leak
        options: dict[str, Any] = {
            "threads_per_worker": 1,
            "processes": True,
            "memory_limit": 0,
            "dashboard_address": None,
        }
        # without a dashboard Dask still serves HTTP, and says so where another study has its usual
        # port
        options["scheduler_kwargs"] = {"dashboard_address": ":0"}
        options["preload"] = [_PRELOAD]
        # Ctrl-C reaches every process of the terminal; the workers leave it to this one, which ends
        # them
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            started = distributed.LocalCluster(n_workers=workers, **options)
        finally:
            signal.signal(signal.SIGINT, handler)
        with started as cluster, distributed.Client(cluster) as client:
            yield client
        return
    try:
        client = distributed.Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise LegsimError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); start one with "
            "`dask scheduler`"
        ) from None
    with client:
        yield client


def _check_workers(client: Any, folder: Path) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
    except TimeoutError:
        raise LegsimError(
            f"--scheduler {client.scheduler.address} has no workers; start some with `dask worker`"
        ) from None
    mark = folder / ".seen-by-workers"
    mark.write_text(__version__, "utf-8")
    try:
        answers = client.run(_look, str(mark))
    finally:
        mark.unlink()
    for worker, (seen, version) in answers.items():
        if not seen:
            raise LegsimError(
                f"worker {worker} does not see {folder}; put --out on a file system that all "
                "workers share"
            )
        if version != __version__:
            raise LegsimError(
                f"worker {worker} has legsim {version}, this is {__version__}; install the same "
                "version on both"
            )


def _look(path: str) -> tuple[bool, str]:
    """Runs on a worker: whether it sees the file, and its version of the package."""
    return Path(path).is_file(), __version__
