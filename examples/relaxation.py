"""A vesicle that relaxes in fluid at rest, beside what boundary integrals have found.

Each step yields its row of diagnostics; nothing is written but the picture.
"""

import os
import sys

import petscib
from petscib.output.style import BLUE, VERMILLION, picture
from petscib.studies.reference import RELAXATION  # of axes (0.2, 0.5), by time

simulation = petscib.Simulation(
    sys.argv[1:], scene="relaxation", scheme="gcn", rho=1e-3, fft=True, ts_rtol=1e-4,
    ts_max_time=2.0)
times, energies = [], []
for row in simulation:
    times.append(row["time"])
    energies.append(row["bending_energy"])

if simulation.comm.rank == 0:
    truth = [(time, found["energy"]) for time, found in RELAXATION.items() if time <= times[-1]]
    os.makedirs("out/examples", exist_ok=True)
    with picture("out/examples/relaxation.png", 6.0, 4.0) as figure:
        axis = figure.subplots()
        axis.semilogx(times, energies, color=BLUE, label="petscib")
        axis.plot(*zip(*truth), "o", color=VERMILLION, label="boundary integrals")
        axis.set(xlabel="time $t$", ylabel="bending energy")
        axis.legend()
    print(f"{len(times)} steps; bending energy {energies[-1]:.5f} at t = {times[-1]:g}; "
          "see out/examples/relaxation.png")
