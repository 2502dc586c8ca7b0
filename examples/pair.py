"""Two vesicles that pass each other in shear flow: paths of their middles, and the gap."""

import os
import sys

import petscib
from petscib.output.style import BLUE, GREEN, GREY, picture

simulation = petscib.Simulation(sys.argv[1:], scene="pair", fft=True)
start = [X.copy() for X in simulation.membranes]
simulation.run()
table, end = simulation.diagnostics, simulation.membranes

if simulation.comm.rank == 0:
    os.makedirs("out/examples", exist_ok=True)
    with picture("out/examples/pair.png", 9.0, 4.2) as figure:
        left, right = figure.subplots(1, 2)
        for vesicle, colour in enumerate((BLUE, GREEN)):
            left.fill(*start[vesicle].T, fill=False, edgecolor=colour, linestyle=":")
            left.fill(*end[vesicle].T, fill=False, edgecolor=colour)
            left.plot(table[f"centroid_x_{vesicle}"], table[f"centroid_y_{vesicle}"],
                      color=colour, linewidth=0.8)
        left.set(aspect="equal", xlabel="$x$", ylabel="$y$", title="start (dotted) and end")
        right.plot(table["time"], table["min_gap"], color=GREY)
        right.set(xlabel="time $t$", ylabel="smallest gap")
    print(f"smallest gap {table['min_gap'].min():.3g}; see out/examples/pair.png")
