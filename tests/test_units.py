"""The same run in other units: the numbers differ, the run does not."""

import numpy as np
import pytest
import runs

from petscib import options
from petscib.output import tables
from petscib.settings import text_of

# Length, time and mass of the run's units, in those of another system: the first has 1 for all.
SYSTEMS = {
    "SI, of micrometres": (1e-5, 1e-3, 1e-12),
    "large and slow": (40.0, 7.3, 1.0),
    "small and quick": (3e-4, 0.1, 2e-9),
    "heavy": (1.0, 1.0, 1e6),
}
DIMENSIONS = {  # of length, time, mass
    "domain": (1, 0, 0), "axes": (1, 0, 0), "center": (1, 0, 0),
    "rho": (-2, 0, 1), "mu": (0, -1, 1), "shear_rate": (0, -1, 0),
    "sigma0": (1, -2, 1), "bending": (3, -2, 1), "ts_max_time": (0, 1, 0),
}
TANK = dict(domain=(-1.0, 1.0, -1.0, 1.0), axes=(0.25, 0.5), center=(0.0, 0.0), rho=1.0, mu=1.0,
            sigma0=1e5, bending=0.01, ts_max_time=0.3, stag_grid_x=24, angle=20.0, fft=True)
CASES = {
    "flow, mbe": dict(TANK, scene="tanktreading", scheme="mbe", shear_rate=1.0),
    "flow, gcn": dict(TANK, scene="tanktreading", scheme="gcn", shear_rate=1.0,
                      ts_max_time=1.2),
    "rest, mbe, GAMG": dict(TANK, scene="stiff", scheme="mbe", fft=False),
    "elastic, be": dict(TANK, scene="elastic", scheme="be", sigma0=10.0, bending=0.0,
                        rest_length=0.5),
}


def in_units(case, units):
    """Option texts of a case in other units."""
    texts = {}
    for name, value in case.items():
        factor = factor_of(units, *DIMENSIONS.get(name, (0, 0, 0)))
        if name in DIMENSIONS:
            value = tuple(factor * x for x in value) if isinstance(value, tuple) \
                else factor * value
        texts[name] = text_of(value)
    return texts


def factor_of(units, *powers):
    return float(np.prod([unit**power for unit, power in zip(units, powers)]))


@pytest.mark.parametrize("name", CASES)
def test_runs_agree_in_all_units(tmp_path, name, monkeypatch):
    """Positions, velocities, energies and the default time step, to 1e-10 of their size."""
    monkeypatch.setattr(runs, "SMALL", {"monitor": "none", "plot": "no"})
    found = {}
    for system, units in {"own": (1.0, 1.0, 1.0), **SYSTEMS}.items():
        folder = tmp_path / system.replace(" ", "_").replace(",", "")
        simulation = runs.prepare(folder, **in_units(CASES[name], units))
        if not CASES[name]["fft"]:  # an iteration more or less must not show
            scheme = simulation.scheme
            for ksp in scheme.system._iteration.ksp, scheme.projection.poisson.ksp:
                ksp.setTolerances(rtol=1e-13)
        simulation.run()
        simulation.destroy()
        length, time, mass = units
        arrays = runs.arrays(folder / "final.h5")
        rows = tables.read(folder / "diagnostics.csv")
        found[system] = {
            "X": arrays["vesicle_0/X"] / length,
            "u": arrays["fluid/u"] * (time / length),
            "v": arrays["fluid/v"] * (time / length),
            "dt": rows["dt"][1:] / time,
            "energy": rows["energy"] / factor_of(units, 2, -2, 1),
        }
    own = found.pop("own")
    assert len(own["dt"]) > 2 and abs(own["u"]).max() > 0.01
    for system, one in found.items():
        for quantity, values in own.items():
            np.testing.assert_allclose(one[quantity], values, rtol=0,
                                       atol=1e-10 * abs(values).max(),
                                       err_msg=f"{quantity}, {system}")


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("units", SYSTEMS.values())
def test_the_default_time_step_is_a_time(name, units):
    own = {key: text_of(value) for key, value in CASES[name].items()}
    expected = options.read(own).ts_dt
    assert options.read(in_units(CASES[name], units)).ts_dt == pytest.approx(
        units[1] * expected, rel=1e-12)
