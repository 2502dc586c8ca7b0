"""Fast direct solvers of the fluid's constant-coefficient systems on the whole box.

On a uniform box the eigenvectors of the difference operators are sines, cosines and Fourier modes,
so that transforms along both directions make the systems diagonal, or nearly so: solves are exact
to round-off, in O(N log N) operations.  They are fastest when the cells have small prime factors.

============  ===================================================================
bases         the transforms of one grid line, and which of them belong to which field
slabs         complete grid lines shared out over the ranks
diagonal      rho / (theta dt) - mu Laplacian of the velocity, and the Laplacian of the pressure
windows       forces and velocities near a membrane only
stream        the coupled system as one for the stream function
saddle_point  the coupled system
============  ===================================================================
"""
