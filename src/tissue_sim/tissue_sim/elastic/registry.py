"""Models by name."""

from __future__ import annotations

import numpy as np

from tissue_sim.elastic.chain_mail import ChainMail
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.lingering import WIDEN_EVERY
from tissue_sim.elastic.local_relaxation import LocalRelaxation
from tissue_sim.elastic.material_field import MaterialError
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, Model, Parameter, RegionMaterial, State
from tissue_sim.elastic.quasi_static import QuasiStatic
from tissue_sim.elastic.relaxation import Relaxation
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.elastic.voxel_mail import VoxelMail
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import count_flat
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sutures import DEFAULT_STIFFNESS

MODELS: dict[str, type[MeshModel]] = {
    model.name: model
    for model in (
        QuasiStatic,
        Relaxation,
        LocalRelaxation,
        SpringMass,
        FiniteElement,
        VertexBlockDescent,
        ChainMail,
        VoxelMail,
    )
}

VARIANTS: tuple[tuple[str, dict[str, float]], ...] = (
    ("finite_element", {"corotated": 1}),
    ("vertex_block_descent", {"dynamic": 1}),
    ("spring_mass", {"volume_stiffness": 1.0}),
    ("spring_mass", {"home_stiffness": 1.0}),
)
"""Parameters with which steps call kernels that they do not call by default."""


def names() -> list[str]:
    """Names of the models."""
    return sorted(MODELS)


def anisotropic_names() -> list[str]:
    """Names of the models that know fibres."""
    return [name for name in names() if MODELS[name].anisotropic]


def parameters_of(name: str) -> tuple[Parameter, ...]:
    """What can be set on a model.

    Raises:
        ValueError: No model has this name.
    """
    if name not in MODELS:
        raise ValueError(f"there is no model {name!r}; allowed: {', '.join(names())}")
    return MODELS[name].parameters


def checked_parameters(name: str, values: dict[str, float]) -> dict[str, float]:
    """All parameters of a model: the given values, checked, and defaults for the others.

    Raises:
        ValueError: No model has this name, it has no such parameter, or a value is out of range.
    """
    known = {parameter.name: parameter for parameter in parameters_of(name)}
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ValueError(
            f"model {name} has no parameter {', '.join(map(repr, unknown))}; "
            f"allowed: {', '.join(known)}"
        )
    return {
        key: parameter.checked(values[key]) if key in values else parameter.default
        for key, parameter in known.items()
    }


def build(
    name: str,
    mesh: Mesh,
    material: Material,
    parameters: dict[str, float] | None = None,
    springs: SpringNetwork | None = None,
) -> Model:
    """Build a model, its kernels compiled.

    Args:
        name: Name of the model.
        mesh: The mesh to simulate.
        material: What it is made of.
        parameters: Values that differ from the defaults.
        springs: The spring network of a model of the same mesh and material (its `springs`), to
            share it and build in less time; a network of another mesh, material or version is not
            used.

    Raises:
        ValueError: Unknown name or parameter, a value out of range, or a material that makes no
        sense.
    """
    values = checked_parameters(name, parameters or {})
    check_material(material)
    check_geometry(name, mesh)
    check_elements(mesh)
    if springs is not None and not _fits(springs, mesh, material):
        springs = None
    model = MODELS[name](mesh, material, values, springs)
    if model.springs.field.fibrous and not model.anisotropic:
        model.events.append(
            f"model {name} has no fibres: fibre_stiffness does nothing here; "
            f"models that have them: {', '.join(anisotropic_names())}"
        )
    return model


def _fits(springs: SpringNetwork, mesh: Mesh, material: Material) -> bool:
    return springs.mesh is mesh and springs.material == material and springs.version == mesh.version


def check_material(material: Material) -> None:
    """Refuse a material that makes no sense.

    Raises:
        MaterialError: A number is not finite or out of range.
    """
    for part in material.parts:
        _check_part(part, f"region {part.region}: " if part.region else "")


