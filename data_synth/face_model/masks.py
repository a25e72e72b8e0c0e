"""Which vertices may take a depth correspondence: frontal skin that a camera in front can see."""

from __future__ import annotations

import numpy as np
import trimesh

from adaptiveface.geometry.mesh import vertex_normals

from .anatomy import Anatomy

DIRECTIONS = 600
CONE_DEGREES = 60.0
GRAZING = 0.1  # cosine below which a direction does not count as seeing the vertex
MIN_VISIBILITY = 0.12
LIFT_MM = 0.3


def frontal_visibility(vertices, triangles, eye_vertices, eye_triangles) -> np.ndarray:
    """(V,) share of directions in a cone about +z from which a vertex is seen past skin and eyeballs."""
    k = np.arange(DIRECTIONS)
    turn = np.pi * (1 + np.sqrt(5)) * k  # Fibonacci lattice on the spherical cap
    cosine = 1 - (k + 0.5) / DIRECTIONS * (1 - np.cos(np.radians(CONE_DEGREES)))
    sine = np.sqrt(1 - cosine**2)
    directions = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    scene = trimesh.Trimesh(
        np.concatenate([vertices, eye_vertices]), np.concatenate([triangles, eye_triangles + len(vertices)]), process=False
    )
    rays = trimesh.ray.ray_pyembree.RayMeshIntersector(scene)
    normals = vertex_normals(vertices, triangles)
    seen = np.zeros(len(vertices))
    for direction in directions:
        free = ~rays.intersects_any(vertices + LIFT_MM * normals, np.broadcast_to(direction, vertices.shape))
        seen += free & (normals @ direction > GRAZING)
    return seen / DIRECTIONS


def depth_mask(mean, anatomy: Anatomy, eye_vertices, eye_triangles) -> np.ndarray:
    """(V,) bool, symmetric: frontal, not inner lip, not a lid's rim, visible."""
    mesh = anatomy.mesh
    visible = frontal_visibility(mean, mesh.triangles, eye_vertices, eye_triangles) >= MIN_VISIBILITY
    valid = visible & visible[mesh.mirror] & ~anatomy.inner_lip
    valid[mesh.both("lid_upper", "lid_lower")] = False
    valid[mesh.n_frontal :] = False
    return valid
