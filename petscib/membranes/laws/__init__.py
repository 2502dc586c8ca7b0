"""Laws of membrane forces, a module each.

A law has the energy |m|^2 / 2 of *stresses* m(X), scaled to be the root of an energy.  It gives

``name``
    What its columns in the tables are called.
``stress(markers, stretch)``
    m, shape (rows,).
``columns``
    Integer array, shape (rows, w): which components of the markers, 2 k + i, change each stress.
``weights(before, after)``
    Array of that shape, the entries of C with m(after) - m(before) = C (after - before), exactly.
    With the same markers twice it is the derivative.

The force on marker k is - C^T m.  So a new law needs no more than these, and joins the implicit
system, the energy ledger and the tables by itself.  All arrays live on rank 0; the other ranks
call the same functions without markers.
"""

from .bending import Bending
from .tension import Tension

__all__ = ["Bending", "Tension"]
