"""PETSc's option database holds the entries of one simulation at a time."""
from petsc4py import PETSc

from petscib.entries import Entries, present

NAMES = "entries_word", "entries_default", "entries_covered"


def found():
    there = PETSc.Options().getAll()
    return {name: there[name] for name in NAMES if name in there}


def test_one_simulations_entries_at_a_time():
    database = PETSc.Options()
    database["entries_covered"] = "1"
    one = Entries({"entries_word": "a", "entries_covered": "2"})
    other = Entries()
    one.use()
    one.add_default("entries_default", "3")
    one.add_default("entries_word", "b")  # the user's word stands
    mine = {"entries_word": "a", "entries_default": "3", "entries_covered": "2"}
    assert present() is one and found() == mine
    other.use()
    assert found() == {"entries_covered": "1"}
    other.add_default("entries_word", "c")
    one.use()
    assert found() == mine
    other.withdraw()  # which is not there
    assert found() == mine
    one.withdraw()
    assert found() == {"entries_covered": "1"} and present() not in (one, other)
    database.delValue("entries_covered")
