"""The viewer's window."""

import pytest

from legsim import view
from legsim.core.errors import LegsimError


def test_the_viewer_refuses_a_file_that_is_not_there(tmp_path):
    with pytest.raises(LegsimError, match="no such recording"):
        view.open_viewer(tmp_path / "recording.rrd")
    with pytest.raises(LegsimError, match="no such recording"):
        view.screenshot(tmp_path / "recording.rrd", tmp_path / "picture.png", time_s=0.0)
