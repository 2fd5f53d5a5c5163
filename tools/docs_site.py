"""Hooks of the documentation's site: pages from outside docs/, their links, the reference.

mkdocs calls them (mkdocs.yml). Links in the pages are those that work in the checkout, relative to
the page's own file; here each becomes the link between the same two pages on the site.
"""

import ast
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

ROOT = Path(__file__).parents[1]
FACE = ROOT / "legsim"
HOME = "README.md"
PAGES = (HOME, "CONTRIBUTING.md", "CHANGELOG.md", "tools/README.md", "motions/README.md")
"""Pages outside docs/, beside models/*/README.md"""

_LINK = re.compile(r"\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?![a-z]+:|#)([^)\s]+)\)")
_PAGE = re.compile(r"[\w/]+\.md")
_ROLE = re.compile(r":(?:func|class|mod|meth|attr|data):(?=<code>)")
_FENCE = re.compile(r"^```.*?^```$", re.M | re.S)


def on_config(config: Any) -> Any:
    """Enters the pages of the reference into the navigation."""
    for section in config.nav:
        if section.get("Reference") == "api/":
            section["Reference"] = ["api/index.md", *(f"api/{name}.md" for name in packages())]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages from outside docs/, the reference, and a list for each folder of results."""
    from mkdocs.structure.files import File  # pyright: ignore[reportMissingImports]

    for path in outside():
        text = (ROOT / path).read_text("utf-8")
        files.append(File.generated(config, site_path(path), content=text))
    files.append(File.generated(config, "LICENSE.txt", content=(ROOT / "LICENSE").read_text()))
    files.append(File.generated(config, "api/index.md", content=face_page()))
    for name in packages():
        files.append(File.generated(config, f"api/{name}.md", content=package_page(name)))
    for folder in folders():
        page = File.generated(config, f"{folder}/index.md", content=folder_page(folder))
        page.inclusion = page.inclusion.NOT_IN_NAV
        files.append(page)
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turns the links of a page that lies in the checkout."""
    path = checkout_path(page.file.src_uri)
    return markdown if path is None else turned(markdown, path)


def on_page_content(html: str, **_: Any) -> str:
    """Drops the roles that docstrings give to the names of code."""
    return _ROLE.sub("", html)


def outside() -> tuple[str, ...]:
    """Pages outside docs/, as paths in the checkout."""
    models = sorted(p.relative_to(ROOT).as_posix() for p in ROOT.glob("models/*/README.md"))
    return (*PAGES, *models)


def site_path(path: str) -> str:
    """Where the site has a file or folder of the checkout, as a source path of mkdocs.

    Raises:
        ValueError: the site does not have it.
    """
    parts = PurePosixPath(path).parts
    if path == HOME:
        return "index.md"
    if path == "LICENSE":
        return "LICENSE.txt"
    if path in outside():
        return path
    if parts[0] == "docs":
        inside = posixpath.join(*parts[1:])
        return f"{inside}/index.md" if (ROOT / path).is_dir() else inside
    if parts[0] == "legsim" and len(parts) == 2 and parts[1] in packages():
        return f"api/{parts[1]}.md"
    raise ValueError(f"{path}: the site has no page of it")


def checkout_path(uri: str) -> str | None:
    """The file of the checkout behind a source path of mkdocs; None: a page written here."""
    if uri == "index.md":
        return HOME
    if uri in outside():
        return uri
    return f"docs/{uri}" if (ROOT / "docs" / uri).is_file() else None


def turned(markdown: str, path: str) -> str:
    """A page's text with the links that the site needs; examples in fences stay as they are.

    Raises:
        ValueError: a link leads to what the site does not have.
    """
    here = posixpath.dirname(site_path(path))

    def turn(found: re.Match[str]) -> str:
        text, link = found.groups()
        target, hash_sign, section = link.partition("#")
        there = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
        to = posixpath.relpath(site_path(there), here or ".") + hash_sign + section
        return f"[{title(there) if _PAGE.fullmatch(text) else text}]({to})"

    done, at = [], 0
    for fence in _FENCE.finditer(markdown):
        done += [_LINK.sub(turn, markdown[at : fence.start()]), fence.group()]
        at = fence.end()
    return "".join([*done, _LINK.sub(turn, markdown[at:])])


