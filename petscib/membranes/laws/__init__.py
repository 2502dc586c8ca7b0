"""Laws of membrane forces, a module each.

A law has the energy |m|^2 / 2 of *stresses* m(X, t), scaled to be the root of an energy.  It gives

``name``
    What its columns in the tables are called.
``linear``
    Whether C is the same everywhere.
``stress(markers, stretch, time)``
    m, shape (rows,).
``columns``
    Integer array, shape (rows, w): which components of the markers, 2 k + i, change each stress.
``weights(before, after)``
    Array of that shape, the entries of C with m(after) - m(before) = C (after - before), exactly,
    at the same time.  With the same markers twice it is the derivative.

The force on marker k is - C^T m.  So a new law needs no more than these, and joins the implicit
system, the energy ledger and the tables by itself.  All arrays live on rank 0; the other ranks
call the same functions without markers.

A law whose rows come and go (see `contact`) also has

``cover(before, after)``
    See to it that the rows at hand are all that count in two configurations; True if they are
    others than before.
``forget()``
    Choose the rows anew at the next `cover`, as a restart would.
``energy(markers)``
    Its energy, whatever the rows at hand.

A law may have columns of its own in the tables: it names them in ``measures``, and
``measure(stress)`` gives a number each for every membrane.

A law whose stresses change in time by themselves, as where tethers are moved, says so by ``moves``.

`Load` is no such law: a given force has no energy, and its power is in the ledger.
"""

from .bending import Bending
from .checking import check_law
from .contact import Contact, WallContact
from .load import Load
from .tension import Tension
from .tether import Tether

LAWS = {law.name: law for law in (Tension, Bending, Tether, Contact, WallContact)}

__all__ = ["LAWS", "Load", "check_law", *(law.__name__ for law in LAWS.values())]
