from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

class InputError(ValueError): ...
class SimulationError(RuntimeError): ...

# bind_geometry.cpp

class _SurfaceReport(TypedDict):
    vertices_read: int
    faces_read: int
    vertices_welded: int
    degenerate_faces: int
    duplicate_faces: int
    flipped_faces: int
    inverted_components: int
    cavities: int
    components: int
    open_edges: int
    holes_filled: int
    holes_closed: int
    hole_volume: float
    largest_hole: float
    seams_joined: bool

class Surface:
    @property
    def name(self) -> str: ...
    @property
    def area(self) -> float: ...
    @property
    def volume(self) -> float: ...
    @property
    def centroid(self) -> tuple[float, float, float]: ...
    @property
    def covariance(self) -> list[float]: ...
    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def faces(self) -> NDArray[np.int32]: ...
    @property
    def is_cap(self) -> NDArray[np.bool_]: ...
    @property
    def report(self) -> _SurfaceReport: ...
    def closest_points(
        self, points: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.int32]]: ...

def prepare_surface(
    vertices: ArrayLike,
    faces: ArrayLike,
    name: str,
    hole_limit: float = 0.1,
    close_holes: bool = False,
) -> Surface: ...

class LabelImage:
    def __init__(self, labels: ArrayLike, to_index: ArrayLike) -> None: ...

def voxelise(
    *,
    skin: Surface | tuple[LabelImage, Sequence[int]],
    outer_surface: Surface,
    outer: ArrayLike,
    bones: Sequence[Surface | tuple[LabelImage, Sequence[int]]],
    parts: Sequence[Surface | tuple[LabelImage, Sequence[int]]],
    origin: Sequence[float],
    voxel: Sequence[float],
    count: Sequence[int],
    samples: int,
    boundaries: Sequence[ArrayLike],
    cap: float,
    local_caps: Sequence[tuple[Sequence[float], float]],
    region_low: Sequence[float],
    region_high: Sequence[float],
    bone_rank: int,
    part_ranks: Sequence[int],
    layer_ranks: Sequence[int],
) -> dict[str, Any]: ...
def gap_volumes(
    surfaces: Sequence[Surface],
    origin: Sequence[float],
    voxel: Sequence[float],
    cells: ArrayLike,
    width: float,
) -> NDArray[np.float64]: ...
def clean_cells(
    cells: ArrayLike, min_neighbours: int, largest_only: bool
) -> tuple[NDArray[np.bool_], int, list[int]]: ...

# bind_model.cpp

class _NearestSurfaces(TypedDict):
    surface: NDArray[np.int32]
    face: NDArray[np.int32]
    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    tied: NDArray[np.bool_]

def nearest_cells(
    cells: ArrayLike, voxel: Sequence[float], points: ArrayLike
) -> tuple[NDArray[np.int32], NDArray[np.float64]]: ...
def weld(
    vertices: ArrayLike, faces: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.int32]]: ...
def nearest_surfaces(
    surfaces: Sequence[tuple[ArrayLike, ArrayLike]], points: ArrayLike, tolerance: float
) -> _NearestSurfaces: ...
def segments_meet(
    surfaces: Sequence[tuple[ArrayLike, ArrayLike]], starts: ArrayLike, ends: ArrayLike
) -> NDArray[np.bool_]: ...

# bind_fibres.cpp

