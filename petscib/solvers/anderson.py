"""Anderson acceleration of a fixed-point iteration."""

import numpy as np

DEPENDENT = 1e-12  # a change that all but this part of is in earlier ones tells nothing new


class Anderson:
    """Next guess from the last guesses x and images g(x) (Walker & Ni 2011, type II).

    For g linear this is the minimal residual method for x - g(x) = 0.  Changes of the residual
    are kept orthonormal, each with the change of the guess that makes it.

    Parameters
    ----------
    depth : int
        Earlier changes in use; 0 gives the plain iteration.
    total : callable, optional
        Sums an array over the ranks, where each holds a part of x; collective then.  By default x
        lives on one rank, and empty arrays elsewhere are handed through.
    """

    def __init__(self, depth, total=lambda values: values):
        self.depth, self.total = depth, total
        self._guess = None
        self._moves, self._changes = [], []

    def next(self, guess, image):
        """The guess to follow, an array of the shape of `image`."""
        residual = (image - guess).ravel()
        if self._guess is not None and self.depth:
            self._keep(guess.ravel() - self._guess, residual - self._residual)
        self._guess, self._residual = guess.ravel().copy(), residual
        best = image.ravel().copy()
        for move, change, weight in zip(self._moves, self._changes, self._parts(residual)):
            best -= weight * (move + change)
        return best.reshape(image.shape)

    def _parts(self, residual):
        """Components of a residual along the changes."""
        if not self._changes:
            return []
        return self.total(np.array([change @ residual for change in self._changes]))

    def _keep(self, move, change):
        size = self._norm(change)
        for _ in range(2):  # the second time against the round-off of the first
            for other, kept, weight in zip(self._moves, self._changes, self._parts(change)):
                move = move - weight * other
                change = change - weight * kept
        left = self._norm(change)
        if left <= DEPENDENT * size:
            return
        self._moves.append(move / left)
        self._changes.append(change / left)
        del self._moves[: -self.depth], self._changes[: -self.depth]

    def _norm(self, values):
        return float(np.sqrt(self.total(np.array([values @ values]))[0]))
