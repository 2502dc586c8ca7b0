"""A run in two parts, by way of a checkpoint, is the run in one part."""

import os
import sys

import numpy as np

import petscib
from petscib.output.style import BLUE, VERMILLION, picture

OPTIONS = dict(scene="tanktreading", stag_grid_x=32, fft=True, ts_max_time=2.0)
os.makedirs("out/examples", exist_ok=True)
CHECKPOINT = "out/examples/restart.h5"

first = petscib.Simulation(sys.argv[1:], **OPTIONS)
for row in first:
    if row["time"] >= 0.5 * first.settings.ts_max_time:
        break
first.save(CHECKPOINT)  # and go on
first.run()

# Everything is in the file, the options too; those given now win.
second = petscib.Simulation(restart=CHECKPOINT)
second.run()

if first.comm.rank == 0:
    same = np.array_equal(first.markers, second.markers)
    with picture("out/examples/restart.png", 6.0, 4.0) as figure:
        axis = figure.subplots()
        for simulation, colour, style in ((first, BLUE, "-"), (second, VERMILLION, "--")):
            table = simulation.diagnostics
            axis.plot(table["time"], table["inclination"] / np.pi, style, color=colour)
        axis.set(xlabel="time $t$", ylabel=r"inclination $\theta/\pi$",
                 title="one run (blue), and one from its middle on")
    print(f"the same to the last digit: {same}; see out/examples/restart.png")
