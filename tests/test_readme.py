"""README must stay true: its options table, its commands and its files.

The table is `python -c "from petscib import options; print(options.markdown_table())"`.
"""

import importlib.util
import re
import shlex
from pathlib import Path

import pytest

from petscib import options, scenes
from petscib.schemes import SCHEMES

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```sh\n(.*?)```", TEXT, re.S)
COMMANDS = [line.split("#")[0].strip() for block in BLOCKS for line in block.splitlines()]


def test_the_options_table_is_the_programs():
    _, table = TEXT.split("markdown_table -->\n")
    assert table.split("<!-- end of options")[0].strip() == options.markdown_table().strip()


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("./run -")])
def test_its_runs_have_valid_options(command):
    words = shlex.split(command)[1:]
    database, name = {}, None
    for word in words:
        if re.match("-[a-z]", word):
            name, database[word[1:]] = word[1:], ""
        else:
            database[name] = word
    database.pop("restart", None)  # that file is not there yet
    if options.information(database) is None:
        options.read(database)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("make ")])
def test_its_make_targets_exist(command):
    assert f"\n{command.split()[1]}:" in (ROOT / "Makefile").read_text()


@pytest.mark.parametrize("name", re.findall(r"python -m (petscib[a-z.]*[a-z])\b", TEXT))
def test_its_modules_exist(name):
    assert importlib.util.find_spec(name) is not None


def test_every_scheme_is_in_the_table_of_schemes():
    table = TEXT[TEXT.index("## Schemes") : TEXT.index("## Solvers")]
    for name in SCHEMES:
        assert f"`{name}`" in table


@pytest.mark.parametrize("name", re.findall(r"-scene ([a-z]+)", TEXT))
def test_its_scenes_exist(name):
    assert name in (*scenes.SCENES, "list")


@pytest.mark.parametrize("path", re.findall(r"\]\((docs/[^)]+)\)", TEXT))
def test_its_pictures_exist(path):
    assert (ROOT / path).exists()


def test_debians_packages_are_those_that_are_installed():
    setup = (ROOT / ".ci" / "setup").read_text()
    names = re.search('debian_packages="([^"]*)"', setup)[1].split()
    text = (ROOT / "docs" / "install.md").read_text()
    assert sorted(re.search("apt-get install (.*)", text)[1].split()) == sorted(names)