def _check_part(part: RegionMaterial, where: str) -> None:
    for name, value, low, high, unit in (
        ("young_modulus", part.young_modulus, 1.0, 1e12, " Pa"),
        ("density", part.density, 1.0, 1e5, " kg/m^3"),
        ("fibre_stiffness", part.fibre_stiffness, 0.0, 1e12, " Pa"),
    ):
        if not low <= value <= high:
            raise MaterialError(
                f"{where}{name} = {value:g} is out of range; allowed: {low:g} to {high:g}{unit}"
            )
    if not 0.0 <= part.poisson_ratio < 0.5:
        raise MaterialError(
            f"{where}poisson_ratio = {part.poisson_ratio:g} is out of range; "
            "allowed: 0 up to, not including, 0.5"
        )


def check_geometry(name: str, mesh: Mesh) -> None:
    """Refuse a model that needs tetrahedra where there are none.

    Raises:
        ValueError: The tissue is made of triangles; the message names the models it can have.
    """
    if mesh.sheet is not None and MODELS[name].needs_tetrahedra:
        allowed = ", ".join(other for other in names() if not MODELS[other].needs_tetrahedra)
        raise ValueError(
            f"model {name} needs tetrahedra, and {mesh.name} is made of surfaces; "
            f"allowed: {allowed}, or geometry_kind volume"
        )


def check_elements(mesh: Mesh) -> None:
    """Refuse elements that no model can carry: masses, stiffnesses and forces divide by volumes.

    Raises:
        ValueError: An element has no positive volume at rest.
    """
    tets = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    if mesh.sheet_rows is not None:
        return  # `geometry.sheet.checked_sheet` and the checks of edits see to it.
    nowhere = np.full(mesh.node_capacity, -1, dtype=np.int32)
    flat = count_flat(mesh.rest, nowhere, np.empty((0, 3)), tets)
    if flat:
        raise ValueError(
            f"{flat} of {len(tets)} elements are flat or inside out at rest; "
            "allowed: right-handed tetrahedra of positive volume"
        )


def warm_up(dtype: type[np.floating] = np.float32) -> None:
    """Compile, or load from the cache, every kernel, so that no frame has to wait for it."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=np.float64)
    tets = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    held = np.array([4], dtype=np.int32)
    defaults: list[tuple[str, dict[str, float]]] = [(name, {}) for name in names()]
    for name, values in (*defaults, *VARIANTS):
        mesh = Mesh(RawMesh(corners, tets), np.arange(len(corners)) == 0)
        springs = SpringNetwork(mesh, Material(), dtype)
        model = MODELS[name](mesh, Material(), checked_parameters(name, values), springs)
        state = State(mesh, dtype)
        state.prescribed[held] = True
        model.prescribed_changed(state, held)
        state.displacement[held] = 0.1
        if model.takes_guess:
            model.guess(state, state.displacement, state.displacement)
        model.step(state)
        model.forces(state, held)
        model.residual(state)
        state.prescribed[held] = False
        model.prescribed_changed(state, held[:0])
        change = mesh.apply(_small_split(mesh))
        state.follow(mesh, change)
        model.topology_changed(change, state)
        for _ in range(2 * WIDEN_EVERY):
            model.step(state)
        change = mesh.apply(_small_stitch(mesh))
        state.follow(mesh, change)
        model.topology_changed(change, state)
        state.displacement[1] += 0.05
        for _ in range(4):
            model.step(state)
        model.forces(state, np.array([1], dtype=np.int32))
        model.residual(state)


def _small_split(mesh: Mesh) -> TopologyEdit:
    copy = np.array([PROVISIONAL], dtype=np.uint32)
    return TopologyEdit(
        mesh.version,
        copied_nodes=copy,
        copy_parents=np.array([1], dtype=np.uint32),
        rewritten_elements=np.array([1], dtype=np.uint32),
        rewritten_nodes=np.array([[PROVISIONAL, 2, 3, 4]], dtype=np.uint32),
    )


def _small_stitch(mesh: Mesh) -> TopologyEdit:
    new = np.array([PROVISIONAL], dtype=np.uint32)
    return TopologyEdit(
        mesh.version,
        kind="suture",
        added_sutures=new,
        suture_nodes=np.array([[1, 5]], dtype=np.uint32),
        suture_lengths=np.array([0.01]),
        suture_stiffness=np.array([DEFAULT_STIFFNESS]),
        suture_groups=new,
    )
