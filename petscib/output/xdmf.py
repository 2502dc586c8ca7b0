"""Fields and vesicles for ParaView: a time series of HDF5 files with XDMF indices.

Every frame is a file ``fields-<step, 8 digits>.h5`` of its own, complete when it has its name, so
that a killed run leaves whole frames only.  ``fields.xdmf`` and ``vesicles.xdmf`` list them with
relative paths: the folder can be moved.  Open these two in ParaView ("Xdmf Reader").

In a frame, with 4-byte floats for m x n cells, row index y and column index x:

=====================  ===============  ===========================================================
/x, /y                 (m + 1), (n + 1) grid lines
/fluid/velocity        (n, m, 3)        at the cell centres: mean of the two faces; z is 0
/fluid/pressure        (n, m)           at the cell centres
/fluid/vorticity       (n, m)           mean of the cell's four corners
/fluid/viscosity       (n, m)           at the cell centres, where it varies
/vesicle_0/X           (M, 2)           markers, moved by whole periods where the box is periodic
/vesicle_0/edges       (M, 2)           numbers of the markers that edge k joins: k - 1 and k
/vesicle_0/tension     (M,)             tension sigma on edge k
/vesicle_0/stretch     (M,)             |X_s| on edge k
=====================  ===============  ===========================================================

Other vesicles are in /vesicle_1 and so on.  Open curves have M - 1 edges, and so have lines across
a periodic box, whose last edge leads to the first marker's next image.

Attributes of the root: step and time.  For the vorticity beside a wall, the ghost value
2 u_wall - u_inside stands beyond it, as in the viscous operator.  In a periodic box the vesicle's
middle is inside; where it crosses a side, it goes on outside.
"""

import os

import h5py
import numpy as np
from petsc4py import PETSc

from . import files, hdf5

_HEAD = """<?xml version="1.0" ?>
<Xdmf Version="2.0">
<Domain>
<Grid Name="{name}" GridType="Collection" CollectionType="Temporal">
"""
_TAIL = """</Grid>
</Domain>
</Xdmf>
"""


def cell_fields(grid, sides, velocity):
    """Velocity and vorticity at the centres of this rank's cells.  Collective.

    Parameters
    ----------
    grid : Grid
    sides : Sides
    velocity : PETSc.Vec

    Returns
    -------
    velocity : ndarray, shape (rows, columns, 3)
    vorticity : ndarray, shape (rows, columns)
        Of the shape of `grid.p_box`.
    """
    u, v = _ghosted(grid, sides, velocity)
    centre_u = (u[:, 1:] + u[:, :-1]) / 2  # one more row below and above
    centre_v = (v[1:] + v[:-1]) / 2  # one more column on either side
    # The mean over the corners of differences across is the central difference of the means.
    vorticity = (centre_v[:, 2:] - centre_v[:, :-2]) / (2 * grid.dx)
    vorticity -= (centre_u[2:] - centre_u[:-2]) / (2 * grid.dy)
    components = centre_u[1:-1], centre_v[:, 1:-1], np.zeros_like(vorticity)
    return np.stack(components, axis=-1), vorticity


