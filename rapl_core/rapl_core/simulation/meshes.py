"""Low-poly copies of visual meshes, so that software GL keeps up: decimated once, then cached."""

import hashlib
import os
import tempfile
from pathlib import Path

import fast_simplification
import mujoco
import numpy as np
from numpy.typing import NDArray

CACHE_FORMAT = 2
STUBBORN = 4.0
"""Times the wanted triangles: above it a mesh counts as one that cannot be simplified as it is."""
FIRST_CELL, LARGEST_CELL = 0.002, 0.015
"""m"""


def cache_folder() -> Path:
    """Return where decimated meshes are kept: $RAPL_CACHE or the user's cache folder."""
    base = os.environ.get("RAPL_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME", os.path.expanduser("~/.cache")), "rapl"
    )
    return Path(base) / "meshes"


def decimate_visuals(spec: mujoco.MjSpec, visual_group: int, triangles: int) -> None:
    """Replace the visual meshes of ``spec`` in place by copies that share out ``triangles``.

    Each mesh keeps a share of the triangles in proportion to the square root of its own
    number, so that small parts do not vanish. Meshes that collide keep their shape.

    :param visual_group: geom group of the geoms that are only drawn.
    :param triangles: about how many triangles the visual meshes have together afterwards.
    """
    drawn = {g.meshname for g in spec.geoms if g.group == visual_group and g.meshname}
    if not drawn:
        return
    full = _load_meshes(spec, drawn)
    weight = {name: float(np.sqrt(len(faces))) for name, (_, faces) in full.items()}
    total = sum(weight.values())
    for name, (vertices, faces) in full.items():
        target = max(12, round(triangles * weight[name] / total))
        vertices, faces = _decimated(vertices, faces, target)
        spec.add_mesh(
            name=f"{name}_low",
            uservert=vertices.astype(np.float64).ravel(),
            userface=faces.astype(np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
    for geom in spec.geoms:
        if geom.group == visual_group and geom.meshname:
            geom.meshname = f"{geom.meshname}_low"
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)


def drawn_triangles(model: mujoco.MjModel, visual_group: int) -> int:
    """Return how many triangles of visual meshes are drawn.

    :param visual_group: geom group of the geoms that are only drawn.
    """
    is_mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    shown = model.geom_dataid[is_mesh & (model.geom_group == visual_group)]
    return int(model.mesh_facenum[shown].sum())


def _load_meshes(
    spec: mujoco.MjSpec, names: set[str]
) -> dict[str, tuple[NDArray[np.float32], NDArray[np.int32]]]:
    """Return vertices and faces of meshes in the coordinates of their files."""
    model = spec.copy().compile()
    meshes = {}
    for name in names:
        mesh = model.mesh(name)
        first, count = mesh.vertadr[0], mesh.vertnum[0]
        vertices = model.mesh_vert[first : first + count]
        first, count = mesh.faceadr[0], mesh.facenum[0]
        faces = model.mesh_face[first : first + count]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.mesh_quat[mesh.id])
        placed = vertices @ rotation.reshape(3, 3).T + model.mesh_pos[mesh.id]
        meshes[name] = (placed.astype(np.float32), faces.copy())
    return meshes


def _decimated(
    vertices: NDArray[np.float32], faces: NDArray[np.int32], target: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return a mesh of about ``target`` triangles.

    A mesh of many small shells (screws, inner parts) cannot be simplified beyond them: its
    vertices are merged in ever larger cells before.
    """
    low, cell = _simplified(vertices, faces, target), FIRST_CELL
    while len(low[1]) > STUBBORN * target and cell < LARGEST_CELL:
        low = _simplified(*_clustered(vertices, faces, cell), target)
        cell *= 1.5
    return low


def _clustered(
    vertices: NDArray[np.float32], faces: NDArray[np.int32], cell: float
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the mesh with the vertices of each cubic cell merged into their mean."""
    _, place = np.unique(np.floor(vertices / cell), axis=0, return_inverse=True)
    place = place.reshape(-1)
    counts = np.bincount(place)
    merged = np.stack(
        [np.bincount(place, weights=vertices[:, axis]) / counts for axis in range(3)], axis=1
    )
    corners = place[faces].astype(np.int32)
    distinct = (np.diff(np.sort(corners, axis=1), axis=1) > 0).all(axis=1)
    corners = corners[distinct]
    _, first = np.unique(np.sort(corners, axis=1), axis=0, return_index=True)
    return merged.astype(np.float32), corners[np.sort(first)]


def _simplified(
    vertices: NDArray[np.float32], faces: NDArray[np.int32], target: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    if len(faces) <= target:
        return vertices, faces
    digest = hashlib.sha256(f"{CACHE_FORMAT} {target}".encode())
    digest.update(vertices.tobytes())
    digest.update(faces.tobytes())
    path = cache_folder() / f"{digest.hexdigest()[:24]}.npz"
    if path.is_file():
        with np.load(path) as kept:
            return kept["vertices"], kept["faces"]
    # files split vertices by normal and texture: weld them, or the surface falls apart
    welded, place = np.unique(np.round(vertices, 5), axis=0, return_inverse=True)
    faces = place.reshape(-1)[faces].astype(np.int32)
    vertices, faces = fast_simplification.simplify(
        welded, faces, target_reduction=max(0.0, 1 - target / len(faces)), agg=4
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as file:
        np.savez(file, vertices=vertices, faces=faces)
    os.replace(file.name, path)
    return vertices, faces
