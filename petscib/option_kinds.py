"""Kinds of option values: each turns a text into a value, and says in words what it allows.

A kind has `symbol`, how ``-help`` shows a value; `allowed`, in words what it may be; and
`parse(text)`, which returns the value, or raises a ValueError that says what is wrong.  `Flow`,
`Force` and `Curve` also take what a script gives in place of a text (`petscib.own`).
"""

import math
import re
from dataclasses import dataclass

from .own import Function, Points
from .settings import text_of

# Magnitudes whose powers and quotients a run can hold, in whatever units.
SMALLEST, LARGEST = 1e-60, 1e60
LARGEST_INTEGER = 2**31 - 1  # PETSc's integers have 32 bits unless it was built otherwise


@dataclass(frozen=True)
class Number:
    """A finite number in a range."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    symbol: str = "X"
    noun = "number"
    pattern = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"

    @property
    def allowed(self):
        """What is allowed, in words."""
        bounds = []
        if math.isfinite(self.low):
            bounds.append(("above " if self.open_low else "from ") + text_of(self.low))
        if math.isfinite(self.high) and self.high != LARGEST_INTEGER:
            bounds.append(("and below " if self.open_high else "to ") + text_of(self.high))
        return " ".join([self.noun, *bounds])

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        # float() and int() also take "1_000" and foreign digits, which no one means.
        if not re.fullmatch(self.pattern, text, re.ASCII):
            raise ValueError(f"not a {self.noun}")
        value = self.convert(text)
        if not math.isfinite(value):
            raise ValueError("too large")
        below = value <= self.low if self.open_low else value < self.low
        above = value >= self.high if self.open_high else value > self.high
        if below or above:
            raise ValueError("out of range")
        self._check_magnitude(value)
        return value

    def _check_magnitude(self, value):
        if abs(value) > LARGEST:
            raise ValueError(f"its magnitude is above {text_of(LARGEST)}")
        if self.low == 0 and self.open_low and value < SMALLEST:
            raise ValueError(f"its magnitude is below {text_of(SMALLEST)}")

    def convert(self, text):
        """The number of a text of the right form."""
        return float(text)


@dataclass(frozen=True)
class Whole(Number):
    """A whole number in a range."""

    low: int = 0
    high: int = LARGEST_INTEGER
    symbol: str = "N"
    noun = "whole number"
    pattern = r"[+-]?\d{1,18}"

    def convert(self, text):
        """The number of a text of the right form."""
        return int(text)


@dataclass(frozen=True)
class Numbers:
    """A comma list of numbers, one for each of the names."""

    names: tuple[str, ...]
    each: Number = Number()

    @property
    def symbol(self):
        """How -help shows a value."""
        return ",".join(self.names)

    @property
    def allowed(self):
        """What is allowed, in words."""
        return f"{self.symbol}, each a {self.each.allowed}"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        parts = text.split(",")
        if len(parts) != len(self.names):
            raise ValueError(f"not {len(self.names)} values with commas between (and no blanks)")
        return tuple(self.each.parse(part) for part in parts)


@dataclass(frozen=True)
class Choice:
    """One of several names, in any case, as PETSc reads its own."""

    names: tuple[str, ...]
    symbol: str = "NAME"

    @property
    def allowed(self):
        """What is allowed, in words."""
        return ", ".join(self.names)

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        if text.lower() not in self.names:
            raise ValueError("no such choice")
        return text.lower()


class SceneName(Choice):
    """A scene's name, or a file of the user's that has one."""

    @property
    def allowed(self):
        """What is allowed, in words."""
        return super().allowed + ", or FILE.py with a scene of one's own"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        return text if text.lower().endswith(".py") else super().parse(text)


class OrFunction:
    """What another kind takes, or from a script a function (x, y, t); comes before that kind."""

    def parse(self, text):
        """The value of a text or a callable; a ValueError says what is wrong with it."""
        if callable(text):
            return text if isinstance(text, Function) else Function(text, self.option)
        if text.startswith("function "):
            raise ValueError("known only to the script that has it")
        return super().parse(text)


class Flow(OrFunction, Choice):
    """A flow's name, or from a script a function (x, y, t) -> (u, v)."""

    option = "flow"


class Force(OrFunction, Numbers):
    """A uniform force, or from a script a function (x, y, t) -> (fx, fy)."""

    option = "body_force"


@dataclass(frozen=True)
class Flag:
    """A switch in PETSc's spellings; the option alone means true."""

    symbol: str = "[true]"
    allowed = "true/false, yes/no, on/off, 1/0"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        if text.lower() in ("", "true", "yes", "on", "1"):
            return True
        if text.lower() in ("false", "no", "off", "0"):
            return False
        raise ValueError("not a switch's value")


@dataclass(frozen=True)
class Path:
    """A file or directory name."""

    symbol: str = "PATH"
    allowed = "a path"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        return text


class Curve(Path):
    """A file of points, or from a script an array of them."""

    def parse(self, text):
        """The value of a text or an array."""
        return text if isinstance(text, (str, Points)) else Points(text)
