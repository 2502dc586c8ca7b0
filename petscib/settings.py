"""The frozen record of option values, and their texts.

`petscib.options` declares the options, judges each value by itself and makes the record.  Values
that follow from others are found in `petscib.derived`, and combinations that cannot be run are
refused in `petscib.combinations`.
"""

import re

from .coupling.kernels import KERNELS
from .own import Points, is_own
from .vesicles import of

NOWHERE = ""  # value of `output` for a run that writes no files


class Settings:
    """Every option's value, as attributes named like the options. Frozen.

    Pure data, equal on all ranks. Built by `petscib.options.read`.

    Attributes
    ----------
    given : frozenset of str
        Names of the options the user gave; the rest are defaults of the scene or the table.
    """

    def __init__(self, values, given):
        self.__dict__.update(values, given=frozenset(given))

    def __setattr__(self, name, value):
        raise AttributeError(f"settings are frozen: {name} cannot be set")

    def __delattr__(self, name):
        raise AttributeError(f"settings are frozen: {name} cannot be deleted")

    def __eq__(self, other):
        return isinstance(other, Settings) and self.__dict__ == other.__dict__

    def __repr__(self):
        return "Settings({})".format(", ".join(f"{k}={v!r}" for k, v in self.__dict__.items()))

    def vesicle(self, number):
        """The values of one vesicle, a `vesicles.Vesicle`."""
        return of(self.__dict__, number)

    def each_vesicle(self):
        """Those of all."""
        return [self.vesicle(number) for number in range(self.vesicles)]

    @property
    def has_contrast(self):
        """Whether the viscosity inside any vesicle is another than outside."""
        return any(vesicle.viscosity_contrast != 1 for vesicle in self.each_vesicle())

    @property
    def reach(self):
        """Cells between markers and walls at least, by the delta function."""
        kernel = KERNELS[self.delta]
        wide = self.kink_correction and self.has_contrast
        return kernel.stress_reach if wide else kernel.reach

    @property
    def spacing(self):
        """Sizes dx and dy of a cell."""
        a, b, c, d = self.domain
        return (b - a) / self.stag_grid_x, (d - c) / self.stag_grid_y

    @property
    def line_axis(self):
        """Direction of lines across the box, 0 for x: the first in which it is periodic."""
        return 0 if "x" in self.periodic else 1

    def to_dict(self):
        """Every value and, under ``given``, the sorted names the user gave; fit for JSON."""
        record = {k: list(v) if isinstance(v, tuple) else str(v) if is_own(v) else v
                  for k, v in self.__dict__.items()}
        return dict(record, given=sorted(self.given))


def given_text(record):
    """Option text (name to text) of what the user gave, from a `Settings.to_dict` record."""
    return {name: text_of(record[name]) for name in record["given"]}


def as_given(name, value):
    """An option and its value as the user has given them, with which a message begins."""
    return f"{value.name} {value}" if isinstance(value, Points) else f"-{name} {text_of(value)}"


def text_of(value):
    """The text of a value as one would type it; numbers keep every digit."""
    if hasattr(value, "tolist"):  # numpy's
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (tuple, list)):
        return ",".join(text_of(entry) for entry in value)
    if isinstance(value, float):
        short = re.sub(r"e([+-])0*", "e\\1", f"{value:g}").replace("e+", "e")
        return short if float(short) == value else repr(float(value))
    return str(value)
