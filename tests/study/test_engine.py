"""Tasks run in the order of their needs, a failure takes only what needs it, and a lost worker
costs its own task.
"""

import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import pytest

from legsim.core.errors import LegsimError
from legsim.study import engine
from legsim.study.engine import Step, Task

pytestmark = [
    # of Dask and tornado themselves, while a cluster is taken down
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    # of a loaded machine
    pytest.mark.filterwarnings(
        "ignore:Creating scratch directories is taking a surprisingly long time"
    ),
]


def note(folder: Path, name: str, **_: object) -> str:
    """Leaves a line a call, as tasks leave their files."""
    with (folder / "calls.txt").open("a") as stream:
        stream.write(f"{name}\n")
    return name.upper()


def refuse(*_: object, **__: object) -> str:
    raise LegsimError("no such recording")


def warn(folder: Path, name: str, **_: object) -> str:
    warnings.warn("a short scan", stacklevel=1)
    return note(folder, name)


def die_once(folder: Path, name: str, **_: object) -> str:
    """Kills the process it runs in, the first time."""
    mark = folder / "died"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(60)
    return note(folder, name)


def graph(folder: Path) -> list[Task]:
    return [
        Task("a", note, (folder, "a")),
        Task("bad", refuse, ()),
        Task("b", note, (folder, "b"), ("a",)),
        Task("after", note, (folder, "after"), ("bad",)),
        Task("last", note, (folder, "last"), ("after",)),
    ]


def calls(folder: Path) -> list[str]:
    return (folder / "calls.txt").read_text().split()


def check(outcome: engine.Outcome, folder: Path) -> None:
    assert outcome.results == {"a": "A", "b": "B"}
    assert outcome.failures["bad"] == "no such recording"
    assert "not tried" in outcome.failures["after"]
    assert "no such recording" in outcome.failures["last"]
    assert calls(folder) == ["a", "b"]


def test_here_a_failure_takes_what_needs_it_and_nothing_else(tmp_path):
    seen: list[Step] = []
    check(engine.run_here(graph(tmp_path), seen.append, extra=1), tmp_path)
    assert [step.name for step in seen if step.seconds is None] == [
        "a",
        "bad",
        "b",
        "after",
        "last",
    ]
    ends = [step for step in seen if step.seconds is not None]
    assert [(step.name, step.ended, step.total) for step in ends] == [
        (n, k + 1, 5) for k, n in enumerate(["a", "bad", "b", "after", "last"])
    ]
    assert [step.failure for step in ends][:3] == ["", "no such recording", ""]


def stumble(*_: object, **__: object) -> str:
    raise KeyError("skin")


def test_a_fault_that_nobody_foresaw_costs_its_task_alone_unless_it_is_looked_for(
    tmp_path, monkeypatch
):
    monkeypatch.delenv("LEGSIM_DEBUG", raising=False)
    tasks = [Task("wrong", stumble, ()), Task("a", note, (tmp_path, "a"))]
    outcome = engine.run_here(tasks, lambda *_: None)
    assert outcome.results == {"a": "A"}
    assert outcome.failures["wrong"].startswith(f"KeyError: 'skin', in {__file__}, line ")
    monkeypatch.setenv("LEGSIM_DEBUG", "1")
    with pytest.raises(KeyError, match="skin"):
        engine.run_here(tasks, lambda *_: None)


@pytest.mark.end_to_end
def test_on_a_cluster_it_is_the_same_and_a_killed_worker_costs_its_task(tmp_path):
    pytest.importorskip("distributed")
    # the worker dies when all others have come back, else one of them might rightly be run twice
    tasks = [*graph(tmp_path), Task("warned", warn, (tmp_path, "warned"))]
    tasks.append(Task("killed", die_once, (tmp_path, "killed"), ("b", "warned")))
    ended: list[str] = []
    with pytest.warns(UserWarning, match="^a short scan$"):
        outcome = engine.run_on_cluster(
            tasks,
            lambda step: ended.append(step.name),
            scheduler=None,
            workers=2,
            shared_folder=tmp_path,
        )
    assert outcome.results.pop("warned") == "WARNED"
    assert outcome.results.pop("killed") == "KILLED"
    assert (tmp_path / "died").exists()
    assert sorted(calls(tmp_path)) == ["a", "b", "killed", "warned"]
    (tmp_path / "calls.txt").write_text("a\nb\n")
    check(outcome, tmp_path)
    assert sorted(ended) == sorted(task.name for task in tasks)


