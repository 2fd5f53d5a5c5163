from legsim.core import errors


def test_the_line_names_file_place_problem_and_cure():
    assert (
        str(errors.file_error("a.trc", "no number", "mend it", place="line 3"))
        == "a.trc (line 3): no number; mend it"
    )
    assert str(errors.file_error("a.trc", "no number", "mend it")) == "a.trc: no number; mend it"
