"""Wrong input: one line that says what and what else, status 2, and nothing written."""
import os

import numpy as np
import pytest
from runs import SMALL, comm

from petscib import options, petsc_options, restart, sources
from petscib.driver import Driver
from petscib.entries import Entries
from petscib.errors import InputError

# --- one process, every stage of a start: options, restart, marker file, output folder


def refusal(tmp_path, words):
    """The message; one line, and the folder is as before."""
    before = sorted(os.listdir(tmp_path))
    database = {**SMALL, "output": str(tmp_path / "out"), **words}
    told = {name: text for name, text in words.items() if petsc_options.is_petsc(name)}
    with pytest.raises(InputError) as caught:
        Driver(options.read(restart.merge(database, comm)), entries=Entries(told))
    message = str(caught.value)
    assert len(message.splitlines()) == 1 and len(message) < 400
    assert sorted(os.listdir(tmp_path)) == before
    return message


WRONG = [
    ("sigma", "1", "-sigma 1: unknown option", "nearest: -sigma0"),
    ("ksp_rtol", "1e-3", "unknown option", "nearest: -momentum_ksp_rtol"),
    ("momentun_ksp_rtol", "1", "unknown option", "nearest: -momentum_ksp_rtol"),
    ("checkpoint_evry", "1", "unknown option", "nearest: -checkpoint_every"),
    ("xdmf", "1", "unknown option"),
    ("restrat", "a.h5", "unknown option", "nearest: -restart"),
    ("ts_dt", "0", "out of range", "number above 0"),
    ("ts_dt", "-1", "out of range", "number above 0"),
    ("ts_dt", "nan", "not a number"),
    ("ts_dt", "0,1", "not a number"),
    ("ts_dt", "1e-320", "-ts_dt 1e-320: its magnitude is below 1e-60"),
    ("axes", "1e-200,0.3", "magnitude is below 1e-60"),
    ("ts_max_time", "1e300", "its magnitude is above 1e60"),
    ("shear_rate", "-1e61", "its magnitude is above 1e60"),
    ("sigma0", "1e300", "its magnitude is above 1e60"),
    ("coupled_pc_type", "nosuch", "-coupled_pc_type nosuch: PETSc error 86: Unable to find"),
    ("coupled_ksp_type", "", "-coupled_ksp_type: PETSc error 86: "),
    ("coupled_ksp_rtol", "abc", "-coupled_ksp_rtol abc: PETSc error 63: Input string abc"),
    ("stag_ranks_x", "3", "PETSc cannot set this up: PETSc error 63: "),
    ("ts_max_time", "-1", "out of range"),
    ("ts_max_steps", "1.5", "not a whole number"),
    ("ts_adapt", "yess", "not a switch's value"),
    ("stag_grid_x", "7", "from 8"),
    ("stag_grid_x", "24.5", "not a whole number"),
    ("mu", "0", "number above 0"),
    ("rho", "nan", "not a number"),
    ("domain", "0,0,0,1", "empty"),
    ("axes", "0.2", "not 2 values"),
    ("axes", "2,0.3", "beyond the wall"),
    ("axes", "0.2,0.95", "of the wall"),
    ("center", "0.9,0", "beyond the wall x = 1"),
    ("markers", "9", "at least"),
    ("scheme", "cnn", "nearest: cn"),
    ("delta", "yan", "nearest: yang"),
    ("flow", "tornado", "no such choice"),
    ("checkpoint_every", "-1", "from 0"),
    ("checkpoint_minutes", "-0.1", "from 0"),
    ("checkpoint_minutes", "soon", "not a number"),
    ("checkpoint_keep", "0", "from 1"),
    ("xdmf_every", "-1", "from 0"),
    ("xdmf_every", "2.0", "not a whole number"),
    ("monitor", "on", "none, bar, log"),
    ("restart", "", "needs a value"),
    ("restart", "none.h5", "none.h5: No such file"),
    ("restart", "latest", "no complete checkpoint in"),
    ("restart", __file__, "not an HDF5 file"),
    ("restart", os.path.dirname(__file__), "Is a directory"),
    ("output", __file__, "is a file"),
    ("output", os.path.join(__file__, "below"), "is a file"),
    ("output", "/proc/petscib", "/proc/petscib: No such file or directory"),
    ("marker_file", "none.txt", "gives the shape already"),
    ("rest_length", "-1", "number from 0"),
]


