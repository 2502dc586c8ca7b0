"""Every scene by its defaults: a picture each, and an animation of three.

The picture shows speed, streamlines and vorticity at the end, with the membranes.
"""

import os
import sys

from ..output import views
from ..scenes import SCENES
from .campaign import Campaign

ANIMATED = ("tanktreading", "tumbling", "suspension")
COLUMNS = ("scene", "status", "steps", "seconds", "picture")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("gallery", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, tuple(SCENES), ANIMATED[:1], dict(ts_max_steps=3), 60)
    else:
        study(campaign, tuple(SCENES), ANIMATED, {}, 3600)
    return campaign.exit_status


def study(campaign, scenes, animated, words, time_limit):
    """Make the runs and the pictures; returns the names of the pictures by scene.

    Parameters
    ----------
    campaign : Campaign
    scenes, animated : tuple of str
    words : dict
        Options besides.
    time_limit : float
        Seconds a run.
    """
    rows, pictures = [], {}
    for scene in scenes:
        outcome = campaign.run(scene, dict(words, scene=scene, fft=True), time_limit)
        if outcome.finished:
            pictures[scene] = _drawn(campaign, scene, outcome, scene in animated)
        rows.append([scene, outcome.status, outcome.steps, round(outcome.seconds, 1),
                     " ".join(pictures.get(scene, ()))])
    campaign.write(COLUMNS, rows, _markdown(pictures))
    return pictures


def _drawn(campaign, scene, outcome, animated):
    """Draw a scene's pictures under its name; returns the names of the files."""
    draw = (views.plot_fields, views.animate) if animated else (views.plot_fields,)
    names = []
    for path in (one(outcome.folder, campaign.output) for one in draw):
        if path is not None:
            names.append(scene + os.path.splitext(path)[1])
            os.replace(path, campaign.path(names[-1]))
    return names


def _markdown(pictures):
    parts = []
    for scene, names in pictures.items():
        summary = SCENES[scene].summary
        images = "\n\n".join(f"![{scene}]({name})" for name in names)
        parts.append(f"## {scene}\n\n{summary[0].upper()}{summary[1:]}\n\n"
                     f"    ./run -scene {scene} -fft\n\n{images}\n")
    return "\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
