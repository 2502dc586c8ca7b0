"""A study's runs: made one after the other, never twice, with a line of progress each."""

import argparse
import os
import signal
import sys
from time import perf_counter

from ..output.files import write_text
from . import report, runs

_INDEX = ("run", "title", "status", "steps", "seconds", "reason", "command")


class Campaign:
    """The runs of one study and the folder that holds them and what is made of them.

    Parameters
    ----------
    name : str
        Of the study.
    output : str
        Folder; the runs lie in its subfolder ``runs``.
    quick : bool
        The version of minutes.
    ranks : int
        MPI ranks of each run.
    cells : tuple of int
        Grids that are asked for instead of the study's own.
    """

    def __init__(self, name, output, quick=False, ranks=1, cells=()):
        self.name, self.output, self.quick, self.ranks = name, output, quick, ranks
        self.cells = cells
        self._outcomes = {}
        self._titles = {}
        self._began = perf_counter()
        os.makedirs(output, exist_ok=True)

    @classmethod
    def from_command_line(cls, name, summary, arguments=None):
        """The campaign that a study's command line asks for."""
        parser = argparse.ArgumentParser(
            prog=f"python -m petscib.studies.{name}", description=summary, allow_abbrev=False)
        add_options(parser)
        given = parser.parse_args(arguments)
        # As Ctrl-C does, and unlike the default: the run at work must end too.
        signal.signal(signal.SIGTERM, lambda kind, frame: sys.exit(128 + kind))
        folder = given.output or os.path.join("out", "studies", name)
        return cls(name, folder, given.quick, given.ranks, given.cells)

    def grids(self, *own):
        """Cells of the study's grids: those asked for, or its own."""
        return self.cells or own

    def run(self, title, options, time_limit=float("inf"), progress=""):
        """Make a run, or find it made.

        Parameters
        ----------
        title : str
            What the progress line calls it.
        options : mapping of str to value
            petscib's options, without -output.
        time_limit : float
            Seconds.
        progress : str
            Such as "3/12".

        Returns
        -------
        runs.Outcome
        """
        return self.make(runs.Run(options, self.ranks, time_limit), title, progress)

    def make(self, run, title, progress="", again=False):
        """The same for a given Run; `again` even when it has been made before."""
        folder = os.path.join(self.output, "runs", run.key)
        outcome, note = None if again else runs.recall(run, folder), "made earlier"
        if outcome is None:
            self._say(f"{progress} {title} ...", end="")
            outcome, note = runs.execute(run, folder), ""
        why = "" if outcome.is_result else f": {outcome.reason}"
        self._say(f"{progress} {title}: {outcome.status}, {outcome.steps} steps, "
                  f"{outcome.seconds:.1f} s {note}".rstrip() + why)
        self._outcomes[run.key], self._titles[run.key] = outcome, title
        self._write_index()
        return outcome

    def run_all(self, declared, time_limit=float("inf")):
        """Make all runs of a mapping of label to options; returns label to Outcome."""
        return {
            label: self.run(_words(label), options, time_limit, f"{number}/{len(declared)}")
            for number, (label, options) in enumerate(declared.items(), 1)
        }

    def _say(self, line, end="\n"):
        """Show progress: on a terminal the line of a run at work is replaced when it is done."""
        line = f"{self.name}: {line} [{report.duration(perf_counter() - self._began)}]"
        if sys.stderr.isatty():
            print(f"\r\033[K{line}", end=end, file=sys.stderr, flush=True)
        elif end:
            print(line, file=sys.stderr, flush=True)

    def _write_index(self):
        rows = [
            (key, self._titles[key], one.status, one.steps, round(one.seconds, 3), one.reason,
             one.command)
            for key, one in self._outcomes.items()
        ]
        report.write_csv(self.path("runs.csv"), _INDEX, rows)

    @property
    def exit_status(self):
        """Of the study: 1 when a run has crashed, else 0."""
        return int(any(one.status == runs.CRASHED for one in self._outcomes.values()))

    def path(self, name):
        """Path of a file in the study's folder."""
        return os.path.join(self.output, name)

    def write_records(self, columns, records, text):
        """As `write`, from records: dicts by column, in which what does not apply is missing."""
        self.write(columns, [[one.get(name) for name in columns] for one in records], text)

    def write(self, columns, rows, text):
        """Leave the study's results: NAME.csv, and the Markdown text with NAME.md's usual end.

        Parameters
        ----------
        columns : sequence of str
        rows : sequence of sequence
            None where a quantity does not apply.
        text : str
            Markdown.

        Raises
        ------
        SystemExit
            No run has given a result: nothing is written, and the message says why.
        """
        without = [key for key, one in self._outcomes.items() if not one.is_result]
        if len(without) == len(self._outcomes):
            first = self._outcomes[without[0]]
            sys.exit(f"{self.name}: none of {len(without)} runs has given a result; the first "
                     f"{first.status}: {first.reason}; all it said: {first.folder}/log.txt")
        report.write_csv(self.path(f"{self.name}.csv"), columns, rows)
        words = " -quick" if self.quick else ""
        if self.cells:
            words += f" -cells {','.join(map(str, self.cells))}"
        examples = [one.command for one in self._outcomes.values()]
        if without:
            text += "\n**Runs that crashed or were refused**\n\n" + report.markdown_table(
                ["run", "status", "reason"],
                [[self._titles[key], self._outcomes[key].status,
                  self._outcomes[key].reason.replace("|", "/")] for key in without])
        text += f"\nMade by `python -m petscib.studies.{self.name}{words}`"
        text += f"; the command of every run is in `runs.csv`, such as\n`{examples[-1]}`.\n"
        write_text(self.path(f"{self.name}.md"), text)
        print(text)
        self._say(f"results in {self.output}")


def add_options(parser):
    """The options that all studies share."""
    parser.add_argument("-quick", action="store_true", help="a version of minutes")
    parser.add_argument("-output", metavar="DIR", help="results (default: out/studies/NAME)")
    parser.add_argument("-cells", metavar="N,...", type=_numbers, default=(),
                        help="grids, where a study has a choice of them (default: its own)")
    parser.add_argument("-ranks", metavar="N", type=int, default=1, help="MPI ranks of each run")


def _numbers(text):
    return tuple(int(word) for word in text.split(","))


def _words(label):
    parts = label if isinstance(label, tuple) else (label,)
    return " ".join(f"{part:.6g}" if isinstance(part, float) else str(part) for part in parts)
