"""What is printed stays whole: brackets in paths, cells of wide tables."""

from legsim.cli import console


def test_lines_keep_brackets_that_look_like_markup(capsys):
    console.print_lines(["volume: scan [2]/volume.mha"])
    assert capsys.readouterr().out == "volume: scan [2]/volume.mha\n"


def test_a_table_wider_than_the_terminal_keeps_every_cell(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    columns = tuple(f"column {k} of a table" for k in range(9))
    console.print_table("Title", columns, [tuple(f"cell {k}" for k in range(9))])
    printed = capsys.readouterr().out
    assert all(f"column {k} of a table" in printed for k in range(9))
    assert all(f"cell {k}" in printed for k in range(9))
