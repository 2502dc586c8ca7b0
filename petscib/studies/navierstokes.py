"""Advection: orders, the lid-driven cavity, error against cost, and vesicles with inertia.

Orders in space are against the exact decay of Taylor and Green's vortices in a square, those in
time against the finest step on the same grid: of vortices in a box twice as wide as high, which
advection deforms, and of a vesicle at a Reynolds number of 10.  The cavity stands beside Ghia, Ghia
& Shin (J. Comput. Phys. 48, 1982).  Reynolds numbers of vesicles are rho gamma R^2 / mu with R the
radius of the circle of their area.
"""

import sys

import numpy as np

from ..fluid.flows import FLOWS
from ..scenes import SCENES
from ..schemes.registry import SCHEMES
from . import report
from .campaign import Campaign
from .convergence import rates
from .ellipses import ellipse_axes, even_markers
from .tanktreading import PERIMETER

COLUMNS = ("part", "case", "scheme", "advection", "cells", "x", "quantity", "value", "rate",
           "seconds")
TREATMENTS = "explicit", "implicit"
# Vortices that advection deforms; their top speed is 1.
VORTICES = dict(scene="taylor-green", domain=(0.0, 2.0, 0.0, 1.0), shear_rate=np.pi, mu=0.002,
                fft=True)
VESICLE = dict(scene="inertia", fft=True)
CAVITY = dict(scene="cavity", fft=True)
# Ghia, Ghia & Shin: u over y on the vertical mid-line, v over x on the horizontal one.
GHIA_Y = (0.0547, 0.0625, 0.0703, 0.1016, 0.1719, 0.2813, 0.4531, 0.5, 0.6172, 0.7344, 0.8516,
          0.9531, 0.9609, 0.9688, 0.9766)
GHIA_X = (0.0625, 0.0703, 0.0781, 0.0938, 0.1563, 0.2266, 0.2344, 0.5, 0.8047, 0.8594, 0.9063,
          0.9453, 0.9531, 0.9609, 0.9688)
GHIA = {
    100: ((-0.03717, -0.04192, -0.04775, -0.06434, -0.10150, -0.15662, -0.21090, -0.20581,
           -0.13641, 0.00332, 0.23151, 0.68717, 0.73722, 0.78871, 0.84123),
          (0.09233, 0.10091, 0.10890, 0.12317, 0.16077, 0.17507, 0.17527, 0.05454, -0.24533,
           -0.22445, -0.16914, -0.10313, -0.08864, -0.07391, -0.05906)),
    1000: ((-0.18109, -0.20196, -0.22220, -0.29730, -0.38289, -0.27805, -0.10648, -0.06080,
            0.05702, 0.18719, 0.33304, 0.46604, 0.51117, 0.57492, 0.65928),
           (0.27485, 0.29012, 0.30353, 0.32627, 0.37095, 0.33075, 0.32235, 0.02526, -0.31966,
            -0.42665, -0.51550, -0.39188, -0.33714, -0.27669, -0.21388)),
}
TIMED = {"vortices": ("be", "mbe", "cn"), "vesicle": ("be", "gbe", "gcn")}  # schemes of `in_time`
CAVITY_TIMES = {100: 25.0, 1000: 150.0}  # until when its extremes have settled to four digits
EXTREMES = "u_min", "v_max", "v_min"
WINDOW = 2.0  # strain over which inclination and frequency are averaged


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("navierstokes", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, orders=(16, 32, 64), cavity=((100, 32), (100, 64)), cfls=(0.5, 2, 10),
              reynolds=(1.0, 10.0), grids=(32, 48), strain=6.0)
    else:
        study(campaign)
    return campaign.exit_status