def samples_inside(
    surface: Surface,
    origin: Sequence[float],
    voxel: Sequence[float],
    count: Sequence[int],
    samples: int,
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]: ...
def locate_in_volume(
    *,
    degree: Sequence[int],
    knots: Sequence[Sequence[float]],
    control: ArrayLike,
    points: ArrayLike,
    guesses: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...

# bind_devices.cpp

class DeviceInfo:
    @property
    def id(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def platform(self) -> str: ...
    @property
    def driver(self) -> str: ...
    @property
    def works(self) -> bool: ...
    @property
    def reason(self) -> str: ...
    @property
    def has_double(self) -> bool: ...
    @property
    def limits_registers(self) -> bool: ...
    @property
    def compute_units(self) -> int: ...
    @property
    def memory_bytes(self) -> int: ...

class Buffer:
    @property
    def nbytes(self) -> int: ...
    @property
    def opencl_handle(self) -> int | None: ...
    def write(self, array: NDArray[Any], offset: int = 0) -> None: ...
    def read(self, array: NDArray[Any], offset: int = 0) -> None: ...

class Device:
    @property
    def info(self) -> DeviceInfo: ...
    @property
    def prefers_vector_rows(self) -> bool: ...
    def preferred_lanes(self, *, is_double: bool) -> int: ...
    @property
    def opencl_context(self) -> int | None: ...
    @property
    def opencl_queue(self) -> int | None: ...
    def finish(self) -> None: ...
    def _allocate(self, nbytes: int) -> Buffer: ...
    def _launch(
        self,
        kernel: str,
        arguments: Sequence[Buffer | int],
        n_items: int,
        *,
        precision: str = "single",
        lanes: int = 16,
        vector_rows: bool = True,
        local_size: int = 0,
    ) -> None: ...

def all_devices() -> list[DeviceInfo]: ...
def open_device(spec: str) -> Device: ...
def device_from_handle(cl_device_id: int) -> Device: ...
def opencl_loader_report() -> str: ...
def add_opencl_library(path: str) -> None: ...
def set_kernel_folder(path: str) -> None: ...
def thread_count() -> int: ...
def compiler() -> str: ...

# bind_roofline.cpp

class Roofline:
    def __init__(
        self,
        device: Device,
        *,
        is_double: bool,
        nbytes: int,
        fused: float,
        multiplied: float,
        added: float,
    ) -> None: ...
    def axpy(self, seconds: float) -> float: ...
    def copy(self, seconds: float) -> float: ...
    def instructions(self, seconds: float) -> float: ...
    @property
    def mix(self) -> tuple[float, float, float]: ...

def operations_per_element(
    model: VoxelModel, *, physical: bool, axis_order: Sequence[int]
) -> dict[str, float]: ...
def workload_names() -> list[str]: ...
def workload_elements(workload: str) -> int: ...
def bench_measure(
    device: Device,
    workload: str,
    *,
    elements: int = 0,
    physical: bool = True,
    is_double: bool = False,
    kernels: str = "auto",
    rounds: int = 7,
    seconds: float = 0.1,
    checks: bool = True,
    array_bytes: int = 536870912,
) -> str: ...

# bind_simulator.cpp

class VoxelModel:
    def __init__(
        self,
        *,
        voxel: Sequence[float],
        cells: ArrayLike,
        node_ijk: ArrayLike,
        mu: ArrayLike,
        bulk_log: ArrayLike,
        bulk_quadratic: ArrayLike,
        density: ArrayLike,
        shear_modulus: ArrayLike,
        bulk_modulus: ArrayLike,
        bending_modulus: ArrayLike,
        fixed: ArrayLike,
        gravity: Sequence[float],
    ) -> None: ...
    def add_law(self, *, name: str, elements: ArrayLike, rows: ArrayLike) -> None: ...
    def set_hexahedra(self, *, positions: ArrayLike, corners: ArrayLike) -> None: ...
    @property
    def element_volumes(self) -> NDArray[np.float64]: ...
    @property
    def shortest_edge(self) -> float: ...
    def add_muscle(
        self,
        *,
        name: str,
        elements: ArrayLike,
        fibre: ArrayLike,
        weight: ArrayLike,
        sigma_act: float,
        sigma_pas: float,
        lambda_opt: float,
        lambda_pas: float,
        calcium: bool = False,
        beta: float = 0.0,
        printed_passive: bool = False,
    ) -> None: ...

def element_stiffness(model: VoxelModel) -> NDArray[np.float64]: ...

class Conditions:
    def __init__(self) -> None: ...
    def add_prescribed(self, dofs: ArrayLike) -> None: ...
    def add_fields(self, dofs: ArrayLike) -> None: ...
    def add_load(self, dofs: ArrayLike, forces: ArrayLike) -> None: ...
    def add_pressure(self, faces: ArrayLike) -> None: ...

class SlidingNodes:
    def __init__(self) -> None: ...
    def add_surface(self, vertices: ArrayLike, faces: ArrayLike) -> None: ...
    def set_nodes(self, nodes: ArrayLike, surface: ArrayLike, distance: ArrayLike) -> None: ...
    def set_laws(self, friction: ArrayLike, release: ArrayLike) -> None: ...
    def set_moving(self, surfaces: ArrayLike) -> None: ...

def grid_nearest(
    device: Device, precision: str, vertices: ArrayLike, faces: ArrayLike, points: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.int32]]: ...
def brute_force_nearest(
    vertices: ArrayLike, faces: ArrayLike, points: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.int32]]: ...

class _ElementState(TypedDict):
    deformation_gradient: NDArray[np.float64]
    stress: NDArray[np.float64]
    energy_density: NDArray[np.float64]
    hourglass_density: NDArray[np.float64]
    growth: NDArray[np.float64]

