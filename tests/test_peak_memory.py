"""The peak rises with what is held, and falls when it is forgotten."""

from pathlib import Path

import numpy as np
import pytest

from legsim import peak_memory

pytestmark = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="no /proc/self/clear_refs on this system")


def test_the_peak_holds_what_was_freed_until_it_begins_anew():
    peak_memory.begin()
    before = peak_memory.mebibytes()
    held = np.ones(64 * 2**20 // 8)
    del held
    peak = peak_memory.mebibytes()
    peak_memory.begin()
    after = peak_memory.mebibytes()
    assert before is not None
    assert peak is not None
    assert after is not None
    assert peak - before == pytest.approx(64, abs=8)
    assert after < peak - 32


def test_a_system_that_does_not_tell_gives_none(monkeypatch):
    monkeypatch.setattr(peak_memory, "_PROCESS", Path("/nowhere"))
    peak_memory.begin()
    assert peak_memory.mebibytes() is None
