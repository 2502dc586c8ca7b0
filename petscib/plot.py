"""``python -m petscib.plot out/DIR``: pictures of a run from its files, finished or running."""

import argparse
import os
import sys

from .output import plots, views


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        """End with one line, as petscib does for its own options."""
        self.exit(2, f"petscib.plot: {message}\n")


def main(arguments=None):
    """Draw what the files of a folder allow and print the paths written.

    Returns
    -------
    int
        Exit status: 0, or 2 if nothing could be drawn.
    """
    parser = _Parser(prog="python -m petscib.plot", description=__doc__, allow_abbrev=False)
    parser.add_argument("folder", help="folder of a run")
    parser.add_argument("-o", dest="output", metavar="DIR", help="where to write (default: there)")
    parser.add_argument("-animate", action="store_true", help="also write animation.gif")
    parser.add_argument("-mp4", action="store_true", help="with -animate: animation.mp4 instead")
    options = parser.parse_args(arguments)
    if not os.path.isdir(options.folder):
        parser.error(f"no such folder: {options.folder}")
    if options.mp4 and not options.animate:
        parser.error("-mp4 needs -animate")
    try:
        if options.output is not None:
            os.makedirs(options.output, exist_ok=True)
        paths = plots.plot_all(options.folder, options.output)
        if options.animate:
            paths.append(views.animate(options.folder, options.output, options.mp4))
    except ImportError as error:
        parser.error(f"cannot draw, {error.name} is not installed")
    except (OSError, ValueError, RuntimeError) as error:
        parser.error(error)
    written = [path for path in paths if path is not None]
    if not written:
        parser.error(f"{options.folder} has no data to draw (diagnostics.csv, outlines.csv, *.h5)")
    print("\n".join(written))
    return 0


if __name__ == "__main__":
    sys.exit(main())
