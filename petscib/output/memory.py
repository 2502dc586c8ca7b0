"""Results of a run that writes no files: a script has them in its memory."""

from .results import Results


class Memory(Results):
    """The interface of `Results`, of which only what is printed is left.  Collective."""

    writes = False
    traceback = "the traceback above"

    def _open(self, columns, header):
        pass

    def record(self, row, state):
        """Keep the row, and show progress."""
        self.last_row = row
        self.monitor.update(row)

    def _write_summary(self, summary):
        pass

    def keep_traceback(self, text):
        """Print where an exception was raised.  On any one rank."""
        self.monitor.write(text.rstrip())
