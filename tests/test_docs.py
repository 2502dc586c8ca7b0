"""README and the pages of docs must stay true: tables, commands, links and files.

The table of options is `python -c "from petscib import help; print(help.markdown_table())"`.
"""

import importlib
import importlib.util
import re
import shlex
from pathlib import Path

import pytest

from petscib import diagnostics, help, options, scenes
from petscib.schemes import SCHEMES
from petscib.studies.__main__ import STUDIES

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = {path: path.read_text() for path in (ROOT / "README.md", *sorted(DOCS.glob("*.md")))}
TEXT = "\n".join(PAGES.values())
BLOCKS = re.findall(r"```sh\n(.*?)```", TEXT, re.S)
COMMANDS = sorted({line.split("#")[0].strip() for block in BLOCKS for line in block.splitlines()})
LINKS = sorted({
    (path, link) for path, text in PAGES.items()
    for link in re.findall(r"\]\(([^)\s]+)\)", text) if not link.startswith("http")})
FILES = sorted(set(re.findall(r"`((?:petscib|tests|examples|docs)/[a-z0-9_./-]+)`", TEXT)))


def page(name):
    return PAGES[DOCS / f"{name}.md"]


def test_readme_is_short():
    assert len(PAGES[ROOT / "README.md"].splitlines()) <= 150


def test_the_options_table_is_the_programs():
    _, table = page("options").split("markdown_table -->\n")
    assert table.split("<!-- end of options")[0].strip() == help.markdown_table().strip()


@pytest.mark.parametrize("command", [c for c in COMMANDS if re.match("([A-Z]+=.* )*./run -", c)])
def test_runs_have_valid_options(command):
    words = shlex.split(command[command.index("./run") :])[1:]
    database, name = {}, None
    for word in words:
        if re.match("-[a-z]", word):
            name, database[word[1:]] = word[1:], ""
        else:
            database[name] = word
    for file_of_the_users in ("restart", "vesicle_file", "options_file"):
        database.pop(file_of_the_users, None)
    if help.information(database) is None:
        options.read(database)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("make ")])
def test_make_targets_exist(command):
    assert f"\n{command.split()[1]}:" in (ROOT / "Makefile").read_text()


@pytest.mark.parametrize("name", sorted(set(
    re.findall(r"python -m (petscib[a-z.]*[a-z])\b", TEXT))))
def test_modules_exist(name):
    assert importlib.util.find_spec(name) is not None


@pytest.mark.parametrize("path, link", LINKS)
def test_links_lead_somewhere(path, link):
    target, _, heading = link.partition("#")
    target = (path.parent / target) if target else path
    assert target.exists()
    if heading:
        headings = re.findall(r"^#+ (.*)$", target.read_text(), re.M)
        names = [re.sub(r"[^\w -]", "", one.lower()).replace(" ", "-") for one in headings]
        assert heading in names


@pytest.mark.parametrize("name", FILES)
def test_files_exist(name):
    assert (ROOT / name).exists()


@pytest.mark.parametrize("name", sorted(set(re.findall(r"-scene ([a-z][a-z-]*)\b(?!\.)", TEXT))))
def test_scenes_exist(name):
    assert name in (*scenes.SCENES, "list")


def test_every_scheme_is_in_the_table_of_schemes():
    table = page("choosing")[: page("choosing").index("## Which scheme")]
    for name in SCHEMES:
        assert f"`{name}`" in table


def test_every_column_is_explained():
    for name in diagnostics.columns(1):
        assert f"`{name}`" in page("files")


def test_every_study_is_in_the_table_of_studies():
    for name in (*STUDIES, "bench"):
        assert f"| `{name}` |" in page("studies")


def test_every_scene_is_in_the_gallery():
    for name in scenes.SCENES:
        assert f"## {name}\n" in page("gallery") and f"(gallery/{name}.png)" in page("gallery")


def test_every_page_is_in_readme():
    for path in DOCS.glob("*.md"):
        assert f"(docs/{path.name})" in PAGES[ROOT / "README.md"]


def test_debians_packages_are_those_that_are_installed():
    setup = (ROOT / ".ci" / "setup").read_text()
    names = re.search('debian_packages="([^"]*)"', setup)[1].split()
    text = page("install")
    assert sorted(re.search("apt-get install (.*)", text)[1].split()) == sorted(names)
