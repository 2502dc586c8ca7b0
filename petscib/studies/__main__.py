"""``python -m petscib.studies [-quick] [-output DIR] [-cells N,...] [-ranks N]``: all studies."""

import argparse
import importlib
import os
import sys

from .campaign import add_options

STUDIES = ("truth", "defaults", "tolerance", "workprecision", "convergence", "maxstep", "cputime",
           "tanktreading", "stability", "iterations", "navierstokes", "cylinder",
           "vesicles", "contrast", "gallery")


def main(arguments=None):
    """Run all studies, each in its subfolder of the output folder; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m petscib.studies", description=__doc__,
                                     allow_abbrev=False)
    add_options(parser)
    given = parser.parse_args(arguments)
    status = 0
    for name in STUDIES:
        words = ["-ranks", str(given.ranks), *(["-quick"] if given.quick else [])]
        if given.cells:
            words += ["-cells", ",".join(map(str, given.cells))]
        words += ["-output", os.path.join(given.output or os.path.join("out", "studies"), name)]
        status = max(status, importlib.import_module(f".{name}", __package__).main(words))
    return status


if __name__ == "__main__":
    sys.exit(main())
