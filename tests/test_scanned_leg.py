from pathlib import Path

from legsim import opencl
from legsim.artifacts import RunFolder
from legsim.config import RunConfig
from legsim.scanned_leg import Stage


def test_a_stage_knows_where_it_works(tmp_path: Path):
    stage = Stage(RunConfig(), RunFolder(tmp_path, {}), opencl.open_device(), "key", lambda *_: None)
    assert stage.folder.path == tmp_path
    assert stage.settings.seed == 0
