"""Time steps by a tolerance: the local error, what it decides, and whole runs."""
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from petsc4py import PETSc
from runs import assert_same_run, comm, prepare, rows, run

from petscib import options, schemes
from petscib.errors import InputError, SolveError
from petscib.localerror import PATH, TIMES, LocalError, prediction
from petscib.membranes.curves import Curves
from petscib.problem import State, Step
from petscib.schemes.history import expected, remembered
from petscib.stepsize import LARGEST_FACTOR, SETTLED, SMALLEST_FACTOR, StepSize

ANGLES = 2 * np.pi * np.arange(60) / 60
CIRCLE = np.stack((np.cos(ANGLES), np.sin(ANGLES)), axis=1)
RELAXING = {"scene": "relaxation", "axes": "0.2,0.5", "stag_grid_x": "24", "fft": "yes",
            "ts_max_time": "0.5"}


@pytest.mark.parametrize("count", [1, 2, 3])
def test_predictions_are_exact_for_polynomials_at_uneven_times(count):
    times = np.array([0.0, 0.3, 0.35])[:count]
    factors = np.random.default_rng(3).random((count, 5, 2))

    def there(time):
        return np.tensordot(np.asarray(time) ** np.arange(count), factors, axes=1)

    path = np.stack([there(time) for time in times])
    np.testing.assert_allclose(prediction(times, path, 1.1), there(1.1), rtol=1e-12)


def measured(path, times, order):
    """Errors, relative to size, and orders of the steps along a path of markers."""
    problem = SimpleNamespace(
        membranes=SimpleNamespace(curves=Curves([30, 30], [1.0, 1.0])),
        grid=SimpleNamespace(comm=PETSc.COMM_SELF))
    found, history = [], {}
    for k in range(len(times) - 1):
        start = State(k, times[k], None, None, path(times[k]), None, history)
        end = State(k + 1, times[k + 1], None, None, path(times[k + 1]), None)
        step = Step(times[k + 1] - times[k], 1.0, start, end, None)
        found.append(LocalError(problem, order).measure(step))
        history = end.history
    return found


def test_the_local_error_is_that_of_the_scheme():
    # Two circles of radius 1 and 2; marker k of the small one moves by t^3, the others by less.
    base = np.concatenate((CIRCLE[::2], 2 * CIRCLE[::2] + 9))
    shift = np.zeros_like(base)
    shift[7] = (0.006, 0.008)
    times = [0.0, 0.1, 0.2, 0.4]
    size = 60 * np.sin(np.pi / 30) / (2 * np.pi)
    unit = 0.01 / size
    curved = measured(lambda t: base + t**2 * shift, times, 1)
    # Backward Euler's is dt^2 X'' / 2, X'' = 2; the first step has only its length to go by.
    assert curved[0] == (pytest.approx(0.1**2 / 2 * unit, rel=1e-3), 0)
    assert curved[1] == (pytest.approx(0.1**2 * unit, rel=1e-3), 1)
    assert curved[2] == (pytest.approx(0.2**2 * unit, rel=1e-3), 1)
    # Crank-Nicolson's is dt^3 X''' / 12, and none for a parabola.
    cubic = measured(lambda t: base + t**3 * shift, [*times, 0.6], 2)
    assert cubic[3] == (pytest.approx(0.2**3 / 2 * unit, rel=1e-3), 2)
    assert measured(lambda t: base + t**2 * shift, [*times, 0.6], 2)[3][0] < 1e-13
    # On the circle of twice the size it counts half.
    other = np.roll(shift, 30, axis=0)
    assert measured(lambda t: base + t**2 * other, times, 1)[1][0] == pytest.approx(
        curved[1][0] / 2, rel=1e-3)


def test_what_is_expected_of_a_stage_is_linear_in_time():
    history = {}
    for time in (0.1, 0.4, 0.45):
        history = remembered(history, time, stress=np.array([2 + 3 * time, -time]))
    expectation = expected(history, "stress", 1.0, np.zeros(2))
    np.testing.assert_allclose(expectation, [5.0, -1.0], rtol=1e-13)
    assert (expected({}, "stress", 1.0, np.ones(2)) == 1).all()


