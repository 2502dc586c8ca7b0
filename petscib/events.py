"""Named phases and stages of a run: PETSc log events and stages, and seconds for the summary.

`-log_view` lists them with flops and messages; `seconds` and `calls` are kept always.  A phase's
`seconds` are without those of phases inside it, so that they add up; PETSc's are with them.
"""

from collections import Counter
from contextlib import contextmanager
from time import perf_counter

from petsc4py import PETSc

seconds = Counter()
calls = Counter()
_events, _stages = {}, {}
_inner = [0.0]  # seconds in phases inside each of those at work, the outermost first


def count(run_seconds, run_calls):
    """Count in these from now on: of several simulations in a script each has its own.

    Parameters
    ----------
    run_seconds, run_calls : Counter
        `seconds` and `calls` become these.
    """
    global seconds, calls
    seconds, calls = run_seconds, run_calls


@contextmanager
def phase(name):
    """Attribute the time inside the block to `name`; phases may nest."""
    if name not in _events:
        _events[name] = PETSc.Log.Event(name)
    event = _events[name]
    start = perf_counter()
    _inner.append(0.0)
    event.begin()
    try:
        yield
    finally:
        event.end()
        elapsed = perf_counter() - start
        seconds[name] += elapsed - _inner.pop()
        _inner[-1] += elapsed
        calls[name] += 1


@contextmanager
def stage(name):
    """Show what PETSc does inside the block in a table of its own in `-log_view`."""
    if name not in _stages:
        _stages[name] = PETSc.Log.Stage(name)
    _stages[name].push()
    try:
        yield
    finally:
        _stages[name].pop()
