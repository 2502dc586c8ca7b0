"""A vesicle in shear flow, from a script: run it, follow it, draw it.

``python examples/shear.py``, or ``mpiexec -n 2 python examples/shear.py``.
"""

import sys

import petscib

# Options are keywords; words of the command line win over them, so that
# `python examples/shear.py -stag_grid_x 32 -ts_max_time 1` is a quick look.
simulation = petscib.Simulation(
    sys.argv[1:], scene="tanktreading", fft=True, output="out/examples/shear")


@simulation.every(time=2.0)
def tell(simulation):
    """Called on all ranks; rank 0 has the numbers that it prints."""
    if simulation.comm.rank == 0:
        row = simulation.last_row
        print(f"t = {row['time']:.3g}: inclination {row['inclination']:.4f}, "
              f"area off by {row['area_error']:.1e}")


simulation.run()  # leaves tables, checkpoints and pictures in the output folder
if simulation.comm.rank == 0:
    print(f"pictures, such as outlines.png, are in {simulation.settings.output}")
