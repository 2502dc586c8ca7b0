"""Named phases of a run: PETSc log events, and wall seconds for the summary.

`-log_view` lists them with flops and messages; `seconds` and `calls` are kept always.
"""

from collections import Counter
from contextlib import contextmanager
from time import perf_counter

from petsc4py import PETSc

seconds = Counter()
calls = Counter()
_events = {}


@contextmanager
def phase(name):
    """Attribute the time inside the block to `name`; phases may nest."""
    if name not in _events:
        _events[name] = PETSc.Log.Event(name)
    event = _events[name]
    start = perf_counter()
    event.begin()
    try:
        yield
    finally:
        event.end()
        seconds[name] += perf_counter() - start
        calls[name] += 1