def _ghosted(grid, sides, velocity):
    """The faces of this rank's cells: u with a row more below and above, v with columns."""
    local = grid.velocity_dm.createLocalVec()
    grid.velocity_dm.globalToLocal(velocity, local)
    (gx, gy), (width, height) = grid.velocity_dm.getGhostCorners()
    values = local.getArray(readonly=True).reshape(height, width, -1)
    where = PETSc.DMStag.StencilLocation
    left, down = (grid.velocity_dm.getLocationSlot(at, 0) for at in (where.LEFT, where.DOWN))
    rows, columns = grid.p_box
    y, x = slice(rows.start, rows.stop + 1), slice(columns.start, columns.stop + 1)

    def part(first, last, low, high, slot):
        return values[first - gy : last - gy, low - gx : high - gx, slot]

    def beyond(side, along, inside):
        # Counted on over a periodic side.
        wall = sides.tangential[side].take(range(along.start, along.stop), mode="wrap")
        return 2 * wall - inside

    def at(side, place, end):
        return side in sides.tangential and place == end

    south, north = at("bottom", rows.start, 0), at("top", rows.stop, grid.n)
    u = part(rows.start - (not south), rows.stop + (not north), x.start, x.stop, left)
    below = [beyond("bottom", x, u[0])] if south else []
    above = [beyond("top", x, u[-1])] if north else []
    west, east = at("left", columns.start, 0), at("right", columns.stop, grid.m)
    v = part(y.start, y.stop, columns.start - (not west), columns.stop + (not east), down)
    before = [beyond("left", y, v[:, 0])] if west else []
    behind = [beyond("right", y, v[:, -1])] if east else []
    u, v = np.vstack((*below, u, *above)), np.column_stack((*before, v, *behind))
    local.destroy()
    return u, v


