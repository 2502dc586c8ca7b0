"""A vesicle that relaxes in fluid at rest, beside what boundary integrals have found.

Each step yields its row of diagnostics; nothing is written but the picture.
"""

import os
import sys

import numpy as np

import petscib
from petscib.output.style import BLUE, VERMILLION, picture

# Bending energy over that of the circle of the same length: time, value (Stokes flow, walls).
TRUTH = np.array([(0.125, 1.976129), (0.5, 1.85676), (2.0, 1.824945)])

simulation = petscib.Simulation(
    sys.argv[1:], scene="relaxation", scheme="gcn", rho=1e-3, fft=True, ts_rtol=1e-4,
    ts_max_time=2.0)
times, energies = [], []
for row in simulation:
    circle = 2 * np.pi**2 * simulation.settings.bending / row["perimeter"]
    times.append(row["time"])
    energies.append(row["bending_energy"] / circle)

if simulation.comm.rank == 0:
    os.makedirs("out/examples", exist_ok=True)
    with picture("out/examples/relaxation.png", 6.0, 4.0) as figure:
        axis = figure.subplots()
        axis.semilogx(times, energies, color=BLUE, label="petscib")
        axis.plot(*TRUTH.T, "o", color=VERMILLION, label="boundary integrals")
        axis.set(xlabel="time $t$", ylabel="bending energy over the circle's")
        axis.legend()
    print(f"{len(times)} steps; energy ratio at the end {energies[-1]:.4f} (truth 1.8249); "
          "see out/examples/relaxation.png")
