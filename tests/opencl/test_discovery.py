from legsim.opencl import discovery


def test_some_device_works_and_the_fastest_comes_first():
    seconds = [c.seconds for c in discovery.candidates() if c.seconds is not None]
    assert seconds
    assert seconds == sorted(seconds)
