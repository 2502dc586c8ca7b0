"""A vesicle whose inside is more viscous than the fluid around tumbles: its angle over time."""

import os
import sys

import numpy as np

import petscib
from petscib.output.style import BLUE, VERMILLION, picture

curves = {}
for contrast, colour in ((1.0, BLUE), (15.0, VERMILLION)):
    simulation = petscib.Simulation(
        sys.argv[1:], scene="tumbling", stag_grid_x=48, ts_dt=0.1, ts_max_time=16.0, fft=True,
        viscosity_contrast=contrast)
    simulation.run()
    table = simulation.diagnostics
    curves[contrast] = colour, table["time"], 2 * table["turns"]
    simulation.close()

if simulation.comm.rank == 0:
    os.makedirs("out/examples", exist_ok=True)
    with picture("out/examples/tumbling.png", 6.0, 4.0) as figure:
        axis = figure.subplots()
        for contrast, (colour, time, angle) in curves.items():
            axis.plot(time, angle, color=colour, label=f"contrast {contrast:g}")
        axis.set(xlabel="time $t$", ylabel=r"angle $\theta/\pi$, counted on")
        axis.legend()
    print("half turns:", *(f"{np.ptp(angle):.2f}" for _, _, angle in curves.values()),
          "; see out/examples/tumbling.png")
