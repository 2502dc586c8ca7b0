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
        Exit status, the same on every rank: 0; 2 for bad input; 3 when the run failed.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    asked = [word for word in arguments if word.lower() in ("-help", "--help", "-h")]

    import petsc4py

    # PETSc would print its own help, rank by rank, before ours.
    petsc4py.init([sys.argv[0], *(word for word in arguments if word not in asked)])
    from mpi4py import MPI
    from petsc4py import PETSc

    from . import options
    from .errors import InputError, SolveError

    root = MPI.COMM_WORLD.rank == 0
    try:
        database = PETSc.Options().getAll()
        information = options.information({**database, **dict.fromkeys(asked and ["help"], "")})
        if information is not None:
            if root:
                print(information)
            return 0
        options.reject_stray_words(arguments)
        return _simulate(options.read(database), root)
    except (InputError, SolveError) as error:
        if root:
            print(f"petscib: {error}", file=sys.stderr, flush=True)
        return error.exit_status
    except Exception:
        # The other ranks may be waiting for this one: end the whole job, not this rank alone.
        traceback.print_exc()
        sys.stderr.flush()
        MPI.COMM_WORLD.Abort(1)


def _simulate(settings, root):
    from .output.monitor import closing_lines
    from .simulation import Simulation

    simulation = Simulation(settings)
    try:
        summary = simulation.run()
    finally:
        simulation.destroy()
    if root:
        print("\n".join(closing_lines(summary)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