class Series:
    """The frames of a run in a folder, and their indices; those that are there are continued.

    Parameters
    ----------
    folder : str
    problem : Problem
    """

    def __init__(self, folder, problem):
        self.folder = folder
        self.problem = problem
        self.comm = problem.grid.comm.tompi4py()
        self.frames = []
        if self.comm.rank == 0:
            self.frames = [_moment(path) for path in files.named(folder, "fields-#.h5")]

    def write(self, state):
        """Write a frame and both indices.  Collective.

        Raises
        ------
        OutputError
            On all ranks.
        """
        problem, grid = self.problem, self.problem.grid
        name = f"fields-{state.step:08d}.h5"
        velocity, vorticity = cell_fields(grid, problem.operators.sides, state.velocity)
        pressure = grid.pressure_block(state.pressure)
        shape, box = grid.p_index.shape, grid.p_box
        a, b, c, d = grid.domain
        lines = (("x", a, b, grid.m), ("y", c, d, grid.n))
        datasets = [
            *(
                hdf5.Dataset(axis, np.linspace(low, high, count + 1)[self._mine], (count + 1,))
                for axis, low, high, count in lines
            ),
            _real("fluid/velocity", velocity, (*shape, 3), (*box, slice(None))),
            _real("fluid/pressure", pressure, shape, box),
            _real("fluid/vorticity", vorticity, shape, box),
        ]
        if problem.viscosity is not None:
            problem.place_viscosity(state.markers)
            viscosity = grid.pressure_block(problem.viscosity.cells)
            datasets.append(_real("fluid/viscosity", viscosity, shape, box))
        if problem.membranes is not None:
            datasets += self._vesicles(state)
        attributes = {"/": {"step": state.step, "time": state.time}}
        hdf5.write_hdf5(os.path.join(self.folder, name), self.comm, datasets, attributes)
        files.by_root(self.comm, lambda: self._index(name, state.time))

    def _vesicles(self, state):
        """Datasets of all vesicles; the ranks without markers know their shapes."""
        grid, membranes = self.problem.grid, self.problem.membranes
        curves, tension = membranes.constants.curves, self.problem.tension(state)
        datasets = []
        for k, (first, begin, end) in enumerate(
                zip(curves.starts, curves.edge_starts, curves.edge_starts[1:])):
            begin += bool(curves.periods[k].any())  # an edge across the box would be drawn so
            edges = (curves.edges[begin:end] - first).astype(np.int32)
            last = curves.starts[k + 1]
            datasets += [
                _real(f"vesicle_{k}/X", _at_home(grid, state.markers[first:last]),
                      (last - first, 2)),
                hdf5.Dataset(f"vesicle_{k}/edges", edges[self._mine], edges.shape),
                _real(f"vesicle_{k}/tension", tension[begin:end], (end - begin,)),
                _real(f"vesicle_{k}/stretch", state.stretch[begin:end], (end - begin,)),
            ]
        return datasets

    @property
    def _mine(self):
        """What rank 0 holds and the other ranks do not."""
        return slice(None) if self.comm.rank == 0 else slice(0, 0)

    def _index(self, name, time):
        self.frames = [frame for frame in self.frames if frame[0] != name] + [(name, time)]
        grids = {"fields": self._fluid}
        if self.problem.membranes is not None:
            grids["vesicles"] = self._all_vesicles
        for title, describe in grids.items():
            text = _HEAD.format(name=title) + "".join(
                describe(frame, f'<Time Value="{float(moment)!r}"/>\n')
                for frame, moment in self.frames
            )
            files.write_text(os.path.join(self.folder, f"{title}.xdmf"), text + _TAIL)

    def _fluid(self, frame, time):
        m, n = self.problem.grid.m, self.problem.grid.n
        scalars = ["pressure", "vorticity"] + ["viscosity"] * (self.problem.viscosity is not None)
        return _grid(
            "fields", time,
            f'<Topology TopologyType="2DRectMesh" Dimensions="{n + 1} {m + 1}"/>\n'
            f'<Geometry GeometryType="VXVY">\n{_item(frame, "x", m + 1, size=8)}'
            f'{_item(frame, "y", n + 1, size=8)}</Geometry>\n'
            + _attribute("velocity", "Vector", _item(frame, "fluid/velocity", n, m, 3))
            + "".join(_attribute(name, "Scalar", _item(frame, f"fluid/{name}", n, m))
                      for name in scalars)
        )

    def _all_vesicles(self, frame, time):
        curves = self.problem.membranes.constants.curves
        if curves.count == 1:
            return self._vesicle(frame, 0, "vesicles", time)
        return (
            f'<Grid Name="vesicles" GridType="Collection" CollectionType="Spatial">\n{time}'
            + "".join(self._vesicle(frame, k, f"vesicle_{k}") for k in range(curves.count))
            + "</Grid>\n"
        )

    def _vesicle(self, frame, k, name, time=""):
        curves, group = self.problem.membranes.constants.curves, f"vesicle_{k}"
        markers = curves.starts[k + 1] - curves.starts[k]
        count = curves.edge_starts[k + 1] - curves.edge_starts[k] - curves.periods[k].any()
        edges = _item(frame, f"{group}/edges", count, 2, kind="Int")
        return _grid(
            name, time,
            f'<Topology TopologyType="Polyline" NumberOfElements="{count}" NodesPerElement="2">\n'
            f"{edges}</Topology>\n"
            f'<Geometry GeometryType="XY">\n{_item(frame, f"{group}/X", markers, 2)}</Geometry>\n'
            + _attribute("tension", "Scalar", _item(frame, f"{group}/tension", count))
            + _attribute("stretch", "Scalar", _item(frame, f"{group}/stretch", count))
        )


def _grid(name, time, content):
    return f'<Grid Name="{name}" GridType="Uniform">\n{time}{content}</Grid>\n'


def _at_home(grid, markers):
    """Markers moved by whole periods so that their middle is in the box; its sides may cut them."""
    return markers + grid.way_home(markers.mean(axis=0)) if len(markers) else markers


def _real(path, values, shape, box=None):
    return hdf5.Dataset(path, values.astype(np.float32), shape, box)


def _item(frame, path, *shape, kind="Float", size=4):
    dimensions = " ".join(map(str, shape))
    return (
        f'<DataItem Dimensions="{dimensions}" NumberType="{kind}" Precision="{size}" '
        f'Format="HDF">{frame}:/{path}</DataItem>\n'
    )


def _attribute(name, kind, item):
    return (
        f'<Attribute Name="{name}" AttributeType="{kind}" Center="Cell">\n{item}</Attribute>\n'
    )


def _moment(path):
    """Name and time of a frame."""
    with h5py.File(path, "r") as file:
        return os.path.basename(path), float(file.attrs["time"])
