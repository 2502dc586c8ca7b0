"""The ways a run ends early, each with one line for the user and its own exit status."""


class _OneLine(Exception):
    """An error whose message stays on one line, whatever text of the user's it quotes."""

    def __init__(self, message):
        super().__init__("".join(letter if letter.isprintable() else "?" for letter in message))


class InputError(_OneLine):
    """What the user asked for cannot be run: one line, exit status 2."""

    exit_status = 2


class SolveError(_OneLine):
    """A solve failed, or the physics did: one line, exit status 3."""

    exit_status = 3


class OutputError(_OneLine):
    """Results could not be written, as on a full disk: one line, exit status 3."""

    exit_status = 3