def study(campaign, orders=(32, 64, 128), cavity=((100, 64), (100, 128), (1000, 64), (1000, 128)),
          cfls=(0.5, 0.7, 1, 2, 5, 10, 20), reynolds=(0.1, 1.0, 10.0, 30.0, 100.0),
          reduced_areas=(0.7, 0.9), grids=(48, 96), strain=12.0):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    orders : sequence of int
        Cells across, and as many steps, each twice the one before.
    cavity : sequence of (int, int)
        Reynolds numbers and cells.
    cfls : sequence of float
    reynolds, reduced_areas, grids : sequence
        Of vesicles.
    strain : float
        How far vesicles run.
    """
    records, profiles = [], {}
    for part in (in_space(campaign, orders), in_time(campaign, orders),
                 cost(campaign, max(orders), cfls),
                 vesicles(campaign, reynolds, reduced_areas, grids, strain)):
        records += part
    for reynolds_number, cells in cavity:
        profile, found = lid(campaign, reynolds_number, cells)
        records += found
        profiles[reynolds_number, cells] = profile
    campaign.write_records(COLUMNS, records, _markdown(records))
    _draw(campaign.path("navierstokes.png"), records, profiles)
    return records


def _records(part, key, found, **common):
    """Records over steps or cells, with the observed orders between them."""
    places, values, seconds = zip(*found)
    return [dict(part=part, x=place, quantity=key, value=value, rate=rate, seconds=spent, **common)
            for place, value, spent, rate in zip(
                places, values, seconds, rates(places, values))]


def in_space(campaign, sizes):
    """Largest error of u of decaying vortices on each grid, with dt = h / 2."""
    records, time = [], 1.0
    for advection in TREATMENTS:
        found = []
        for cells in sizes:
            outcome = campaign.run(f"vortices {advection} {cells}^2", dict(
                scene="taylor-green", fft=True, stag_grid_x=cells, advection=advection,
                ts_dt=1 / cells, ts_max_time=time))
            found.append((cells, _exact_error(outcome, time), outcome.seconds))
        records += _records("space", "u", found, case="vortices", scheme="cn",
                            advection=advection)
    return records


def _exact_error(outcome, time):
    if not outcome.finished:
        return None
    u, mu = outcome.final()["u"], SCENES["taylor-green"].settings["mu"]
    rows, columns = u.shape
    x = -1 + 2 * np.arange(columns) / columns
    y = -1 + 2 * (np.arange(rows) + 0.5) / rows
    exact = FLOWS["taylor-green"](x[None], y[:, None], 1.0, (-1.0, 1.0, -1.0, 1.0))[0]
    return float(np.abs(u - exact * np.exp(-2 * mu * np.pi**2 * time)).max())


def in_time(campaign, sizes):
    """Errors against the same scheme's finest step, four times finer than the last."""
    records, finest = [], 4 * max(sizes)
    cases = {
        "vortices": (dict(VORTICES, stag_grid_x=64, ts_max_time=1.0), "u"),
        # At the scene's sigma0 of 1e5 steps resolve no elastic waves, which gcn does not damp.
        "vesicle": (dict(VESICLE, stag_grid_x=32, sigma0=1e3, ts_max_time=1.0), "X"),
    }
    for case, (options, quantity) in cases.items():
        for scheme in TIMED[case]:
            for advection in TREATMENTS:
                made = {steps: campaign.run(f"{case} {scheme} {advection} {steps} steps", dict(
                    options, scheme=scheme, advection=advection, ts_dt=1 / steps))
                    for steps in (*sizes, finest)}
                reference = made.pop(finest)
                found = [(steps, _difference(one, reference, quantity), one.seconds)
                         for steps, one in made.items()]
                records += _records("time", quantity, found, case=case, scheme=scheme,
                                    advection=advection)
    return records


def _difference(outcome, reference, quantity):
    """Largest difference of two finished runs on one grid."""
    if not (outcome.finished and reference.finished):
        return None
    ours, theirs = (one.final()[quantity] for one in (outcome, reference))
    return float(np.abs(ours - theirs).max())


