"""A flow of one's own: a stagnation point that also turns, given as a function of x, y and t."""

import os
import sys

import petscib
from petscib.output.style import BLUE, GREY, picture


def spiral(x, y, t):
    """Velocity on the walls and at the start; it must not depend on t, nor have divergence."""
    return 0.6 * x - 0.4 * y, 0.4 * x - 0.6 * y


simulation = petscib.Simulation(
    sys.argv[1:], flow=spiral, axes=(0.2, 0.4), sigma0=1e5, bending=0.01, scheme="gcn",
    delta="bspline43", ts_dt=0.05, ts_max_time=2.0, fft=True)
shapes = [simulation.markers.copy()]
simulation.every(lambda simulation: shapes.append(simulation.markers.copy()), time=0.5)
simulation.run()

fields = simulation.fields()  # collective; whole arrays on rank 0
if simulation.comm.rank == 0:
    os.makedirs("out/examples", exist_ok=True)
    with picture("out/examples/own_flow.png", 5.0, 5.0) as figure:
        axis = figure.subplots()
        axis.streamplot(fields["x"], fields["y"], fields["u"], fields["v"], color=GREY,
                        linewidth=0.6, density=1.2)
        for number, X in enumerate(shapes):
            axis.fill(*X.T, fill=False, edgecolor=BLUE, alpha=0.3 + 0.7 * number / len(shapes))
        axis.set(aspect="equal", xlabel="$x$", ylabel="$y$", title="a vesicle in a spiral flow")
    print(f"{simulation.step} steps; see out/examples/own_flow.png")
