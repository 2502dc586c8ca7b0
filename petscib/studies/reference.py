"""Reference values of other methods, for the study `truth` and for tests.

Spectral boundary integrals, converged to the digits given: inextensible membranes with bending
rigidity 0.01 in Stokes flow (no inertia) of viscosity 1, in the box [-1, 1]^2.  Angles are those of
the long axis, over pi; a frequency is 2 pi over the integral of dl / u_tau.
"""

# Ellipses (b, 0.5), upright in the middle between walls that move with (y, 0), shear rate 1: steady
# inclination and treading frequency, and inclination at times before.
TREADING = {
    0.1: {"reduced_area": 0.4472, "inclination": 0.08474, "frequency": 0.20973},
    0.25: {"reduced_area": 0.8412, "inclination": 0.16646, "frequency": 0.39997},
    0.4: {"reduced_area": 0.9816, "inclination": 0.22326, "frequency": 0.48837},
}
TURNING = {
    0.1: {0.5: 0.34288, 1: 0.24139, 2: 0.15197, 3: 0.11799, 4: 0.10232, 6: 0.09009, 10: 0.08529,
          15: 0.08477},
    0.25: {0.5: 0.30669, 1: 0.22056, 2: 0.17588, 3: 0.16823, 4: 0.1668},
}

# An ellipse (0.2, 0.5) in fluid at rest, by time: bending energy, half sizes along x and y, and
# where it crosses the x-axis.
RELAXATION = {
    0.125: {"energy": 0.1695, "half_width": 0.196093, "half_height": 0.493113, "waist": 0.196093},
    0.5: {"energy": 0.159261, "half_width": 0.18747, "half_height": 0.486414, "waist": 0.18747},
    2.0: {"energy": 0.156532, "half_width": 0.184389, "half_height": 0.48021, "waist": 0.17993},
    10.0: {"energy": 0.156526, "half_width": 0.184539, "half_height": 0.479862, "waist": 0.179578},
}

# Least bending energy over that of the circle of the same length, by reduced area.
LEAST_ENERGY = {0.95: 1.1522, 0.9: 1.3088, 0.8: 1.6368, 0.7: 1.9868, 0.65: 2.1712, 0.6: 2.3624,
                0.5: 2.7679, 0.45: 2.9836}

# The same with another viscosity inside: steady inclination and treading frequency by axes and
# contrast; the contrast from which on they tumble; and angles of (0.1, 0.3) at contrast 15, upright
# at first, by time, with the times when it is level and when it has made half a turn.
CONTRAST = {
    (0.25, 0.5): {0.2: (0.184406, 0.459565), 1.0: (0.166465, 0.39997), 2.0: (0.148432, 0.344144),
                  5.0: (0.1104, 0.242581)},
    (0.1, 0.3): {1.0: (0.120202, 0.3051)},
}
CRITICAL = {(0.25, 0.5): 18.287, (0.1, 0.3): 4.772}
TUMBLING = {
    "angles": {1.0: 0.25441, 2.0: 0.14508, 3.0: 0.0912, 4.0: 0.0577, 5.0: 0.033, 6.0: 0.01223,
               7.0: -0.00729, 8.0: -0.02768, 9.0: -0.05146, 10.0: -0.08291},
    "level": 6.626, "half_turn": 13.207,
}

# Without walls, an ellipse 1:3 of bending rigidity 0.01 gamma R^3: inclination (not over pi) by
# contrast, and the contrast from which on it tumbles; published values agree to 1e-3.
FREE = {0.5: 0.43543, 1.0: 0.36776, 2.0: 0.26155, 3.0: 0.1682, 4.0: 0.03888}
FREE_CRITICAL = 4.079
