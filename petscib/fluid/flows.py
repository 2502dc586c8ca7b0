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


def cavity(x, y, shear_rate, domain):
    """Fluid at rest under a lid that slides along x, at gamma times the box's height."""
    _, _, c, d = domain
    return np.where(y < d, 0.0, shear_rate * (d - c)) + 0 * x, np.zeros_like(x + y)


def stream(x, y, shear_rate, domain):
    """Uniform flow along x, of gamma times the box's height."""
    _, _, c, d = domain
    return shear_rate * (d - c) + 0 * (x + y), np.zeros_like(x + y)


def taylor_green(x, y, shear_rate, domain):
    """Vortices that fill the box, one period of it each way, of the strain rate gamma."""
    a, b, c, d = domain
    k_x, k_y = 2 * np.pi / (b - a), 2 * np.pi / (d - c)
    x, y = k_x * (x - a), k_y * (y - c)
    return shear_rate / k_x * np.sin(x) * np.cos(y), -shear_rate / k_y * np.cos(x) * np.sin(y)


FLOWS = {flow.__name__.replace("_", "-"): flow
         for flow in (rest, shear, extensional, poiseuille, cavity, stream, taylor_green)}
# Directions in which they vary, and not with the box: there it cannot be periodic.
VARIES = {"rest": "", "shear": "y", "extensional": "xy", "poiseuille": "y", "cavity": "y",
          "stream": "", "taylor-green": ""}
