"""What the options say of one vesicle among several.

An option that is a vesicle's own, such as vesicle_1_axes, wins over the common one.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

# What a vesicle may have its own value of.
OWN = ("shape", "axes", "center", "angle", "amplitude", "markers", "marker_file", "sigma0",
       "bending", "rest_length", "tether", "load", "viscosity_contrast")
_NAME = re.compile(r"vesicle_(\d{1,9})_(\w*)", re.ASCII)


def split(name):
    """Number of the vesicle and common name of an option such as vesicle_1_axes, or None twice."""
    found = _NAME.fullmatch(name)
    return (int(found[1]), found[2]) if found else (None, None)


@dataclass(frozen=True)
class Vesicle:
    """The values of one vesicle, as attributes named like the common options.

    Attributes
    ----------
    number : int
        Counted from 0.
    values : mapping
        By common name.
    own : frozenset of str
        Common names of the options that it does not share.
    """

    number: int
    values: Mapping[str, Any]
    own: frozenset

    def __getattr__(self, name):
        try:
            return self.__dict__["values"][name]
        except KeyError:
            raise AttributeError(name) from None

    def placed(self, center, angle):
        """The same vesicle somewhere else."""
        values = {**self.values, "center": tuple(center), "angle": angle}
        return replace(self, values=MappingProxyType(values))

    def option(self, name):
        """Name of the option that a value comes from; others than a vesicle's stay as they are."""
        return f"vesicle_{self.number}_{name}" if name in self.own else name


def of(values, number):
    """The record of a vesicle.

    Parameters
    ----------
    values : mapping of str to value
        All options; those of one vesicle only where they are given.
    number : int
    """
    own = {name: values[f"vesicle_{number}_{name}"] for name in OWN
           if f"vesicle_{number}_{name}" in values}
    result = {name: values[name] for name in OWN}
    # A shape of its own takes the place of a common one of another kind.
    if "axes" in own:
        result["marker_file"] = None
    if "marker_file" in own or own.get("shape") == "line":
        result["axes"] = None
    result.update(own)
    return Vesicle(number, MappingProxyType(result), frozenset(own))
