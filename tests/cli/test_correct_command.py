"""`legsim correct` on the command line."""

import pytest

from legsim.cli import main
from tests.examples import measured


def test_a_scan_is_corrected_from_its_toml(tmp_path, capsys):
    path = measured.write(tmp_path / "scan")
    with pytest.raises(SystemExit) as ended:
        main.main(["correct", str(path), "--method", "rigid", "--out", str(tmp_path / "out")])
    said = capsys.readouterr()
    assert ended.value.code == 0, said.err
    assert "rigid" in said.out
    assert f"report: {tmp_path / 'out/report.html'}" in said.out
    assert (tmp_path / "out/volume-rigid.mha").is_file()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], "which method? give --method NAME"),
        (["--method", "oracle"], "only a simulated scan has"),
        (["--method", "rigid", "--view-rate-hz", "3"], "--view-rate-hz is beside it"),
    ],
)
def test_a_mistake_is_one_line(tmp_path, capsys, more, said):
    path = measured.write(tmp_path / "scan")
    with pytest.raises(SystemExit) as ended:
        main.main(["correct", str(path), *more, "--out", str(tmp_path / "out")])
    assert ended.value.code == 1
    errors = capsys.readouterr().err
    assert said in errors
    assert not (tmp_path / "out").exists()
