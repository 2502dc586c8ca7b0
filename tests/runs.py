"""Short runs inside a test's own process, on all its ranks."""
import atexit

import numpy as np
from mpi4py import MPI

from petscib import options, petsc_options, restart
from petscib.driver import Driver
from petscib.entries import Entries
from petscib.output import tables

comm = MPI.COMM_WORLD
SMALL = {"stag_grid_x": "24", "ts_dt": "0.08333333333333333", "axes": "0.25,0.4",
         "monitor": "none", "plot": "no"}


def prepare(folder, communicator=None, **words):
    """A simulation, not yet run, with the options given as on a command line.  Collective."""
    given = {**words, "output": str(folder)}
    if "restart" not in words:
        given = {**SMALL, **given}
    database = restart.merge(given, comm)
    words = {name: text for name, text in database.items() if petsc_options.is_petsc(name)}
    simulation = Driver(options.read(database), communicator, entries=Entries(words))
    atexit.register(simulation.destroy)  # PETSc must not find it at its own end
    return simulation


def run(folder, communicator=None, **words):
    """Run to the end and return the summary.  Collective."""
    simulation = prepare(folder, communicator, **words)
    try:
        return simulation.run()
    finally:
        simulation.destroy()


def arrays(path):
    """Every dataset of an HDF5 file by name."""
    import h5py

    found = {}

    def collect(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = item[...]

    with h5py.File(path, "r") as file:
        file.visititems(collect)
    return found


def rows(folder):
    """The diagnostics without the clock's column."""
    table = tables.read(folder / "diagnostics.csv")
    table.pop("wall_seconds")
    return table


def assert_same_run(one, other, tolerance=0.0):
    """Final state, rows and outlines agree."""
    first, second = arrays(one / "final.h5"), arrays(other / "final.h5")
    assert first.keys() == second.keys()
    for name, values in first.items():
        np.testing.assert_allclose(second[name], values, rtol=0, err_msg=name,
                                   atol=tolerance * max(1.0, abs(values).max()))
    first, second = rows(one), rows(other)
    assert list(second["step"]) == list(first["step"])
    if not tolerance:
        np.testing.assert_equal(second, first)
        assert (one / "outlines.csv").read_text() == (other / "outlines.csv").read_text()