@pytest.mark.parametrize("name, text, fragments", [(n, t, f) for n, t, *f in WRONG])
def test_a_wrong_option(tmp_path, name, text, fragments):
    message = refusal(tmp_path, {name: text})
    for fragment in fragments:
        assert fragment in message


CONTRADICTIONS = [
    (dict(scheme="ep", startup="2"), "no start-up steps"),
    (dict(scheme="ep", stretch="evolve"), "takes its force from the markers"),
    (dict(flow="rest", shear_rate="1"), "the flow is rest"),
    (dict(vesicles="0"), "there is no vesicle"),
    (dict(sigma0="0", rest_length="1"), "no meaning without tension"),
    (dict(marker_file=__file__), "-marker_file gives the shape already"),
    (dict(scheme="mbe", poisson_pc_type="python",
          poisson_pc_python_type="petscib.solvers.nothing.Poisson"),
     "-poisson_pc_python_type petscib.solvers.nothing.Poisson: No module named"),
    (dict(scheme="mbe", poisson_pc_type="python",
          poisson_pc_python_type="petscib.solvers.poisson.Nobody"),
     "-poisson_pc_python_type petscib.solvers.poisson.Nobody: petscib.solvers.poisson has no"),
]


@pytest.mark.parametrize("words, fragment", CONTRADICTIONS)
def test_contradicting_options(tmp_path, words, fragment):
    assert fragment in refusal(tmp_path, words)


# --- marker files

TURN = np.linspace(0, 2 * np.pi, 80, endpoint=False)
CIRCLE = np.stack((0.4 * np.cos(TURN), 0.4 * np.sin(TURN)), axis=1)


def lines(points):
    return "".join(f"{x!r} {y!r}\n" for x, y in np.asarray(points).tolist())


def edited(row, point):
    points = CIRCLE.copy()
    points[row] = point
    return lines(points)


def swapped(one, other):
    points = CIRCLE.copy()
    points[[one, other]] = points[[other, one]]
    return lines(points)


FILES = {
    "nan": (edited(3, (np.nan, 0)), "line 4 (nan 0.0) is not finite"),
    "infinite": (edited(9, (0, np.inf)), "line 10 (0.0 inf) is not finite"),
    "duplicate far away": (edited(50, CIRCLE[4]), "the point of line 5 again in line 51"),
    "too few": (lines(CIRCLE[:7]), "7 points, and a closed curve needs 8"),
    "one point": ("0 0\n", "1 points"),
    "empty": ("", "0 points"),
    "comments only": ("# x y\n\n# end\n", "0 points"),
    "one column": ("0.1\n" * 20, "line 1 (0.1) has 1 columns"),
    "three columns": ("0 0 0\n" * 20, "line 1 (0 0 0) has 3 columns"),
    "two headers": ("x y\nm m\n" + lines(CIRCLE), "line 2 (m m) is not two numbers"),
    "wrong number": ("99\n" + lines(CIRCLE), f"announces 99 points, and {len(CIRCLE)} follow"),
    "decimal commas": ("0,1 0,2\n" * 20, "line 1 (0,1 0,2) has 4 columns"),
    "bytes": (b"\x89HDF\r\n\x1a\n\xff\xfe", "not a text file"),
    "crossing": (swapped(10, 50), "the curve crosses itself, after lines"),
    "figure of eight": (lines(np.stack((0.4 * np.sin(TURN + 0.1), 0.4 * np.sin(2 * TURN + 0.2)),
                                       axis=1)), "the curve crosses itself"),
    "there and back": (lines(np.stack((0.4 * np.cos(TURN + 0.01), 0 * TURN), axis=1)),
                       "crosses itself"),
    "outside": (lines(CIRCLE + (0.9, 0)), "beyond the wall x = 1"),
    "near a wall": (lines(CIRCLE + (0, 0.5)), "of the wall y = 1"),
    "tiny": (lines(0.01 * CIRCLE), "at least 8 markers"),
}