def nap(folder: Path, name: str, **_: object) -> str:
    """The long one ends when all others have, or after a time in which each of them could have run
    many times.
    """
    if name == "long":
        give_up = time.monotonic() + 20
        while len(calls(folder)) < 6 and time.monotonic() < give_up:
            time.sleep(0.05)
    return note(folder, name)


@pytest.mark.end_to_end
def test_no_task_waits_behind_a_long_one_while_a_worker_is_free(tmp_path):
    names = ["long", *(f"short{k}" for k in range(6))]
    ended: list[str] = []
    tasks = [Task(name, nap, (tmp_path, name)) for name in names]
    (tmp_path / "calls.txt").touch()
    engine.run_on_cluster(
        tasks,
        lambda step: ended.append(step.name),
        scheduler=None,
        workers=2,
        shared_folder=tmp_path,
    )
    # the sixth short one is sent when the fifth has come back; it may be told before or after the
    # long one
    assert ended.index("long") >= 5
    assert sorted(ended) == sorted(names)


@pytest.mark.end_to_end
def test_a_scheduler_that_is_not_there_is_reported():
    pytest.importorskip("distributed")
    with pytest.raises(LegsimError, match="no Dask scheduler answers"):
        engine.run_on_cluster(
            [], lambda *_: None, scheduler="tcp://127.0.0.1:9", workers=1, shared_folder=Path()
        )


def test_a_scheduler_without_workers_is_reported(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(engine, "_PATIENCE_S", 0.2)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as cluster,
        pytest.raises(LegsimError, match="has no workers; start some with `dask worker`"),
    ):
        engine.run_on_cluster(
            [],
            lambda *_: None,
            scheduler=cluster.scheduler_address,
            workers=1,
            shared_folder=tmp_path,
        )


def test_workers_that_do_not_see_the_folder_are_named(tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        address = cluster.scheduler_address
        outcome = engine.run_on_cluster(
            [Task("a", note, (tmp_path, "a"))],
            lambda *_: None,
            scheduler=address,
            workers=1,
            shared_folder=tmp_path,
        )
        assert outcome.results == {"a": "A"}
        original = engine._look
        engine._look = lambda _: (False, "0")
        try:
            with pytest.raises(LegsimError, match="does not see"):
                engine.run_on_cluster(
                    [], lambda *_: None, scheduler=address, workers=1, shared_folder=tmp_path
                )
        finally:
            engine._look = original


TERMINATED = """
import sys, time
from pathlib import Path
from legsim.study import engine

def doze(folder, name):
    (folder / name).touch()
    time.sleep(60)

if __name__ == "__main__":
    import signal
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    folder = Path(sys.argv[1])
    tasks = [engine.Task(name, doze, (folder, name)) for name in "ab"]
    engine.run_on_cluster(tasks, print, scheduler=None, workers=2, shared_folder=folder)
"""


@pytest.mark.end_to_end
def test_workers_end_without_a_word_when_the_study_is_terminated(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "terminated.py").write_text(TERMINATED)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "terminated.py"), str(tmp_path)],
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + 120
    while time.monotonic() < until and not (
        (tmp_path / "a").exists() and (tmp_path / "b").exists()
    ):
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (143, "")


@pytest.fixture
def cluster():
    """A scheduler with one worker that nobody starts again."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        worker_class=distributed.Worker,
        processes=False,
        dashboard_address=":0",
    ) as made:
        yield made


def leaving(cluster, comes_back: bool):
    """Takes the workers away when task a has ended, and brings one back a second later."""

    def on_step(step: Step) -> None:
        if step.name == "a":
            cluster.scale(0)
            if comes_back:
                threading.Timer(1.0, cluster.scale, (1,)).start()

    return on_step


@pytest.mark.end_to_end
@pytest.mark.parametrize("comes_back", [False, True])
def test_without_any_worker_left_a_study_says_so_and_waits_or_ends(
    tmp_path, monkeypatch, cluster, comes_back
):
    monkeypatch.setattr(engine, "_GONE_S", 60.0 if comes_back else 0.5)
    monkeypatch.setattr(engine, "_LOOK_S", 0.1)
    tasks = [Task("a", note, (tmp_path, "a")), Task("b", note, (tmp_path, "b"), ("a",))]
    with pytest.warns(UserWarning, match=r"no worker of .* is left: waiting \S+ s for another"):
        outcome = engine.run_on_cluster(
            tasks,
            leaving(cluster, comes_back),
            scheduler=cluster.scheduler_address,
            workers=1,
            shared_folder=tmp_path,
        )
    assert outcome.results == ({"a": "A", "b": "B"} if comes_back else {"a": "A"})
    if not comes_back:
        assert "has had no worker for 0.5 s; start some" in outcome.failures["b"]
