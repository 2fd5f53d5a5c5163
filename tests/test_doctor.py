import dataclasses

from legsim import doctor, opencl


def test_it_looks_at_devices_memory_disk_and_viewer(tmp_path):
    findings = doctor.examine(tmp_path / "not" / "there" / "yet")
    topics = {f.topic.split(" ")[0] for f in findings}
    assert {"python", "package", "opencl", "memory", "disk", "models", "rerun"} <= topics
    assert all(f.cure for f in findings if not f.good)


def test_a_device_that_fails_the_probe_is_told_with_its_reason(tmp_path, monkeypatch):
    broken = dataclasses.replace(opencl.candidates()[0], seconds=None, failure="unknown target CPU")
    monkeypatch.setattr(opencl, "candidates", lambda: (broken,))
    found = [f for f in doctor.examine(tmp_path) if f.topic.startswith("opencl")]
    assert not any(f.good for f in found)
    assert any("unknown target CPU" in f.detail for f in found)
    assert any("pip install" in f.cure for f in found)
