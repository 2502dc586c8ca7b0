"""The paper's literal method and the corrected one, side by side in the studies of its tables.

Both interpolate with the paper's delta function, so that the corrections are all that differs.
"""

from ..schemes.registry import SCHEMES

OF_THE_PAPER = "ep", "mbe", "mcn", "be", "cn"  # schemes
LITERAL, CORRECTED = "literal", "corrected"
OPTIONS = {
    LITERAL: dict(delta="yang", kink_correction=False, conserve_area=False),
    CORRECTED: dict(delta="yang", kink_correction=True, conserve_area=True),
}


def series(schemes):
    """Pairs of scheme and method.

    The paper's own schemes by the literal method, then all by the corrected one, but for `ep`,
    which has no corrections.
    """
    return ([(scheme, LITERAL) for scheme in schemes if scheme in OF_THE_PAPER]
            + [(scheme, CORRECTED) for scheme in schemes if SCHEMES[scheme].implicit])


def title(scheme, method):
    """What tables and pictures call a pair."""
    return scheme if method == LITERAL else f"{scheme}, {method}"
