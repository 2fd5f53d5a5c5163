"""The peak rises with what is held, and falls when it is forgotten."""

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from legsim.core import memory

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="no /proc/self/clear_refs on this system"
)


MEASURING = """
import numpy as np
from legsim.core import memory
memory.begin_peak()
before = memory.peak_mebibytes()
held = np.ones(64 * 2**20 // 8)
del held
peak = memory.peak_mebibytes()
memory.begin_peak()
print(before, peak, memory.peak_mebibytes())
"""
"""a process of its own: threads of other tests free memory while this one measures"""


def test_the_peak_holds_what_was_freed_until_it_begins_anew():
    command = [sys.executable, "-c", MEASURING]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    before, peak, after = (float(word) for word in printed.split())
    assert peak - before == pytest.approx(64, abs=8)
    assert after < peak - 32


def test_the_peak_begins_at_what_is_held():
    memory.begin_peak()
    assert memory.peak_mebibytes() == pytest.approx(memory.resident_mebibytes(), rel=0.2)


THREADS = """
import threading
from legsim.core import memory

def churn(ended):
    held = [b"x" * (100_000 + k) for k in range(300)]
    del held
    ended.set()
    stay.wait()

stay = threading.Event()
def fill():
    ended = threading.Event()
    threading.Thread(target=churn, args=(ended,), daemon=True).start()
    ended.wait()

bytes(30 << 20)  # from here on malloc keeps freed blocks of up to 30 MiB for itself
memory.give_back()
before = memory.resident_mebibytes()
for _ in range(6):
    fill()
memory.give_back()
print(memory.resident_mebibytes() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc alone has such heaps")
def test_what_threads_have_freed_is_given_back():
    """Each uses 29 MiB in blocks for which malloc does not ask the system one by one."""
    command = [sys.executable, "-c", THREADS]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert float(printed) < 15


def test_a_system_that_does_not_tell_gives_none(monkeypatch):
    monkeypatch.setattr(memory, "_PROCESS", Path("/nowhere"))
    monkeypatch.setattr(memory, "_SYSTEM", Path("/nowhere"))
    memory.begin_peak()
    assert memory.peak_mebibytes() is None
    assert memory.resident_mebibytes() is None
    assert memory.available() is None


def test_available_memory_is_part_of_the_machines():
    found = memory.available()
    assert found is not None
    assert 2**20 < found < 2**50


def test_sizes_are_in_the_unit_that_fits():
    assert memory.in_words(3 * 2**20) == "3.0 MiB"
    assert memory.in_words(1.5 * 2**30) == "1.5 GiB"
