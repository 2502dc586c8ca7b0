"""Lists of vesicles in text files, a line each: words such as axes=0.1,0.3 center=0.2,0.

A word is an option of one vesicle and its value, without blanks; what a line leaves out is the
common value.  Empty lines, and what follows a #, do not count.
"""

from . import options
from .agreement import on_root
from .errors import InputError, shortened
from .vesicles import OWN

ALLOWED = "a text file with a line for each vesicle, of words name=value for " + ", ".join(OWN)


def expand(database, comm):
    """The options of a run, with those that -vesicle_file gives each vesicle.  Collective.

    What the user gives one vesicle wins over its line.  A restart knows the lines already.

    Parameters
    ----------
    database : dict of str to str or None
        PETSc's option database, in which `restart.merge` has had its say.
    comm : mpi4py communicator

    Returns
    -------
    dict
        In the same form.

    Raises
    ------
    InputError
        On all ranks: the file cannot be read, or is no such list.
    """
    now = {name.lower(): text for name, text in database.items()}
    path = now.get("vesicle_file")
    if not path or now.get("restart"):
        return database
    lines = on_root(comm, lambda: _read(path))
    count = str(len(lines))
    if now.get("vesicles", count) != count:
        raise InputError(f"-vesicles {now['vesicles']}: -vesicle_file {path} lists {count}; "
                         "allowed: their number, or no -vesicles")
    listed = {f"vesicle_{k}_{name}": text for k, words in enumerate(lines)
              for name, text in words.items()}
    return {**listed, "vesicles": count, **database}


def _read(path):
    """The words of each line, names to texts.  Rank 0 only."""
    try:
        with open(path, encoding="utf-8") as file:
            lines = file.read().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputError(f"-vesicle_file {path}: {why}; allowed: {ALLOWED}") from None
    vesicles = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if words:
            vesicles.append(dict(_word(path, number, word) for word in words))
    if not vesicles:
        raise InputError(f"-vesicle_file {path}: lists no vesicle; allowed: {ALLOWED}")
    return vesicles


def _word(path, number, word):
    name, equals, text = word.partition("=")
    name = name.lower()
    where = f"-vesicle_file {path}: line {number}: "
    if not equals and name in OWN:
        raise InputError(f"{where}{word}: needs a value; allowed: {word}=value, without blanks")
    if not equals or name not in OWN:
        near = options.nearest(name, OWN)
        raise InputError(f"{where}{shortened(word)}: not a value of a vesicle; allowed: {ALLOWED}"
                         + (f"; nearest: {near}" if near else ""))
    try:
        options.value_of(options.TABLE[name], text)
    except InputError as error:
        raise InputError(where + str(error)) from None
    return name, text
