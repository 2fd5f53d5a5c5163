"""The peak rises with what is held, and falls when it is forgotten."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core import memory

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="no /proc/self/clear_refs on this system"
)


def test_the_peak_holds_what_was_freed_until_it_begins_anew():
    memory.begin_peak()
    before = memory.peak_mebibytes()
    held = np.ones(64 * 2**20 // 8)
    del held
    peak = memory.peak_mebibytes()
    memory.begin_peak()
    after = memory.peak_mebibytes()
    assert before is not None
    assert peak is not None
    assert after is not None
    assert peak - before == pytest.approx(64, abs=8)
    assert after < peak - 32


def test_a_system_that_does_not_tell_gives_none(monkeypatch):
    monkeypatch.setattr(memory, "_PROCESS", Path("/nowhere"))
    monkeypatch.setattr(memory, "_SYSTEM", Path("/nowhere"))
    memory.begin_peak()
    assert memory.peak_mebibytes() is None
    assert memory.available() is None


def test_available_memory_is_part_of_the_machines():
    found = memory.available()
    assert found is not None
    assert 2**20 < found < 2**50
