"""``mpiexec -n 2 python -m petscib [options]``: one run."""

import sys
import traceback


def main(arguments=None):
    """Run petscib.  Collective.

    Parameters
    ----------
    arguments : list of str, optional
        Command line without the program's name.

    Returns
    -------
    int
        Exit status, the same on every rank: 0, also after SIGUSR1; 2 for bad input; 3 when the
        run failed; 130, 143 and 129 when SIGINT, SIGTERM and SIGHUP have stopped it.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    from mpi4py import MPI

    from . import help, petsc, petsc_options, sources
    from .agreement import on_root
    from .errors import Error
    from .output import console

    world = MPI.COMM_WORLD
    topic, arguments = help.help_asked(arguments)
    version = [word for word in arguments if word.lower() in ("-version", "--version")]
    try:
        on_root(world, lambda: sources.check(arguments))
        # PETSc would print its own help or version, rank by rank, before ours.
        words = [word for word in arguments if word not in version]
        if topic == "petsc":
            words += ["-help", "-no_signal_handler"]  # it may be listened to no longer
        petsc.start(words)
        console.protect()
        from petsc4py import PETSc

        from . import installation

        if version:
            if world.rank == 0:
                print(*(" ".join(item) for item in installation.versions().items()), sep="\n")
            return 0
        # Of an option without a value PETSc says None, which in a script stands for the default.
        database = {name: text or "" for name, text in PETSc.Options().getAll().items()}
        if "options_left" in database:
            for name in database:
                if not petsc_options.is_petsc(name):
                    PETSc.Options().hasName(name)  # counts as read
        else:
            # At its end newer PETSc lists what nothing has read; the run has named that already.
            PETSc.Options()["options_left"] = "no"
        if topic == "petsc":
            return _set_up(database)
        asked = {} if topic is None else {"help": topic}
        information = help.information({**database, **asked})
        if information is not None:
            if world.rank == 0:
                print(information, end="")
            return 0
        return _simulate(database, world.rank == 0)
    except Error as error:
        if world.rank == 0:
            print(f"petscib: {error}", file=sys.stderr, flush=True)
        return error.exit_status
    except Exception:
        # The other ranks may be waiting for this one: end the whole job, not this rank alone.
        traceback.print_exc()
        sys.stderr.flush()
        world.Abort(1)


def _set_up(database):
    """Only set a run up, of which PETSc prints its options for the solvers."""
    from .library import Simulation

    del database["help"]
    database.pop("output", None)
    Simulation(**database).close()
    return 0


def _simulate(database, root):
    from .interrupt import Interrupt, exit_status
    from .library import Simulation
    from .output.words import closing_lines

    with Interrupt() as interrupt, Simulation(
            interrupt=interrupt, **{"output": True, **database}) as simulation:
        summary = simulation.run()
        if root:
            print("\n".join(closing_lines(summary)), flush=True)
        return exit_status(simulation.signal)


if __name__ == "__main__":
    sys.exit(main())