@pytest.fixture
def no_axes(monkeypatch):
    monkeypatch.delitem(SMALL, "axes")


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_marker_file(tmp_path, no_axes, name):
    content, fragment = FILES[name]
    path = tmp_path / "markers.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    message = refusal(tmp_path, {"marker_file": str(path)})
    assert message.startswith(f"-marker_file {path}: ") and fragment in message
    assert "; allowed: " in message


@pytest.mark.parametrize("words, fragment", [
    (dict(marker_file="none.txt"), "-marker_file none.txt: no such file"),
    (dict(center="0.1,0"), "-center 0.1,0: -marker_file gives the place already"),
    (dict(angle="10"), "-angle 10: -marker_file gives the place already"),
    (dict(markers="12"), "-markers 12: 12 markers on a perimeter of 2.51"),
])
def test_options_that_a_marker_file_forbids(tmp_path, no_axes, words, fragment):
    (tmp_path / "markers.txt").write_text(lines(CIRCLE))
    assert fragment in refusal(tmp_path, {"marker_file": str(tmp_path / "markers.txt"), **words})


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("turn", [1, -1])
def test_a_right_marker_file(tmp_path, no_axes, turn):
    """Either orientation, commas, comments, and a last point that repeats the first."""
    path = tmp_path / "markers.txt"
    if comm.rank == 0:
        points = np.concatenate((CIRCLE, CIRCLE[:1]))[::turn]
        path.write_text("# a circle\n" + lines(points).replace(" ", ", ") + "\n  # end\n")
    comm.Barrier()
    database = {**SMALL, "output": str(tmp_path / "out"), "marker_file": str(path)}
    simulation = Driver(options.read(database))
    markers, ds = simulation.state.markers, simulation.problem.membranes.curves.ds[:1]
    simulation.destroy()
    count = comm.bcast(len(markers))
    assert count == round(0.8 * np.pi / (1 / 24)) and np.allclose(count * ds, 0.8 * np.pi, 1e-6)
    if comm.rank == 0:
        np.testing.assert_allclose(markers[0], CIRCLE[0], atol=1e-12)
        np.testing.assert_allclose(np.hypot(*markers.T), 0.4, rtol=1e-6)
        edges = np.hypot(*(markers - np.roll(markers, 1, axis=0)).T)
        np.testing.assert_allclose(edges, edges.mean(), rtol=1e-6)
        np.testing.assert_allclose(simulation.state.stretch, 1, rtol=1e-3)


# --- where options come from

SOURCES = {
    "a plain file": ("a.txt", "# x\n\n-mu 2 # two\n  -fft\n-axes 0.1,0.2\r\n! z\nalias -a -b\n",
                     None),
    "a value with a blank": ("a.txt", "-mu 2\n-output my folder\n",
                             "a.txt, line 2: -output my folder; allowed: one `-name value`"),
    "a list with blanks": ("a.txt", "-axes 0.1, 0.5\n", "a.txt, line 1: -axes 0.1, 0.5;"),
    "quotes": ("a.txt", '-output "my folder"\n', "a.txt, line 1: "),
    "a word": ("a.txt", "mu 2\n", "a.txt, line 1: mu 2; allowed: "),
    "two options in a line": ("a.txt", "-mu 2 -rho 3\n", "a.txt, line 1: -mu 2 -rho 3;"),
    "a continued line": ("a.txt", "-output my\\\nfolder\n", "a.txt, line 1: -output my folder"),
    "bytes": ("a.txt", b"-mu \xff\n", "-options_file a.txt: not a text file"),
    "zeros": ("a.txt", b"-mu \0\n", "-options_file a.txt: not a text file"),
    "yaml": ("a.yaml", "mu: 2 # two\naxes: [0.1, 0.2]\nmomentum:\n  ksp_rtol: 1e-8\n"
             "more:\n  - 1\n", None),
    "a yaml value with a blank": ("a.yml", "mu: 2\noutput: my folder # here\n",
                                  "a.yml, line 2: output: my folder; allowed: a value without"),
    "a quoted yaml value": ("a.yaml", 'output: "my folder"\n', "a.yaml, line 1: "),
    "a yaml entry": ("a.yaml", "axes:\n  - 0.1 0.2\n", "a.yaml, line 2: - 0.1 0.2"),
    "numbers": ("a.txt", "0 0\n", "a.txt, line 1: 0 0; allowed: one `-name value` a line"),
}


