"""Every form has the page's cells; special signs survive in each."""

import csv
import io
import re
import shutil
import subprocess

import pytest

from legsim.report import formats
from legsim.report.page import FileNote, PageSection, Picture, ReportContent, Table

TABLE = Table(
    "SSIM & more_",
    ("method", "leg", "note"),
    (
        ("30 % squats",),
        ("a|b", "0.988 ± 0.004", "−0.005"),
        ("c", "–", "[x] <y>"),
        ("all",),
        ("d, e", "0.9 ± 0.1", 'say "no"'),
    ),
    "n − 1",
    "ssim",
    ("", "runs/a b", "", "", ""),
)


def rows_of(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text)))


def test_csv_is_tidy():
    assert rows_of(formats.csv_table(TABLE)) == [
        ["group", "method", "leg", "leg sd", "note"],
        ["30 % squats", "a|b", "0.988", "0.004", "-0.005"],
        ["30 % squats", "c", "", "", "[x] <y>"],
        ["all", "d, e", "0.9", "0.1", 'say "no"'],
    ]


def test_csv_of_a_plain_table_has_no_groups():
    plain = Table("t", ("a", "b"), (("x", "1"),))
    assert rows_of(formats.csv_table(plain)) == [["a", "b"], ["x", "1"]]


@pytest.fixture
def study(written_study):
    return written_study.content


def test_columns_of_numbers_read_as_numbers(study):
    """What stands right in the page is a number, or nothing, in the CSV."""
    tables = {table.name: table for section in study.sections for table in section.tables}
    for name in ("ssim", "rmse", "residuals_mm", "ladder_SI", "noisy_ssim"):
        header, *rows = rows_of(formats.csv_table(tables[name]))
        for row in rows:
            assert len(row) == len(header)
            for cell in row[2:]:
                assert cell == "" or float(cell) is not None


def cells_of_markdown(line: str) -> list[str]:
    found = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
    unlinked = [re.sub(r"^\[(.*)\]\(.*\)$", r"\1", cell) for cell in found]
    return [re.sub(r"\\(.)", r"\1", cell) for cell in unlinked]


def test_markdown_has_every_cell(study):
    for table in (TABLE, *(table for section in study.sections for table in section.tables)):
        header, rule, *lines = formats.markdown_table(table).splitlines()
        assert cells_of_markdown(header) == list(table.columns)
        assert set(cells_of_markdown(rule)) <= {"---", "---:"}
        for line, row in zip(lines, table.rows, strict=True):
            if len(row) == 1:
                assert cells_of_markdown(line) == [
                    f"**{row[0]}**",
                    *[""] * (len(table.columns) - 1),
                ]
            else:
                assert cells_of_markdown(line) == list(row)


def test_markdown_links_rows_pictures_and_files():
    picture = Picture("A *caption*", b"", "words", "pictures/a b.png")
    text = formats.markdown(
        ReportContent(
            "T",
            ("most",),
            (PageSection("S", ("line",), (TABLE,), (picture,)),),
            (("device", "cpu"),),
            (FileNote("a.csv", "rows"),),
            ("w",),
        )
    )
    for expected in (
        "# T",
        "- most",
        "- w",
        "## S",
        "![words](pictures/a%20b.png)",
        r"A \*caption\*",
        "[a\\|b](runs/a%20b)",
        "- [a.csv](a.csv): rows",
    ):
        assert expected in text
    assert "- device: cpu" in text


def test_latex_escapes_what_it_would_read():
    text = formats.latex_table(
        Table(
            "50 % & a_b",
            ("{x}", "#"),
            (("$1", "~^\\"), ("a ± b", "−1 ≤ 2°"), ("[z]", "–")),
            name="t",
        )
    )
    assert r"\caption{50 \% \& a\_b}" in text
    assert r"\{x\} & \# \\" in text
    assert r"\$1 & \textasciitilde{}\textasciicircum{}\textbackslash{} \\" in text
    assert r"a $\pm$ b & $-$1 $\leq$ 2$^\circ$ \\" in text
    assert "{[z]} & --" in text
    assert r"\label{tab:t}" in text


def test_latex_is_ascii_and_balanced(study):
    text = formats.latex(table for section in study.sections for table in section.tables)
    assert text.isascii()
    assert (
        text.count(r"\begin{tabular}")
        == text.count(r"\end{tabular}")
        == sum(len(section.tables) for section in study.sections)
    )
    for row in re.findall(r"^(?!\\).* \\\\$", text, re.M):
        assert row.count("$") % 2 == 0


def test_latex_compiles_without_packages(study, tmp_path):
    pdflatex = shutil.which("pdflatex")
    if pdflatex is None:
        pytest.skip("no pdflatex on this machine")
    tables = formats.latex(
        [TABLE, *(table for section in study.sections for table in section.tables)]
    )
    (tmp_path / "t.tex").write_text(
        "\\documentclass{article}\\begin{document}\n" + tables + "\\end{document}\n"
    )
    made = subprocess.run(
        [pdflatex, "-interaction=nonstopmode", "-halt-on-error", "t.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert made.returncode == 0, made.stdout[-2000:]
