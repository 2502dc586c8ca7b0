"""Simulations in scripts: options as keywords, steps as iterations, results as arrays."""

import atexit
from array import array

import numpy as np

from . import petsc
from .agreement import everywhere, on_root
from .errors import Error, InputError
from .output import console
from .own import Points


class Simulation:
    """A simulation, ready to be run.  Collective.

    Parameters
    ----------
    arguments : list of str, optional
        Words of a command line, such as ``sys.argv[1:]``, whose options win over the keywords.
    laws : sequence of callables, optional
        Each makes a force law of the membranes from their `Curves` and the markers (M, 2); a class
        whose objects begin with these two will do.  See `petscib.membranes.laws`.
    measures : mapping of str to callable, optional
        Further columns of the diagnostics: each is called with the simulation on all ranks, and
        what it returns on rank 0 counts, a number or None.
    comm : mpi4py communicator, optional
        All of MPI's ranks by default.
    interrupt : Interrupt, optional
        Where signals that ask the run to stop are noted.
    **options
        Every option of the command line by its name without the dash, with Python's values:
        numbers, tuples, True and False, None for the default.  Beyond the command line,

        - `flow` and `body_force` may be functions (x, y, t) of arrays that return two;
        - `points` is an array (N, 2) of points along a closed membrane, or a list of such arrays,
          one for each vesicle, in place of `marker_file`;
        - without `output` no files are written, nor is progress shown; True means the command
          line's default.

    Attributes
    ----------
    settings : Settings
        All options as attributes; frozen.
    comm : mpi4py communicator

    Raises
    ------
    InputError
        On all ranks, with the line that the command line would print.
    """

    def __init__(self, arguments=None, *, laws=(), measures=None, comm=None, interrupt=None,
                 **options):
        if not petsc.started():
            petsc.start(arguments or [])
        from mpi4py import MPI
        from petsc4py import PETSc

        from . import installation, uncaught
        from .driver import Driver
        from .settings import NOWHERE

        console.take_pipes_back()
        self.comm = MPI.COMM_WORLD if comm is None else comm
        uncaught.end_the_job(self.comm)
        installation.check()
        self._driver, self._calls, self._table = None, [], {}
        self.settings, scene, entries = self._read(arguments or [], options)
        if self.settings.output != NOWHERE:
            console.protect()  # a run that leaves files need not be heard
        named = {**scene.measures, **(measures or {})}
        for name, measure in named.items():
            if not callable(measure):
                raise InputError(f"measures: {name}: {measure!r} cannot be called; allowed: a "
                                 "function of the simulation")
        given = {name: lambda measure=measure: measure(self) for name, measure in named.items()}
        self._driver = Driver(
            self.settings, PETSc.Comm(self.comm), interrupt, (*scene.laws, *laws), given,
            self._note, entries)
        # PETSc must not find our objects at its own end.
        atexit.register(self.close)

    def _read(self, arguments, keywords):
        """Settings, scene, and what PETSc is told by its user.  Collective."""
        from . import options, petsc_options, restart, scenes, sources, vesicle_files
        from .entries import Entries

        on_root(self.comm, lambda: sources.check(arguments))
        database = _texts(keywords)
        database.update(petsc.database_of(arguments) if arguments else {})
        writes = database.get("output") is not None
        if database.get("output") is True:
            del database["output"]
        scene = str(database.get("scene", ""))
        if scene.endswith(".py"):  # which could fail on one rank alone
            everywhere(self.comm, lambda: scenes.find(scene))
        database = restart.merge(database, self.comm)
        entries = Entries({name: text for name, text in database.items()
                           if petsc_options.is_petsc(name)})
        if not writes:
            database = {"monitor": "none", "plot": "false", **database}
        settings = options.read(vesicle_files.expand(database, self.comm), writes)
        return settings, scenes.find(settings.scene), entries

    @property
    def _running(self):
        """The driver, unless it has been freed."""
        if self._driver is None:
            raise RuntimeError("this simulation has been closed")
        return self._driver

    # --- stepping

    def __iter__(self):
        """Take a step for each iteration.  Collective.

        A loop that was left goes on where another one, or `run`, begins.

        Yields
        ------
        dict
            The newest row of diagnostics, by column; equal on all ranks.

        Raises
        ------
        InputError, SolveError, OutputError
            On all ranks: a step failed, or results could not be written.
        """
        for row in self._running.steps():
            for call in self._calls:
                call.act(self)
            yield row

    def run(self):
        """Step to the end.  Collective.

        Returns
        -------
        dict
            What summary.json holds; equal on all ranks but for seconds.
        """
        for _ in self:
            pass
        return self._running.summary

    def every(self, function=None, *, steps=None, time=None):
        """Have a function called in the course of the run; also a decorator.  Not collective.

        Parameters
        ----------
        function : callable
            Called with the simulation, on all ranks, after every so many steps, or after each step
            that reaches or passes a multiple of a time.
        steps : int
        time : float
            One of the two.
        """
        if (steps is None) == (time is None) or not (steps or time) > 0:
            raise ValueError("every: steps=N or time=X, above 0")
        if function is None:
            return lambda function: self.every(function, steps=steps, time=time)
        self._calls.append(_Call(function, steps, time, self))
        return function

    def save(self, path):
        """Write a checkpoint, from which ``restart=path`` continues.  Collective.

        Raises
        ------
        OutputError
            On all ranks.
        """
        self._running.save(str(path))

    def close(self):
        """Free the solvers.  Collective.  Arrays that were asked for before stay."""
        atexit.unregister(self.close)
        driver, self._driver = self._driver, None
        if driver is not None:
            driver.destroy()

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        ours = isinstance(error, Error)  # after which the driver has done so
        if self._driver is not None and isinstance(error, Exception) and not ours:
            self._driver.leave()
        self.close()

    # --- state and results

    @property
    def step(self):
        """Number of the present step, 0 at the start."""
        return self._running.state.step

    @property
    def time(self):
        """Present time."""
        return self._running.state.time

    @property
    def finished(self):
        """Whether the run has come to its end."""
        return self._running.summary is not None

    @property
    def signal(self):
        """Number of the signal that has ended the run, or 0."""
        return self._running.signal

    @property
    def markers(self):
        """Positions of all markers (M, 2), vesicle after vesicle; on rank 0, (0, 2) elsewhere.

        A view of the state that cannot be written to; each step has a new one.
        """
        view = self._running.state.markers.view()
        view.flags.writeable = False
        return view

    @property
    def membranes(self):
        """The same as a list of views, one (M_k, 2) for each vesicle; empty but on rank 0."""
        curves = self._running.problem.curves
        return [] if curves is None else curves.parts(self.markers)

    @property
    def tension(self):
        """Tension sigma between markers k - 1 and k, as a list like `membranes`; rank 0.

        That of the step's stage, once there was one.
        """
        problem = self._running.problem
        if problem.curves is None:
            return []
        return problem.curves.edge_parts(problem.tension(self._running.state))

    @property
    def last_row(self):
        """The newest row of diagnostics, a dict by column; None in place of what does not apply."""
        return dict(self._running.results.last_row or {})

    @property
    def diagnostics(self):
        """Rows so far, a dict of arrays by column; NaN where a column does not apply.

        Copies, equal on all ranks.  The first row is that of the start.
        """
        return {name: np.array(values) for name, values in self._table.items()}

    @property
    def doubts(self):
        """Why the result is not to be trusted, a list of str; empty before the end."""
        return list(self._running.doubts.found)

    def fields(self):
        """The fluid on the whole grid of m x n cells.  Collective.

        Returns
        -------
        dict of str to ndarray, or None
            On rank 0, None elsewhere; row index y, column index x.  ``x`` (m,) and ``y`` (n,), the
            cell centres; ``u``, ``v`` (n, m), the velocity there, the mean of two faces; ``p``
            (n, m), the pressure; ``u_faces`` (n, m + 1) and ``v_faces`` (n + 1, m), the unknowns
            themselves, a column or row less where the box is periodic.  Copies.
        """
        from .output import saved

        grid, state = self._running.problem.grid, self._running.shown_state()
        u, v = grid.velocity_blocks(state.velocity)
        p = grid.pressure_block(state.pressure)
        parts = self.comm.gather((
            (grid.u_box, u), (grid.v_box, v), (grid.p_box, p)))
        if parts is None:
            return None
        whole = [np.empty(index.shape) for index in (grid.u_index, grid.v_index, grid.p_index)]
        for part in parts:
            for table, (box, values) in zip(whole, part):
                table[box] = values
        u, v, p = whole
        x, y = grid.p_points()
        centres = dict(zip("uv", saved.centre_velocity(u, v)))
        return {"x": x.ravel(), "y": y.ravel(), **centres, "p": p, "u_faces": u, "v_faces": v}

    def _note(self, row):
        """Add a row to the table."""
        for name, value in row.items():
            value = np.nan if value is None else value
            self._table.setdefault(name, array("d")).append(value)


