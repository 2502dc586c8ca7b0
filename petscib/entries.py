"""What a simulation has in PETSc's option database: its user's words and its solvers' defaults.

PETSc has one database a process, and inner solvers read theirs late.  Of several simulations in a
script only the one at work has its entries there: another would take them for its own user's.
"""

from petsc4py import PETSc


class Entries:
    """The entries of one simulation.  Not collective, but the same on all ranks.

    Parameters
    ----------
    words : dict of str to str or None, optional
        Options for PETSc that this simulation's user gives, names to texts.
    """

    def __init__(self, words=None):
        self._words = dict(words or {})
        self._defaults = {}
        self._covered = {}  # of words: whether, and with which text, there was one before

    def use(self):
        """Have these in the database, and no other simulation's."""
        if present() is self:
            return
        present().withdraw()
        _present[0] = self
        options = PETSc.Options()
        there = options.getAll()
        for name, text in self._words.items():
            if name not in there or (there[name] or "") != (text or ""):
                self._covered[name] = name in there, there.get(name)
                options[name] = text or ""
        for name, value in self._defaults.items():
            self.add_default(name, value)

    def add_default(self, name, value):
        """Enter a solver's default, unless there is an entry of this name."""
        options = PETSc.Options()
        if not options.hasName(name):
            options[name] = value
            self._defaults[name] = value

    def withdraw(self):
        """Take these out of the database again, if they are there."""
        if present() is not self:
            return
        options = PETSc.Options()
        for name in self._defaults:
            options.delValue(name)
        while self._covered:
            name, (was_there, text) = self._covered.popitem()
            options.delValue(name)
            if was_there:
                options[name] = text or ""
        _present[0] = Entries()


_present = [Entries()]  # those in the database; at first nobody's


def present():
    """The entries that are in the database."""
    return _present[0]