def title(path: str) -> str:
    """The first heading of a page: on the site it says more than the file's name."""
    return (ROOT / path).read_text("utf-8").partition("\n")[0].lstrip("# ")


def packages() -> tuple[str, ...]:
    """Packages with public names, from the bottom up of docs/design.md."""
    table = (ROOT / "docs/design.md").read_text("utf-8")
    order = re.findall(r"^\| `(\w+)` \|", table, re.M)
    return tuple(name for name in order if (FACE / name / "__init__.pyi").is_file())


def names(stub: Path) -> Iterator[tuple[str, str]]:
    """(name, module that it comes from, relative to the stub) of a stub's public names."""
    for node in ast.parse(stub.read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            yield from ((one.asname or one.name, node.module or "") for one in node.names)


def public(package: str) -> dict[str, str]:
    """Full path of each public name of a package, those that `legsim` alone has included; names of
    other libraries are left to their own documentation.
    """
    own = {
        name: f"legsim.{package}.{module}.{name}"
        for name, module in names(FACE / package / "__init__.pyi")
        if not foreign(FACE / package / f"{module}.py", name)
    }
    further = {
        name: f"legsim.{module}.{name}"
        for name, module in names(FACE / "__init__.pyi")
        if module.split(".")[0] == package and name not in own
    }
    return own | further


def foreign(source: Path, name: str) -> bool:
    """Whether a module has a name from another library."""
    return any(
        isinstance(node, ast.ImportFrom)
        and not (node.module or "").startswith("legsim")
        and name in (one.asname or one.name for one in node.names)
        for node in ast.parse(source.read_text("utf-8")).body
    )


def package_page(package: str) -> str:
    """The reference of one package: its docstring, then each public name."""
    docstring = ast.get_docstring(ast.parse((FACE / package / "__init__.py").read_text("utf-8")))
    parts = [f"# legsim.{package}", docstring or ""]
    parts += [f"::: {path}" for path in public(package).values()]
    return "\n\n".join(parts) + "\n"


def face_page() -> str:
    """The names of `legsim` itself by package, each with the page that describes it."""
    where = {name: module.split(".")[0] for name, module in names(FACE / "__init__.pyi")}
    docstring = ast.get_docstring(ast.parse((FACE / "__init__.py").read_text("utf-8"))) or ""
    summary, _, example = docstring.partition("\n\n")
    parts = ["# Reference", summary, f"```pycon\n{example}\n```"]
    parts += ["Names of `legsim` itself, here with the package that holds each:"]
    rows = ["| package | names |", "|---|---|"]
    for package in packages():
        own = [f"[`{n}`][{public(package)[n]}]" for n in where if where[n] == package]
        if own:
            rows.append(f"| [{package}]({package}.md) | {', '.join(own)} |")
    return "\n\n".join([*parts, "\n".join(rows)]) + "\n"


def folders() -> list[str]:
    """Folders of results, relative to docs/: pages link to them as a whole."""
    found = [p for p in (ROOT / "docs/results").rglob("*") if p.is_dir()]
    return sorted(p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs/results", *found))


def folder_page(folder: str) -> str:
    """A list of what lies in a folder of docs/."""
    rows = [f"# {folder}"]
    for path in sorted((ROOT / "docs" / folder).iterdir()):
        target = f"{path.name}/index.md" if path.is_dir() else path.name
        rows.append(f"- [{path.name}]({target})")
    return f"{rows[0]}\n\n" + "\n".join(rows[1:]) + "\n"
