"""A sweep over a parameter: inclination and treading frequency over the reduced area."""

import os
import sys

import numpy as np

import petscib
from petscib.output.style import BLUE, VERMILLION, picture

SHORT = 0.15, 0.25, 0.35, 0.45  # half axes; the long one is 0.5
found = []
for short in SHORT:
    with petscib.Simulation(
            sys.argv[1:], scene="tanktreading", axes=(short, 0.5), stag_grid_x=32,
            ts_max_time=4.0, fft=True) as simulation:
        row = simulation.run()["last_row"]
        comm = simulation.comm
    reduced = 4 * np.pi * row["area"] / row["perimeter"] ** 2
    found.append((reduced, row["inclination"] / np.pi, row["treading_frequency"]))

if comm.rank == 0:
    reduced, inclination, frequency = np.array(found).T
    os.makedirs("out/examples", exist_ok=True)
    with picture("out/examples/sweep.png", 8.0, 3.4) as figure:
        left, right = figure.subplots(1, 2)
        left.plot(reduced, inclination, "o-", color=BLUE)
        left.set(xlabel="reduced area", ylabel=r"inclination $\theta/\pi$")
        right.plot(reduced, frequency, "o-", color=VERMILLION)
        right.set(xlabel="reduced area", ylabel="treading frequency")
    print("see out/examples/sweep.png")
