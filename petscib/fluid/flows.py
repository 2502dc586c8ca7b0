"""Background flows: what the walls carry along, and what the fluid starts from."""

import numpy as np


def rest(x, y, shear_rate, domain):
    """Fluid at rest."""
    return np.zeros_like(x + y), np.zeros_like(x + y)


def shear(x, y, shear_rate, domain):
    """Simple shear u = (gamma y, 0)."""
    return shear_rate * y + 0 * x, np.zeros_like(x + y)


def extensional(x, y, shear_rate, domain):
    """Planar extension u = gamma (x, -y)."""
    return shear_rate * x + 0 * y, -shear_rate * y + 0 * x


def poiseuille(x, y, shear_rate, domain):
    """Channel flow along x; its shear rate at the lower wall is gamma."""
    _, _, c, d = domain
    return shear_rate * (y - c) * (d - y) / (d - c) + 0 * x, np.zeros_like(x + y)


FLOWS = {flow.__name__: flow for flow in (rest, shear, extensional, poiseuille)}
# Directions in which they vary: there the box cannot be periodic.
VARIES = {"rest": "", "shear": "y", "extensional": "xy", "poiseuille": "y"}