@pytest.mark.parametrize("name", SOURCES)
def test_nothing_in_a_file_is_cut_off_in_silence(tmp_path, monkeypatch, name):
    file, content, message = SOURCES[name]
    monkeypatch.chdir(tmp_path)
    (tmp_path / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    places = [(["-options_file", file], {}), (["-x"], {"PETSC_OPTIONS": f"-options_file {file}"})]
    if file == "a.txt":
        os.link(file, ".petscrc")
        places.append(([], {}))
        assert sources.check(["-skip_petscrc"], {}) is None
    else:
        places.append((["-options_file_yaml", file], {}))
        places.append((["-options_string_yaml", content], {}))
        places.append(([], {"PETSC_OPTIONS_YAML": content}))
    for arguments, environment in places:
        if message is None:
            sources.check(arguments, environment)
            continue
        with pytest.raises(InputError) as caught:
            sources.check(arguments, environment)
        told = str(caught.value)
        if arguments and "string" not in arguments[0]:
            told = told.replace(".petscrc", file)
            assert message.replace("-options_file ", "") in told.replace("-options_file ", "")


@pytest.mark.parametrize("arguments, message", [
    (["-options_file", "none"], "-options_file none: No such file or directory"),
    (["-options_file", "folder"], "-options_file folder: Is a directory"),
    (["-axes", "0.1", "0.5"], "-axes 0.1 0.5: one value without blanks"),
    (["tanktreading"], "tanktreading: neither an option nor the value of one")])
def test_what_is_no_option_or_file_of_them(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    os.mkdir("folder")
    with pytest.raises(InputError) as caught:
        sources.check(arguments, {})
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("text, fragment", [
    ("-output my folder", "PETSC_OPTIONS: -output my folder: one value without blanks"),
    ("mu 2", "PETSC_OPTIONS: mu: neither an option"), ("-mu 2 -fft\n-rho 3", None)])
def test_nothing_in_the_environment_is_cut_off_in_silence(text, fragment):
    if fragment is None:
        return sources.check([], {"PETSC_OPTIONS": text})
    with pytest.raises(InputError) as caught:
        sources.check([], {"PETSC_OPTIONS": text})
    assert str(caught.value).startswith(fragment)


# --- the real command line, on 2 ranks

# One for each place that refuses: what all of them say is tested above, in this process.
COMMANDS = [
    (["-sgima0", "1"], "-sgima0 1: unknown option", "nearest: -sigma0"),
    (["-axes", "0.1", "0.5"], "-axes 0.1 0.5: one value without blanks"),
    (["-marker_file", "bad.txt"], "-marker_file bad.txt: line 2 (0 nan) is not finite"),
    (["-restart", "bad.txt"], "bad.txt: not an HDF5 file"),
    (["-options_file", "bad.options"], "-mu -1: out of range"),
    (["-output", "/proc/petscib"], "/proc/petscib: No such file or directory"),
    (["-options_file_yaml", "bad.yaml"], "PETSc cannot read its options (given in bad.yaml): "),
    (["-stag_ranks_x", "3"], "PETSc cannot set this up: PETSc error 63: "),
]


@pytest.mark.parametrize("words, fragments", [(w, f) for w, *f in COMMANDS],
                         ids=[" ".join(w) for w, *_ in COMMANDS])
def test_the_command_line(mpirun, tmp_path, words, fragments):
    (tmp_path / "bad.txt").write_text("0 0\n0 nan\n")
    (tmp_path / "bad.options").write_text("-mu -1\n")
    (tmp_path / "bad.yaml").write_text("mu: [\n")
    before = set(os.listdir(tmp_path))
    output = [] if "-output" in words else ["-output", "out/here"]
    result = mpirun(2, "-m", "petscib", *output, *words, check=False, timeout=30)
    assert result.returncode == 2 and result.stdout == ""
    message, = result.stderr.splitlines()
    assert message.startswith("petscib: ")
    for fragment in fragments:
        assert fragment in message
    assert set(os.listdir(tmp_path)) - before == {"mpirun.stdout", "mpirun.stderr"}
