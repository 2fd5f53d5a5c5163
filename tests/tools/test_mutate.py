"""Mutants differ from their module in one place, and tests notice what they are for."""

import ast
import subprocess
import sys
from types import SimpleNamespace

import pytest

from tools import mutate

SOURCE = '''
def f(x: int = 3) -> float:
    """Text."""
    if x < 2 and x != 0:
        raise ValueError(f"{x + 1} is wrong")
    return x * 0.5 if x is None else -x
'''


def test_every_site_is_changed_once_and_texts_stay(monkeypatch, tmp_path):
    path = tmp_path / "m.py"
    path.write_text(SOURCE)
    monkeypatch.setattr(mutate, "source_of", lambda _: path)
    made = [mutate.mutant("m", k) for k in range(len(list(mutate.sites(ast.parse(SOURCE)))))]
    plain = ast.unparse(ast.parse(SOURCE))
    assert len({text for _, text in made}) == len(made)
    assert plain not in {text for _, text in made}
    assert all("x + 1} is wrong" in text and '"""Text."""' in text for _, text in made)
    changes = {place.partition(": ")[2] for place, _ in made}
    assert {"Lt to LtE", "NotEq to Eq", "And to Or", "Mult to Div", "0.5 to 1.5"} <= changes


@pytest.mark.end_to_end
def test_the_modules_tests_notice_a_fault_and_pass_without_one(tmp_path):
    """In a process of its own: where legsim is loaded already, no mutant takes its place."""
    name = "legsim.core.errors"
    source = mutate.source_of(name).read_text("utf-8")
    faulty = source.replace("c.isprintable()", "not c.isprintable()")
    assert faulty != source
    tried = f"""
from pathlib import Path
from tools.mutate import tested
print([tested({name!r}, text, Path({str(tmp_path)!r}), False) for text in {[source, faulty]!r}])
"""
    ended = subprocess.run(
        [sys.executable, "-c", tried], capture_output=True, text=True, check=True
    )
    assert ended.stdout.strip() == "['survived', 'killed']"


def test_each_package_has_its_own_draw_and_every_module_its_tests():
    packages = ("core", "evaluation")
    draws = [mutate.drawn(package, 1) for package in packages]
    assert all(
        mutate.drawn(package, 1) == draw for package, draw in zip(packages, draws, strict=True)
    )
    assert mutate.drawn("core", 2) != draws[0]
    assert mutate.tests_of("legsim.core.values").name == "test_values.py"
    assert mutate.tests_of("legsim.geometry._file_parts").name == "geometry"


def test_tests_run_in_the_order_of_their_seconds(tmp_path):
    (tmp_path / "seconds").write_text('{"slow": 2.0, "quick": 0.1}')
    items = [SimpleNamespace(nodeid=name) for name in ("slow", "new", "quick")]
    mutate.FastFirst(tmp_path / "seconds").pytest_collection_modifyitems(items)
    assert [item.nodeid for item in items] == ["new", "quick", "slow"]
