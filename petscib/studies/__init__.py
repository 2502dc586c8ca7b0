"""Studies: campaigns of runs that reproduce the paper and measure the schemes.

``python -m petscib.studies.NAME`` makes one, a NAME of `__main__.STUDIES`, and
``python -m petscib.studies`` all; ``-quick``, ``-output DIR``, ``-cells N,...`` and ``-ranks N``
are their options.  Every entry is an ordinary petscib run in a process of its own, whose command is
recorded in ``runs.csv``; a study started again repeats only what is missing.  The studies
themselves never start MPI, so that they can start jobs that do.
``python -m petscib.studies.bench`` is the benchmark of a step, measured anew each time.
"""
