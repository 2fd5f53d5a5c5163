"""Rows of tables as loggers write them."""

import pytest

from legsim.core.errors import LegsimError
from legsim.imu.table_rows import RowsOf, read_rows


def table(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text, "utf-8")
    return path


def test_columns_are_asked_for_by_name_or_number(tmp_path):
    path = table(tmp_path, "X [s],A,X [s],A\n0,1,2,3\n4,5,6,7\n")
    found = read_rows(path, (3, 4))
    assert found.rows == ((2, ("2", "3")), (3, ("6", "7")))
    assert found.units == ("s", None)
    with pytest.raises(LegsimError, match=r"column 'A' is there twice; .*numbers of the columns"):
        read_rows(path, ("A",))


def test_a_table_without_names_is_read_by_numbers(tmp_path):
    path = table(tmp_path, "# logger\n\n0.00;1,5;-2\n0.01;1,6;-3\n")
    assert read_rows(path, (1, 2)).rows == ((3, ("0.00", "1,5")), (4, ("0.01", "1,6")))
    with pytest.raises(LegsimError, match="no line with numbers in columns 1, 4"):
        read_rows(path, (1, 4))


def test_a_line_of_units_is_no_row(tmp_path):
    path = table(tmp_path, "T\tA\tG\nms\tm/(s^2)\tdeg/s\n0\t1\t2\n10\t3\t4\n")
    found = read_rows(path, ("T", "A", "G"))
    assert found.units == ("ms", "m/s2", "deg/s")
    assert len(found.rows) == 2


def test_a_line_that_calls_the_columns_calibrated_is_no_row(tmp_path):
    path = table(tmp_path, "A\tA\nT\tA\nCAL\tCAL\nms\tm/(s^2)\n0\t1\n10\t3\n")
    found = read_rows(path, ("T", "A"))
    assert found.units == ("ms", "m/s2")
    assert found.rows == ((5, ("0", "1")), (6, ("10", "3")))


def test_other_text_below_the_names_stays_a_row(tmp_path):
    """It is refused where a number is wanted, not passed over."""
    path = table(tmp_path, "T,A\nlost,packet\n0,1\n")
    assert read_rows(path, ("T", "A")).rows[0] == (2, ("lost", "packet"))


def test_rows_that_break_off_are_named(tmp_path):
    with pytest.raises(LegsimError, match=r"line 3.* the row has 1 cells, column 2"):
        read_rows(table(tmp_path, "0,1\n1,2\n2\n"), (1, 2))


def test_a_cell_longer_than_any_number_is_refused_with_the_file(tmp_path):
    """Python's reader of CSV raises an error of its own."""
    with pytest.raises(LegsimError, match=r"a.csv .*: has no line with the column 'A'"):
        read_rows(table(tmp_path, "x" * 200_000), ("A",))
    with pytest.raises(LegsimError, match=r"a.csv \(line 3\): the row has 1 cells"):
        read_rows(table(tmp_path, "A,B\n1,2\n" + "1" * 200_000 + ",2\n"), ("A", "B"))


def test_empty_cells_between_single_blanks_are_cells(tmp_path):
    """Text parted wherever there is a blank would take the next column's number."""
    read = read_rows(table(tmp_path, "N Y A B\n1  5 6\n2 0 7 8\n"), ("A", "B"))
    assert [cells for _, cells in read.rows] == [("5", "6"), ("7", "8")]
    with pytest.raises(LegsimError, match=r"line 3.*3 cells, the header 4.* blanks hide empty"):
        read_rows(table(tmp_path, "N   Y   A   B\n1   2   5   6\n2       7   8\n"), ("A", "B"))
    with pytest.raises(LegsimError, match=r"line 2.*3 cells, the header 4"):
        read_rows(table(tmp_path, "1   2   5   6\n2       7   8\n"), (3, 1))


@pytest.mark.parametrize("mark", ["# ", "#", "% ", "// "])
def test_names_may_be_a_comment_and_other_comments_are_passed_over(tmp_path, mark):
    for between in (",", "|", " "):
        text = mark + f"T,A\n0,1\n{mark}heel strike\n1,2\n".replace(",", between)
        read = read_rows(table(tmp_path, text), ("T", "A"))
        assert [cells for _, cells in read.rows] == [("0", "1"), ("1", "2")]


def test_names_that_are_not_those_of_the_cells_are_refused(tmp_path):
    """A column of row numbers without a name moves all others by one; decimal commas do worse."""
    for text in ("T,A\n1,0,1\n2,1,2\n", "T,A\n0,01,0,5\n0,02,0,6\n"):
        with pytest.raises(LegsimError, match=r"line 2.* cells, the header 2: names and numbers"):
            read_rows(table(tmp_path, text), ("T", "A"))
    assert len(read_rows(table(tmp_path, "T,A\n0,1,\n1,2,\n"), ("T", "A")).rows) == 2


def test_a_recording_that_is_appended_is_named(tmp_path):
    with pytest.raises(LegsimError, match=r"line 4.*: the names are there again: another record"):
        read_rows(table(tmp_path, "T,A\n0,1\n1,2\nT,A\n0,1\n"), ("T", "A"))


def test_rows_whose_labels_begin_like_comments_are_rows(tmp_path):
    text = "n,T,A\n#1,0,1\n# heel strike, 2, left\n#2,1,\n#3,2,3\n#,4,5\n"
    read = read_rows(table(tmp_path, text), ("T", "A"))
    assert [cells for _, cells in read.rows] == [("0", "1"), ("1", ""), ("2", "3")]


@pytest.mark.parametrize("column", [0, -1])
def test_columns_count_from_1(tmp_path, column):
    path = table(tmp_path, "k,T,A\nx,0,1\nx,1,2\n")
    for wanted, only in ((("T", column), None), (("T", "A"), RowsOf(column, "x"))):
        with pytest.raises(LegsimError, match=f"has no column {column}; count columns from 1"):
            read_rows(path, wanted, only)


def test_a_column_that_says_whose_rows_are_and_is_not_there_is_named(tmp_path):
    path = table(tmp_path, "k,T,A\nx,0,1\nx,1,2\n")
    with pytest.raises(LegsimError, match="column 9, which says whose each row is, is empty or"):
        read_rows(path, ("T", "A"), RowsOf(9, "x"))
    with pytest.raises(LegsimError, match="no row has 'y' in column 1; give one of 'x'"):
        read_rows(path, ("T", "A"), RowsOf(1, "y"))


@pytest.mark.parametrize("mark", ["%", "#", "//", "# "])
def test_a_name_may_be_given_with_its_mark_of_a_comment(tmp_path, mark):
    path = tmp_path / "a.csv"
    path.write_text(f"{mark}time,x\n0,1\n1,2\n")
    for name in ("time", f"{mark}time"):
        assert [row for _, row in read_rows(path, [name, "x"]).rows] == [("0", "1"), ("1", "2")]


def test_names_of_other_writing_are_looked_for_in_utf_8(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes("时间,x\n0,1\n1,2\n".encode("gbk"))
    with pytest.raises(LegsimError, match="or give their numbers where it is not in UTF-8"):
        read_rows(path, ["时间", "x"])
    assert len(read_rows(path, [1, 2]).rows) == 2