def cost(campaign, cells, cfls):
    """Error and wall seconds of the stepping over the CFL number, for both treatments."""
    base = dict(VORTICES, stag_grid_x=cells, ts_max_time=2.0)
    h, records = 2.0 / cells, []
    reference = campaign.run("vortices, reference", dict(
        base, scheme="cn", advection="explicit", ts_dt=0.125 * h))
    for scheme in ("be", "cn"):
        for advection in TREATMENTS:
            for cfl in cfls:
                outcome = campaign.run(f"vortices {scheme} {advection} CFL {cfl:g}", dict(
                    base, scheme=scheme, advection=advection, ts_dt=cfl * h))
                spent = outcome.steps * outcome.step_seconds if outcome.finished else None
                records.append(dict(
                    part="cost", case="vortices", scheme=scheme, advection=advection,
                    cells=cells, x=cfl, quantity="u", seconds=spent,
                    value=_difference(outcome, reference, "u")))
    return records


def lid(campaign, reynolds, cells):
    """Profiles (y, u, x, v) on the mid-lines of the cavity, and the records of their extremes."""
    outcome = campaign.run(f"cavity Re {reynolds} {cells}^2", dict(
        CAVITY, mu=1 / reynolds, stag_grid_x=cells, ts_dt=4 / cells,
        ts_max_time=CAVITY_TIMES[reynolds]))
    if not outcome.finished:
        return None, []
    found = outcome.final()
    u, v = found["u"][:, cells // 2], found["v"][cells // 2]
    middle = (np.arange(cells) + 0.5) / cells
    values = vertex(u, np.argmin), vertex(v, np.argmax), vertex(v, np.argmin)
    return (middle, u, middle, v), [
        dict(part="cavity", case=f"Re {reynolds}", scheme="be", advection="implicit",
             cells=cells, x=reynolds, quantity=name, value=value, seconds=outcome.seconds)
        for name, value in zip(EXTREMES, values)]


def vertex(values, pick):
    """The extremum of the parabola through the extreme entry and its neighbours."""
    k = pick(values)
    left, middle, right = values[k - 1 : k + 2]
    return float(middle - (right - left) ** 2 / (8 * (left - 2 * middle + right)))


def vesicles(campaign, reynolds, reduced_areas, grids, strain):
    """Mean inclination / pi and frequency over the last strain; grids, and a box twice as wide."""
    records = []
    for reduced in reduced_areas:
        axes = ellipse_axes(reduced, PERIMETER)
        for number in reynolds:
            for half, cells in ((1.0, grids[0]), (1.0, grids[-1]), (2.0, 2 * grids[0])):
                box = (-half, half, -half, half)
                # The middle is a saddle; point-symmetric markers keep the vesicle there.
                outcome = campaign.run(f"V {reduced:g} Re {number:g} box {half:g} {cells}^2", dict(
                    VESICLE, axes=axes, rho=number / (axes[0] * axes[1]), domain=box,
                    markers=even_markers(axes, cells, half), stag_grid_x=cells, ts_dt=1 / 32,
                    ts_max_time=strain))
                for quantity, name, scale in (("inclination / pi", "inclination", np.pi),
                                              ("frequency", "treading_frequency", 1.0)):
                    mean = outcome.mean(name, WINDOW) if outcome.finished else None
                    records.append(dict(
                        part="vesicle", case=f"V {reduced:g}, box {half:g}", scheme="gcn",
                        advection="implicit", cells=cells, x=number, quantity=quantity,
                        value=mean and mean / scale, seconds=outcome.seconds))
    return records


def spread(records, reduced, number, quantity):
    """Value on the finer grid, and the least and largest over grids and boxes; None without any."""
    found = [one for one in records if one["part"] == "vesicle" and one["x"] == number
             and one["quantity"] == quantity and one["case"].startswith(f"V {reduced:g},")
             and one["value"] is not None]
    if not found:
        return None
    values = [one["value"] for one in found]
    small = [one for one in found if one["case"].endswith("box 1")]
    best = max(small or found, key=lambda one: one["cells"])["value"]
    return best, min(values), max(values)


def _series(records, part):
    """Records of a part by what they have in common: keys to lists."""
    found = {}
    for one in records:
        if one["part"] == part:
            key = one["case"], one["scheme"], one["advection"], one["quantity"]
            found.setdefault(key, []).append(one)
    return found


def _reduced(records):
    names = [one["case"] for one in records if one["part"] == "vesicle"]
    return list(dict.fromkeys(float(name.split(",")[0][2:]) for name in names))


def _markdown(records):
    text = ""
    for part, title in (("space", "Largest error of u over the cells across"),
                        ("time", "Largest error over the number of steps in a unit of time"),
                        ("cost", "Error over the CFL number, and seconds of stepping")):
        series = _series(records, part)
        places = [f"{one['x']:g}" for one in next(iter(series.values()))]
        table = [[*key[:3], *(_entry(one) for one in found)] for key, found in series.items()]
        text += f"**{title}**\n\n" + report.markdown_table(
            ["case", "scheme", "advection", *places], table) + "\n"
    table = [[case, f"{one['cells']}^2", name, report.number(one["value"], 4)]
             for (case, _, _, name), found in _series(records, "cavity").items() for one in found]
    text += "**Extremes on the mid-lines of the cavity**\n\n" + report.markdown_table(
        ["case", "cells", "extreme", "value"], table)
    table = []
    for reduced in _reduced(records):
        for number in sorted({one["x"] for one in records if one["part"] == "vesicle"}):
            row = [f"{reduced:g}", f"{number:g}"]
            for quantity in ("inclination / pi", "frequency"):
                row.append(report.with_range(spread(records, reduced, number, quantity)))
            table.append(row)
    return text + ("\n**Vesicles**: finer grid, and in brackets least and largest over grids and "
                   "boxes\n\n") + report.markdown_table(
        ["reduced area", "Re", "inclination / pi", "frequency"], table)


def _entry(one):
    text = report.number(one["value"])
    if one.get("rate") is not None:
        return f"{text} ({one['rate']:.2f})"
    return f"{text} ({report.number(one['seconds'], 2)} s)" if one["part"] == "cost" else text


def _draw(path, records, profiles):
    with report.picture(path, 16, 4.2, columns=4) as (figure, ((profile, time, cost_axis, tilt),)):
        for k, ((reynolds, cells), found) in enumerate(profiles.items()):
            if found is None:
                continue
            y, u, x, v = found
            colour = report.SERIES_COLOURS[k % len(report.SERIES_COLOURS)]
            profile.plot(y, u, color=colour, label=f"Re {reynolds}, {cells}^2")
            profile.plot(x, v, color=colour, linestyle="--")
        for reynolds in dict.fromkeys(number for number, _ in profiles):
            profile.plot(GHIA_Y, GHIA[reynolds][0], "k.", GHIA_X, GHIA[reynolds][1], "k.")
        profile.set(xlabel="y, x", ylabel="u (full), v (broken); dots: Ghia et al.")
        profile.legend()
        for part, axis in (("time", time), ("cost", cost_axis)):
            for (case, scheme, advection, _), found in _series(records, part).items():
                known = [one for one in found if one["value"] and one["seconds"]]
                style = {**SCHEMES[scheme].style,
                         "linestyle": "-" if advection == "implicit" else ":"}
                axis.loglog([one["x"] if part == "time" else one["seconds"] for one in known],
                            [one["value"] for one in known], label=f"{case} {scheme} {advection}",
                            **style)
            if part == "time":  # room for many names above the lines
                axis.set_ylim(top=300 * axis.get_ylim()[1])
            axis.legend(fontsize=7, ncols=2 if part == "time" else 1)
            axis.set(xlabel="steps" if part == "time" else "seconds", ylabel="largest error")
        for k, reduced in enumerate(_reduced(records)):
            numbers = sorted({one["x"] for one in records if one["part"] == "vesicle"})
            found = [(number, spread(records, reduced, number, "inclination / pi"))
                     for number in numbers]
            found = [(number, *one) for number, one in found if one]
            if found:
                number, value, low, high = np.array(found).T
                tilt.errorbar(number, value, (value - low, high - value), capsize=3, marker="o",
                              color=report.SERIES_COLOURS[k], label=f"reduced area {reduced:g}")
                tilt.legend()
        tilt.set(xscale="log", xlabel="Reynolds number", ylabel=r"inclination $\theta/\pi$")


if __name__ == "__main__":
    sys.exit(main())
