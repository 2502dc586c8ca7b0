"""Fields for ParaView: right values at the right places, and files that its readers open."""
import json
import pathlib
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import h5py
import numpy as np
import pytest
from runs import comm, prepare, run

from petscib.output.xdmf import Series, cell_fields

BOX = {"stag_grid_x": "24", "stag_grid_y": "30", "domain": "-1,1,-1,1.5"}

# What the reader of ParaView sees in an index, as JSON. In a process of its own: the reader brings
# its own HDF5, which need not get along with h5py's.
READER = """
import json, sys
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

reader = vtkXdmfReader()
reader.SetFileName(sys.argv[1])
reader.UpdateInformation()
information = reader.GetOutputInformation(0)
count = information.Length(Pipeline.TIME_STEPS())
frames = []
for time in [information.Get(Pipeline.TIME_STEPS(), k) for k in range(count)]:
    reader.UpdateTimeStep(time)
    data = reader.GetOutputDataObject(0)
    arrays = {}
    for k in range(data.GetCellData().GetNumberOfArrays()):
        array = data.GetCellData().GetArray(k)
        size = range(array.GetNumberOfTuples())
        arrays[array.GetName()] = [array.GetTuple(cell) for cell in size]
    cells = [data.GetCell(k).GetBounds() for k in range(data.GetNumberOfCells())]
    frames.append(dict(time=time, bounds=data.GetBounds(), arrays=arrays, cells=cells))
print(json.dumps(frames))
"""


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("flow", ["shear", "extensional", "poiseuille"])
def test_cell_fields_of_background_flows(tmp_path, flow):
    simulation = prepare(tmp_path, flow=flow, shear_rate="2", **BOX)
    grid, walls = simulation.problem.grid, simulation.problem.operators.sides
    velocity, vorticity = cell_fields(grid, walls, simulation.state.velocity)
    x, y = grid.p_points(grid.p_box)
    u, v = walls._at(x, y)
    # The mean over two faces is exact for linear flows, and for u of the channel's too.
    np.testing.assert_allclose(velocity[..., 0], u, atol=1e-13)
    np.testing.assert_allclose(velocity[..., 1], v, atol=1e-13)
    assert not velocity[..., 2].any()
    c, d = grid.domain[2:]
    exact = {"shear": -2.0, "extensional": 0.0, "poiseuille": -2.0 * (c + d - 2 * y) / (d - c)}
    # The ghost values at a wall make its corners first order: a quarter of h u'' here.
    tolerance = 0.26 * grid.dy * 4 / (d - c) if flow == "poiseuille" else 1e-12
    np.testing.assert_allclose(vorticity, exact[flow] + 0 * x * y, atol=tolerance)


@pytest.mark.parallel([1, 3])
def test_vorticity_of_a_vortex(tmp_path):
    simulation = prepare(tmp_path, flow="rest", stag_grid_x="64", stag_grid_y="80",
                         domain="-1,1,-1,1.5")
    grid = simulation.problem.grid
    state = simulation.state
    x, y = grid.u_points(grid.u_box)
    bump = lambda x, y: np.exp(-4 * (x**2 + y**2))  # noqa: E731
    u = -y * bump(x, y)
    x, y = grid.v_points(grid.v_box)
    grid.set_velocity(state.velocity, u, x * bump(x, y))
    _, vorticity = cell_fields(grid, simulation.problem.operators.sides, state.velocity)
    x, y = grid.p_points(grid.p_box)
    exact = (2 - 8 * (x**2 + y**2)) * bump(x, y)
    inner = (abs(x) < 0.9) & (y > -0.9)
    assert abs(vorticity - exact)[inner].max(initial=0) < 0.02


def items(index):
    """Every (file, dataset, dimensions) that an index refers to."""
    for item in ElementTree.parse(index).iter("DataItem"):
        file, dataset = item.text.strip().split(":")
        yield file, dataset, tuple(map(int, item.get("Dimensions").split()))


@pytest.mark.parallel(2)
def test_indices_refer_to_what_is_there(tmp_path):
    run(tmp_path / "run", ts_max_steps="4", xdmf_every="2", **BOX)
    comm.Barrier()
    for name, each in (("fields", 5), ("vesicles", 4)):
        index = tmp_path / "run" / f"{name}.xdmf"
        found = list(items(index))
        assert len(found) == 3 * each
        for file, dataset, dimensions in found:
            assert pathlib.Path(file).name == file  # relative: the folder can be moved
            with h5py.File(tmp_path / "run" / file, "r") as frame:
                assert frame[dataset].shape == dimensions
        times = [float(time.get("Value")) for time in ElementTree.parse(index).iter("Time")]
        with h5py.File(tmp_path / "run" / "fields-00000004.h5", "r") as frame:
            assert times[0] == 0 and times[-1] == frame.attrs["time"] and len(times) == 3


def test_a_torn_frame_is_not_listed(tmp_path):
    simulation = prepare(tmp_path / "run", xdmf_every="1")
    simulation.results.write_fields(simulation.state)
    (tmp_path / "run" / "fields-00000001.h5.part").write_bytes(b"torn")
    series = Series(str(tmp_path / "run"), simulation.problem)
    assert [name for name, _ in series.frames] == ["fields-00000000.h5"]


def test_paraviews_reader_opens_the_series(tmp_path):
    if subprocess.run([sys.executable, "-c", "import vtkmodules.vtkIOXdmf2"],
                      stderr=subprocess.DEVNULL).returncode:
        pytest.skip("vtk is not installed")
    run(tmp_path / "run", ts_max_steps="2", xdmf_every="1", **BOX)
    folder = shutil.move(tmp_path / "run", tmp_path / "elsewhere")

    def read(name):
        result = subprocess.run([sys.executable, "-c", READER, f"{folder}/{name}.xdmf"],
                                capture_output=True, text=True, timeout=60)
        assert "ERR" not in result.stderr, result.stderr
        return json.loads(result.stdout)

    frames = read("fields")
    assert len(frames) == 3 and np.isclose(frames[2]["time"], 2 / 12)
    with h5py.File(f"{folder}/fields-00000002.h5", "r") as file:
        np.testing.assert_allclose(frames[2]["bounds"], (-1, 1, -1, 1.5, 0, 0), atol=1e-12)
        # A cell in the middle of nowhere: row 20 (y), column 3 (x).
        cell = 20 * 24 + 3
        np.testing.assert_allclose(frames[2]["cells"][cell][:4],
                                   (-1 + 3 / 12, -1 + 4 / 12, -1 + 20 / 12, -1 + 21 / 12))
        for name in ("velocity", "pressure", "vorticity"):
            values = np.array(frames[2]["arrays"][name])
            np.testing.assert_array_equal(values.squeeze(), file[f"fluid/{name}"][...].reshape(
                values.squeeze().shape))
        speeds = np.array(frames[2]["arrays"]["velocity"])
        np.testing.assert_array_equal(speeds[cell], file["fluid/velocity"][20, 3])

        frame = read("vesicles")[2]
        X, tension = file["vesicle_0/X"][...], file["vesicle_0/tension"][...]
        np.testing.assert_array_equal(np.squeeze(frame["arrays"]["tension"]), tension)
        ends = X, np.roll(X, 1, axis=0)  # edge k joins markers k - 1 and k
        bounds = np.array(frame["cells"])
        np.testing.assert_allclose(bounds[:, [0, 2]], np.minimum(*ends), atol=1e-6)
        np.testing.assert_allclose(bounds[:, [1, 3]], np.maximum(*ends), atol=1e-6)