def test_the_time_step_follows_the_error():
    step = StepSize(1.0, rtol=1e-4)
    assert step.allows(1e-4) and not step.allows(1.1e-4) and StepSize(1.0).allows(None)
    # An error 1000 times too large, of a step of second order: halved four times at once.
    assert step.repeat(1.0, 0.1, 2) and step.dt == 1 / 16
    for _ in range(SETTLED):
        assert step.dt == 1 / 16
        step.accept(1e-4 / 8 * 0.4, 2)
    assert step.dt == 1 / 8
    for _ in range(9):
        step.accept(1e-4 / 8 * 0.6, 2)  # twice the step would be just within the tolerance
    assert step.dt == 1 / 8
    # The last step of a run may be any part of one; what follows is a power of two again.
    assert step.repeat(0.09, 2e-4, 1) and step.dt == 1 / 32
    for _ in range(99):
        step.accept(0.0)
    assert step.dt == LARGEST_FACTOR
    assert not step.repeat(1.0, 1e20, 1)
    assert not StepSize(1.0, rtol=1e-4).reject(1.0)  # a failure is another matter
    while step.repeat(step.dt, 2e-4, 1):
        pass
    assert step.dt == SMALLEST_FACTOR


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("scheme, tolerance, most", [("gcn", 1e-4, 60), ("mbe", 2e-4, 60)])
def test_a_run_by_tolerance(tmp_path, scheme, tolerance, most):
    run(tmp_path / "run", scheme=scheme, ts_rtol=str(tolerance), ts_dt="0.03", **RELAXING)
    found = rows(tmp_path / "run")
    dt, error = found["dt"][1:], found["local_error"][1:]
    assert found["time"][-1] == pytest.approx(0.5, rel=1e-12) and 8 < len(dt) < most
    assert (error <= tolerance).all() and error[1:].max() > tolerance / 20
    # Two steps may share the end, so that neither is very short.
    powers = np.log2(dt[:-2] / 0.03)
    assert dt[-1] >= 0.5 * dt[-3] or dt[-2] == dt[-3]
    np.testing.assert_allclose(powers, np.round(powers), atol=1e-10)
    # It has short steps near its start, and ends with long ones.
    assert dt.min() < 0.03 and dt[:-1].max() >= 4 * dt.min() and np.diff(powers).max() == 1


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("scheme", ["gcn", "mbe"])
def test_a_restart_by_tolerance_is_the_uninterrupted_run(tmp_path, scheme):
    words = {**RELAXING, "scheme": scheme, "ts_rtol": "1e-4", "ts_dt": "0.03",
             "checkpoint_every": "5", "checkpoint_keep": "99", "sigma0": "1e3"}
    run(tmp_path / "whole", **words)
    file = tmp_path / "whole" / "checkpoint-00000005.h5"
    with h5py.File(file) as saved:
        assert saved.attrs["dt"] < 0.03 and saved["history"].attrs["stage_time"] > 0
        path, times = saved["history"][PATH], saved["history"][TIMES]
        assert path.shape[0] == len(times) == {"gcn": 3, "mbe": 2}[scheme]
    run(tmp_path / "again", restart=str(file))
    comm.Barrier()
    assert_same_run(tmp_path / "whole", tmp_path / "again")


def test_a_later_end_goes_on_with_the_time_step_reached(tmp_path):
    words = {**RELAXING, "scheme": "gcn", "ts_rtol": "1e-4", "ts_dt": "0.03"}
    run(tmp_path / "run", **words, ledger="error")
    reached = rows(tmp_path / "run")["dt"][-2]
    run(tmp_path / "run", restart="latest", ts_max_time="1.5", output=str(tmp_path / "run"))
    found = rows(tmp_path / "run")
    assert found["time"][-1] == pytest.approx(1.5)
    assert found["dt"][found["time"] > 0.5][0] >= reached


@pytest.mark.parallel([1, 2])
def test_failed_steps_and_those_of_too_large_an_error(tmp_path, monkeypatch):
    """With -ts_adapt a step that fails is retried, and the tolerance holds besides."""
    create = schemes.create

    def create_fragile(*arguments):
        scheme = create(*arguments)
        step = scheme.step

        def fragile(state, dt):
            if dt > 0.01:
                raise SolveError("too large")
            return step(state, dt)

        scheme.step = fragile
        return scheme

    monkeypatch.setattr(schemes, "create", create_fragile)
    words = {**RELAXING, "scheme": "gcn", "ts_rtol": "1e-3", "ts_dt": "0.03", "ts_max_time": "0.2"}
    with pytest.raises(SolveError, match="step 1 .* too large"):
        run(tmp_path / "fails", **words)
    run(tmp_path / "run", **words, ts_adapt="yes")
    found = rows(tmp_path / "run")
    assert found["time"][-1] == pytest.approx(0.2)
    assert found["dt"][1:].max() == 0.0075 and (found["local_error"][1:] <= 1e-3).all()


def test_a_tolerance_that_no_step_meets_ends_the_run(tmp_path, monkeypatch):
    measure = LocalError.measure

    def jumps(self, step):
        error, order = measure(self, step)
        return (max(error, 1e-3), 1) if step.end.step == 3 else (error, order)

    monkeypatch.setattr(LocalError, "measure", jumps)
    with pytest.raises(SolveError, match="local error, 1.0e-03, is above -ts_rtol 0.0005"):
        run(tmp_path / "run", scheme="gcn", ts_rtol="5e-4", ts_dt="0.03", **RELAXING)
    assert (tmp_path / "run" / "checkpoint-00000002.h5").exists()


def test_steps_done_again_leave_no_vectors_behind(tmp_path):
    simulation = prepare(tmp_path / "run", scheme="mcn", ts_rtol="1e-4", **RELAXING)
    state = simulation.state
    step, error = simulation._attempt(0.03)
    assert error is None and not simulation.step_size.allows(simulation.missed[0])
    step.undo()
    assert step.end.velocity.handle == 0 and state.velocity.norm() == 0
    assert replace(step).stage.handle == 0
    simulation.destroy()


def test_no_tolerance_without_a_vesicle():
    with pytest.raises(InputError, match="-ts_rtol 0.001: there is no vesicle"):
        options.read({"scene": "driven", "ts_rtol": "1e-3"})
