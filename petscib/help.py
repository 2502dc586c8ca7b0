"""The texts of ``-help``, and the table of docs/options.md, made from the table of options."""

import textwrap

from . import scenes
from .errors import InputError, shortened
from .option_kinds import Flag, Path
from .options import GROUPS, MEMBRANE, SHAPE, TABLE, nearest, option_of
from .petsc_options import SOLVERS
from .vesicles import OWN

_TOPICS = dict(zip(("run", "fluid", "shape", "membrane", "time", "results"), GROUPS))
_HEAD = ("petscib: vesicles in viscous flow by energy stable immersed boundary methods.",
         "Usage: [mpiexec -n RANKS] python -m petscib [-option value ...]")


def help_asked(arguments):
    """What -help of a command line asks for, None without one, and the rest of the words."""
    words, topic = list(arguments), None
    for place, word in enumerate(words):
        if word.lower() in ("-help", "--help", "-h"):
            after = words[place + 1 : place + 2]
            count = 2 if after and not after[0].startswith("-") else 1
            topic = after[0].lower() if count == 2 else ""
            del words[place : place + count]
            break
    return topic, words


def information(database):
    """The text that ``-help`` or ``-scene list`` asks for, or None when neither is given."""
    asked = {name.lstrip("-").lower(): (text or "").lower() for name, text in database.items()}
    if "help" in asked:
        return help_text(asked["help"])
    return scenes.listing() if asked.get("scene") == "list" else None


def help_text(topic=""):
    """The text of ``-help``, at most 100 columns.

    Parameters
    ----------
    topic : str
        Empty for a screen that names all options; a group, ``solvers``, the name of an option, or
        ``all``.

    Raises
    ------
    InputError
        There is no such topic.
    """
    topic = topic.lstrip("-")
    if not topic:
        return _overview()
    if topic in _TOPICS:
        lines = _group(_TOPICS[topic])
    elif topic == "solvers":
        lines = _solvers()
    elif topic == "all":
        lines = [*_HEAD, *_notes()]
        for group in GROUPS:
            lines += ["", *_group(group)]
        lines += ["", *_solvers(), "", *_of_petsc()]
    elif option_of(topic) is not None:
        lines = _option_entry(option_of(topic))
    else:
        topics = (*_TOPICS, "solvers", "petsc", "all")
        near = nearest(topic, (*topics, *TABLE))
        raise InputError(f"-help {shortened(topic)}: no such topic; allowed: "
                         f"{', '.join(topics)}, or an option's name"
                         + (f"; nearest: {near}" if near else ""))
    return "\n".join(lines) + "\n"


def _overview():
    """The screen of ``-help`` alone."""
    lines = [*_HEAD, "", "Scenes are sets of defaults: " + textwrap.fill(
        ", ".join(scenes.SCENES) + ".", 100, initial_indent=" " * 29,
        subsequent_indent="  ").strip(), "", "Options by group (-help GROUP explains them)"]
    for topic, group in _TOPICS.items():
        names = " ".join(f"-{option.name}" for option in TABLE.values() if option.group == group)
        lines += _entry(topic, names, column=12)
    lines += _entry("solvers", " ".join(f"-{prefix}*" for prefix, _ in SOLVERS), column=12)
    lines += ["", "More"]
    for name, text in (
            ("-scene list", "every scene with its options"),
            ("-help sigma0", "one option"),
            ("-help all", "everything about every option"),
            ("-help petsc", "PETSc's own help: its options, and those of the solvers of this run"),
            ("-version", "versions of petscib and of what it runs on")):
        lines += _entry(name, text)
    return "\n".join(lines) + "\n"


def _group(group):
    lines = [group]
    for option in TABLE.values():
        if option.group == group:
            lines += _option_entry(option)
    if group in (SHAPE, MEMBRANE):
        lines += ["", *textwrap.wrap(
            "With several vesicles, -vesicle_0_axes, -vesicle_1_center and so on give one vesicle "
            "its own value of " + ", ".join(OWN) + ".", 100)]
    return lines


def _option_entry(option):
    unit = f" [{option.unit}]" if option.unit else ""
    plain = isinstance(option.kind, (Flag, Path))
    allowed = "" if plain else f"{option.kind.allowed}; "
    return _entry(f"-{option.name} {option.kind.symbol}",
                  f"{option.help}{unit} ({allowed}default: {option.default_text})")


def _notes():
    return ["Scenes set other defaults than those below (-scene list).",
            f"Switches take {Flag.allowed}; alone they mean true."]


def _solvers():
    lines = ["Solvers: PETSc's ksp_ and pc_ options behind each prefix, as in "
             "-momentum_ksp_rtol 1e-8"]
    for prefix, text in SOLVERS:
        lines += _entry(f"-{prefix}*", text)
    return lines


def _of_petsc():
    lines = ["PETSc"]
    for name, text in (
            ("-options_file PATH", "read options from a file, one `-name value` a line"),
            ("-options_file_yaml PATH", "the same from a YAML file"),
            ("PETSC_OPTIONS", "environment variable with more options"),
            ("-log_view", "time and messages of each part, at the end"),
            ("-options_left", "options that nothing has read"),
            ("-help petsc", "PETSc's own help: its options, and those of the solvers of a run")):
        lines += _entry(name, text)
    return lines


def markdown_table():
    """The table of docs/options.md, in Markdown."""
    lines = []
    for group in GROUPS:
        lines += [f"**{group}**", "", "| option | meaning | allowed | default | unit |",
                  "| --- | --- | --- | --- | --- |"]
        lines += [f"| `-{option.name}` | {option.help} | {option.kind.allowed} | "
                  f"{option.default_text} | {option.unit} |"
                  for option in TABLE.values() if option.group == group]
        lines.append("")
    return "\n".join(lines)


def _entry(name, text, column=28):
    """Lines of one help entry: the name, then the text wrapped in its column."""
    wrapped = textwrap.wrap(text, 100 - column, break_on_hyphens=False)
    first = f"  {name}"
    lines = [first] if len(first) >= column else [first.ljust(column) + wrapped.pop(0)]
    return lines + [" " * column + line for line in wrapped]
