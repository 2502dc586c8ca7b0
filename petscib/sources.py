"""Where options come from: whatever PETSc would cut off there in silence is refused.

PETSc takes an option's value up to the first blank.  What follows it drops, or takes for an option
of its own, in the environment and in files.  The rules here are those of the command line.
"""

import os
import re

from .errors import InputError, shortened
from .options import option_of

# Files that PETSc reads by itself, in the user's home and where the program runs.
_RC_FILES = os.path.join("~", ".petscrc"), ".petscrc", "petscrc"
_ALLOWED = "one `-name value` a line, the value without blanks"
_YAML_ALLOWED = "a value without blanks"


def check(arguments, environment=os.environ):
    """Refuse words that would be lost.  Rank 0 only: it reads the files.

    Parameters
    ----------
    arguments : list of str
        The command line without the program's name.
    environment : mapping, optional

    Raises
    ------
    InputError
    """
    words = environment.get("PETSC_OPTIONS", "").split()
    _named("PETSC_OPTIONS", lambda: reject_stray_words(words))
    reject_stray_words(arguments)
    words = [*words, *arguments]
    if "-skip_petscrc" not in words:
        for name in map(os.path.expanduser, _RC_FILES):
            if os.path.exists(name):
                _check_lines(name, _read(name, ""))
    _check_yaml("PETSC_OPTIONS_YAML", environment.get("PETSC_OPTIONS_YAML", ""))
    for option, value in zip(words, words[1:]):
        option = re.sub("^--?", "-", option.lower())
        if option == "-options_string_yaml":
            _check_yaml(option, value)
        elif option in ("-options_file", "-options_file_yaml"):
            yaml = option.endswith("yaml") or value.endswith((".yml", ".yaml"))
            (_check_yaml if yaml else _check_lines)(value, _read(value, f"{option} "))


def reject_stray_words(arguments):
    """Refuse words that PETSc would silently drop: values cut by blanks, and words on their own.

    Parameters
    ----------
    arguments : list of str
        The command line without the program's name.

    Raises
    ------
    InputError
    """
    words = []  # the option at hand and the values after it
    for word in arguments:
        words = [word] if re.match(r"--?[A-Za-z]", word) else [*words, word]
        name = words[0].lstrip("-").lower()
        option = option_of(name)
        ours = option is not None
        if len(words) > 2 or not words[0].startswith("-") or (ours and len(word.split()) > 1):
            allowed = option.kind.allowed if ours else "-name value"
            why = ("one value without blanks may follow an option" if words[0].startswith("-")
                   else "neither an option nor the value of one")
            raise InputError(f"{shortened(' '.join(words))}: {why}; allowed: {allowed}")


def _named(source, action):
    try:
        action()
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _read(path, option):
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read()
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "not a text file"
        raise InputError(f"{option}{path}: {why}; allowed: a text file of options") from None
    if not all(letter.isprintable() or letter.isspace() for letter in text):
        raise InputError(f"{option}{path}: not a text file; allowed: a text file of options")
    return text


def _check_lines(path, text):
    """Refuse lines of an options file that are more, or other, than an option and its value."""
    for number, line in enumerate(text.replace("\\\n", "  ").splitlines(), 1):
        words = re.split(r"(?:^|\s)[#!]", line)[0].split()
        if words[:1] == ["alias"]:
            continue
        if len(words) > 2 or words and not words[0].startswith("-"):
            raise InputError(f"{path}, line {number}: {' '.join(words)}; allowed: {_ALLOWED}")


def _check_yaml(path, text):
    """Refuse values with blanks in YAML."""
    for number, line in enumerate(text.splitlines(), 1):
        line = re.sub(r"(^|\s)#.*", "", line).strip()
        value = re.sub(r"^(-\s+)?([^\s:]+\s*:(\s+|$))?", "", line)
        if value[:1] in tuple("[{&*!|>"):
            continue  # a list, for one: PETSc puts commas between its entries
        if len(value.strip("\"'").split()) > 1:
            raise InputError(f"{path}, line {number}: {line}; allowed: {_YAML_ALLOWED}")
