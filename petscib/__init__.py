"""Vesicles and elastic membranes in viscous flow by energy stable immersed boundary methods."""

__version__ = "0.2.0"