class _RawState(TypedDict):
    u: NDArray[np.uint8]
    u_prev: NDArray[np.uint8]
    history: NDArray[np.uint8]
    clock_start: float
    clock_steps: int
    dt: float
    n_steps: int
    starts: bool
    limit_squares: NDArray[np.float64]
    limit_square: float
    sliding: NDArray[np.uint8]

def choose_kernels(
    device: str,
    precision: str,
    hourglass: str,
    *,
    kernels: str,
    tile: tuple[int, int, int] = (16, 8, 0),
    registers: int = 0,
) -> None: ...

class Simulator:
    def __init__(
        self,
        device: Device,
        model: VoxelModel,
        *,
        precision: str,
        hourglass: str,
        kappa: float,
        damping: float,
        kernels: str = "auto",
        n_bands: int = 0,
        tile: tuple[int, int, int] = (16, 8, 0),
        registers: int = 0,
        conditions: Conditions | None = None,
        sliding: SlidingNodes | None = None,
    ) -> None: ...
    def step(
        self,
        n: int,
        activations: ArrayLike,
        values: ArrayLike | None = None,
        keys: ArrayLike | None = None,
    ) -> None: ...
    @property
    def n_prescribed(self) -> int: ...
    @property
    def n_pose_values(self) -> int: ...
    def first_key(self) -> int: ...
    def last_key(self, steps: int) -> int: ...
    def key_time(self, key: int) -> float: ...
    def set_prescribed(self, values: ArrayLike, fields: ArrayLike) -> None: ...
    def external_force(self, values: ArrayLike) -> NDArray[np.float64]: ...
    def begin_relaxation(self, node_mass: ArrayLike) -> None: ...
    def relax(
        self, steps: ArrayLike, activations: ArrayLike, values: ArrayLike, keys: ArrayLike
    ) -> None: ...
    def end_relaxation(self) -> None: ...
    def in_double(self) -> Simulator: ...
    def take_state(self, other: Simulator) -> None: ...
    def relaxation_masses(self) -> NDArray[np.float64]: ...
    def sliding_normals(self) -> NDArray[np.float64]: ...
    def friction_losses(self) -> NDArray[np.float64]: ...
    def finish(self) -> None: ...
    @property
    def dt(self) -> float: ...
    @dt.setter
    def dt(self, dt: float) -> None: ...
    def bound_at_rest(self) -> tuple[float, int, int]: ...
    def limit_now(
        self,
        activations: ArrayLike,
        enough: float,
        reach_low: float = 1.0,
        reach_high: float = 1.0,
    ) -> tuple[float, int, int, bool]: ...
    def measured_limit(self, activations: ArrayLike) -> tuple[float, int, int]: ...
    @property
    def time(self) -> float: ...
    @property
    def starts(self) -> bool: ...
    def time_after(self, steps: int) -> float: ...
    @property
    def n_steps(self) -> int: ...
    @property
    def uses_rows(self) -> bool: ...
    @property
    def kernels(self) -> str: ...
    @property
    def fill(self) -> float: ...
    @property
    def device_bytes(self) -> int: ...
    @property
    def lanes(self) -> int: ...
    @property
    def n_blocks(self) -> int: ...
    @property
    def axis_order(self) -> list[int]: ...
    @property
    def single(self) -> bool: ...
    def node_slots(self) -> NDArray[np.int64]: ...
    def node_masses(self) -> NDArray[np.float64]: ...
    def displacement(self) -> NDArray[np.float64]: ...
    def velocity(self) -> NDArray[np.float64]: ...
    def set_state(self, u: ArrayLike, velocity: ArrayLike, time: float) -> None: ...
    def raw_state(self) -> _RawState: ...
    def set_raw_state(
        self,
        *,
        u: ArrayLike,
        u_prev: ArrayLike,
        history: ArrayLike,
        clock_start: float,
        clock_steps: int,
        dt: float,
        n_steps: int,
        starts: bool,
        limit_squares: ArrayLike,
        limit_square: float,
        sliding: ArrayLike | None = None,
    ) -> None: ...
    def internal_force(self, activations: ArrayLike, /) -> NDArray[np.float64]: ...
    def element_state(self, activations: ArrayLike, /) -> _ElementState: ...
    def first_non_finite_node(self) -> int: ...
    @property
    def buffer_address(self) -> int: ...
    @property
    def buffer_handle(self) -> int: ...

def copy_bandwidth() -> float: ...
