"""Which options are PETSc's to read: those of its solvers, and general ones.

This module needs neither PETSc nor MPI.
"""

# Prefixes of the solvers' options, and what is solved behind each.
SOLVERS = (
    ("momentum_", "implicit velocity of ep, mbe, mcn (CG with GAMG; fgmres: block iteration)"),
    ("poisson_", "pressure projection (CG with GAMG)"),
    ("poisson_indicator_", "where another viscosity is, with -viscosity_contrast (CG with GAMG)"),
    ("coupled_", "velocity and pressure together, be, cn, gbe, gcn (FGMRES; CG with -fft)"),
    ("momentum_velocity_", "fluid's solve inside a block iteration; likewise coupled_velocity_"),
    ("coupled_poisson_", "pressure solve inside the preconditioner"),
    ("momentum_advection_", "ksp_rtol and ksp_max_it of implicit advection with -fft; likewise "
     "coupled_advection_"),
    ("momentum_model_", "direct solver in marker space; likewise coupled_model_"),
    ("momentum_stress_", "direct solver of the eliminated membrane stresses; likewise "
     "coupled_stress_"),
    ("coupled_direct_", "direct solver of the whole matrix, without the kink correction"),
)
SYSTEMS = "momentum", "poisson", "coupled"  # with one of these every such prefix begins

# Options every PETSc program understands. Names that PETSc would read but that act on nothing
# here (ksp_, pc_, ts_, snes_ without a prefix) are left out on purpose: they would be ignored.
GENERAL = (
    "help", "version", "citations", "history", "display", "nox", "nox_warning", "tmp",
    "shared_tmp", "not_shared_tmp", "info", "info_exclude", "malloc", "fp_trap", "python",
    "objects_dump", "get_total_flops", "no_signal_handler", "options_file", "options_file_yaml",
    "options_string_yaml", "options_left", "options_view", "options_monitor",
    "options_monitor_cancel", "options_suppress_deprecated_warnings", "prefix_push",
    "prefix_pop", "skip_petscrc", "start_in_debugger", "stop_for_debugger", "debug_terminal",
    "check_pointer_intensity", "checkfunctionlist", "error_output_none", "error_output_stdout",
    "library_preload", "default_device_type", "build_twosided", "splitreduction_async",
    "blas_num_threads", "stag_ranks_x", "stag_ranks_y",
)
_FAMILIES = (
    "log_", "malloc_", "memory_", "mat_", "matmatmult_", "matptap_", "matrart_", "vec_", "dm_",
    "sf_", "is_", "ao_", "petsc_", "petscsf_", "petscsection_", "viewer_", "draw_", "x_",
    "random_", "on_error_", "debugger_", "mpi_", "mpidump", "use_gpu_", "device_",
    "root_device_context_", "cuda_", "hip_", "sycl_", "kokkos_", "omp_", "dll_", "saws_",
    "vecscatter_",
)


def is_petsc(name):
    """Whether an option is PETSc's to read: a solver's prefix, or a general PETSc option."""
    system, _, rest = name.partition("_")
    return system in SYSTEMS and rest != "" or name in GENERAL or name.startswith(_FAMILIES)
