"""What acts at the markers: interpolation, area projector, kink correction, rates of stress."""


class MarkerOperators:
    """The membranes' linear operators in one configuration.  Collective where J is involved.

    With w the stage velocity of the fluid, f the forces on the markers and m the stresses of the
    membranes (see `petscib.membranes.laws`), the markers move with

        U = Pi J w + K f,    f = - C^T m,    m = m0 + (theta dt) C U.

    Parameters
    ----------
    interpolation : Interpolation
        J.
    rates : scipy.sparse.csr_matrix, shape (R, 2 M)
        C; on rank 0, without rows and columns elsewhere.
    slip : Slip or None
        K; None leaves the kink uncorrected.
    projector : AreaProjector or None
        Pi; None for the identity.
    """

    def __init__(self, interpolation, rates, slip=None, projector=None):
        self.interpolation = interpolation
        self.rates = rates
        self._transposed = rates.T  # a matrix of its own, dear to make beside its products
        self.slip = slip
        self.projector = projector

    def force(self, stress):
        """The force - C^T m on each marker, shape (M, 2); not per ds."""
        return (self._transposed @ -stress).reshape(-1, 2)

    def rate(self, velocity):
        """Rate C U of the stresses for marker velocities (M, 2)."""
        return self.rates @ velocity.ravel()

    def project(self, values):
        """Pi q for values (M, 2) at the markers."""
        return values if self.projector is None else self.projector.project(values)

    def slip_velocity(self, force):
        """K f for forces (M, 2) on the markers; zero without the correction."""
        return 0.0 if self.slip is None else self.slip.velocity(force)

    def velocity(self, stage):
        """U of a solved stage: (M, 2) on rank 0, (0, 2) elsewhere.  Collective."""
        velocity = self.interpolate(stage.velocity)
        if stage.stress is None:
            return velocity
        return velocity + self.slip_velocity(self.force(stage.stress))

    def interpolate(self, velocity):
        """Pi J w: (M, 2) on rank 0, (0, 2) elsewhere.  Collective."""
        return self.project(self.interpolation.interpolate(velocity))

    def spread_add(self, force, vector):
        """Add J^T Pi f / (dx dy), the force per area, to a vector over all faces.  Collective."""
        self.interpolation.spread_add(self.project(force), vector)
