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
        run failed; 130 and 143 when SIGINT and SIGTERM have stopped it.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    asked = [word for word in arguments if word.lower() in ("-help", "--help", "-h")]
    version = [word for word in arguments if word.lower() in ("-version", "--version")]

    from mpi4py import MPI

    from . import options, petsc, sources
    from .agreement import on_root
    from .errors import InputError, OutputError, SolveError
    from .output import console

    world = MPI.COMM_WORLD
    try:
        on_root(world, lambda: sources.check(arguments))
        # PETSc would print its own help or version, rank by rank, before ours.
        petsc.start([word for word in arguments if word not in asked + version])
        console.protect()
        from petsc4py import PETSc

        from . import installation, restart, vesicle_files

        if version:
            if world.rank == 0:
                print(*(" ".join(item) for item in installation.versions().items()), sep="\n")
            return 0
        installation.check()
        database = PETSc.Options().getAll()
        # At its end newer PETSc lists what nothing has read; the run has named that already.
        if "options_left" not in database:
            PETSc.Options()["options_left"] = "no"
        information = options.information({**database, **dict.fromkeys(asked and ["help"], "")})
        if information is not None:
            if world.rank == 0:
                print(information)
            return 0
        database = vesicle_files.expand(restart.merge(database, world), world)
        return _simulate(options.read(database), world.rank == 0)
    except (InputError, SolveError, OutputError) as error:
        if world.rank == 0:
            print(f"petscib: {error}", file=sys.stderr, flush=True)
        return error.exit_status
    except Exception:
        # The other ranks may be waiting for this one: end the whole job, not this rank alone.
        traceback.print_exc()
        sys.stderr.flush()
        world.Abort(1)


def _simulate(settings, root):
    from .interrupt import Interrupt, exit_status
    from .output.monitor import closing_lines
    from .simulation import Simulation

    with Interrupt() as interrupt:
        simulation = Simulation(settings, interrupt=interrupt)
        try:
            summary = simulation.run()
        finally:
            simulation.destroy()
        if root:
            print("\n".join(closing_lines(summary)), flush=True)
            if simulation.signal:
                print(f"stopped early; to go on: -restart latest -output {settings.output}")
        return exit_status(simulation.signal)


if __name__ == "__main__":
    sys.exit(main())