class _Call:
    """A function and when it is to be called."""

    def __init__(self, function, steps, time, simulation):
        self.function, self.steps, self.interval = function, steps, time
        self.reached = self._count(simulation)

    def _count(self, simulation):
        # The sum of many steps may fall short of a multiple by round-off.
        return 0 if self.interval is None else int(simulation.time / self.interval + 1e-9)

    def act(self, simulation):
        before, self.reached = self.reached, self._count(simulation)
        if self.steps and simulation.step % self.steps == 0 or self.reached > before:
            self.function(simulation)


def _texts(keywords):
    """Names to texts, functions and points of some keywords."""
    from . import options
    from .settings import text_of

    texts = {}
    for name, value in _with_points(keywords).items():
        option = options.option_of(name)
        if value is None:
            continue
        if name == "output" and value is True or isinstance(value, Points):
            texts[name] = value
        elif option is None:
            texts[name] = text_of(value)
        else:
            texts[name] = options.entry_of(option, value)
    return texts


def _with_points(keywords):
    """The keywords, with `points` in the words of the other options."""
    keywords = dict(keywords)
    points = keywords.pop("points", None)
    if points is None:
        return keywords
    several = isinstance(points, (list, tuple)) and len(points) and np.ndim(points[0]) == 2
    if not several:
        return {**keywords, "marker_file": Points(points)}
    keywords.setdefault("vesicles", len(points))
    return {**{f"vesicle_{k}_marker_file": Points(one, f"points[{k}]")
               for k, one in enumerate(points)}, **keywords}
