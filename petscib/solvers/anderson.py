"""Anderson acceleration of a fixed-point iteration."""

import numpy as np


class Anderson:
    """Next guess from the last guesses x and images g(x) (Walker & Ni 2011, with QR left to lstsq).

    Not collective: the arrays live on one rank; empty ones are handed through.

    Parameters
    ----------
    depth : int
        Earlier differences in use; 0 gives the plain iteration.
    """

    def __init__(self, depth):
        self.depth = depth
        self._images, self._residuals = [], []

    def next(self, guess, image):
        """The guess to follow, an array of the shape of `image`."""
        self._images.append(image.ravel())
        self._residuals.append((image - guess).ravel())
        del self._images[: -self.depth - 1], self._residuals[: -self.depth - 1]
        if len(self._images) < 2 or not image.size:
            return image
        images = np.diff(self._images, axis=0).T
        residuals = np.diff(self._residuals, axis=0).T
        weights = np.linalg.lstsq(residuals, self._residuals[-1], rcond=1e-12)[0]
        return image - (images @ weights).reshape(image.shape)
