"""The paper's literal method and the corrected one, side by side in the studies of its tables.

Both interpolate with the paper's delta function, so that the corrections are all that differs.
"""

from ..schemes.registry import SCHEMES

# The schemes of its tables.  (Literally, the coupled ones are factored whole in every step: be
# takes 2 s for that on 128^2, and on 256^2 UMFPACK fails.)
IN_TABLES = "ep", "mbe", "mcn"
LITERAL, CORRECTED = "literal", "corrected"
OPTIONS = {
    LITERAL: dict(delta="yang", kink_correction=False, conserve_area=False),
    CORRECTED: dict(delta="yang", kink_correction=True, conserve_area=True),
}


def series(schemes):
    """Pairs of scheme and method.

    Those of the paper's tables by the literal method, then all by the corrected one, but for `ep`,
    which has no corrections.
    """
    return ([(scheme, LITERAL) for scheme in schemes if scheme in IN_TABLES]
            + [(scheme, CORRECTED) for scheme in schemes if SCHEMES[scheme].implicit])


def title(scheme, method):
    """What tables and pictures call a pair."""
    return scheme if method == LITERAL else f"{scheme}, {method}"
