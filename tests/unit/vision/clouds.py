"""Point clouds of solids of known volume, as a camera sees them from one side."""

from dataclasses import dataclass

import numpy as np

from app.vision.model import Float64Array

CAMERA_MM = np.array([100.0, -320.0, 300.0])
PLACE_MM = np.array([100.0, 50.0, 0.0])


@dataclass(frozen=True)
class Cloud:
    points_mm: Float64Array
    volume_ml: float

    @property
    def towards_camera(self) -> Float64Array:
        away = CAMERA_MM[:2] - PLACE_MM[:2]
        return away / np.linalg.norm(away)


def ellipsoid(a, b, c, heading=0.0, seed=0, count=60_000) -> Cloud:
    """Half-axes a, b (horizontal) and c, standing on z = 0."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    return _seen(u * [a, b, c] + [0, 0, c], u / [a, b, c], heading, 4 / 3 * np.pi * a * b * c / 1000, rng)


def box(a, b, height, heading=0.0, seed=0, count=60_000) -> Cloud:
    """Sides a, b and height."""
    rng = np.random.default_rng(seed)
    faces = [(a * b, 2), (a * height, 1), (b * height, 0)]
    parts, normals = [], []
    for area, axis in faces:
        for side in (-1.0, 1.0):
            n = int(count * area / (2 * sum(each for each, _ in faces)))
            p = rng.uniform(-0.5, 0.5, (n, 3))
            p[:, axis] = side / 2
            normal = np.zeros((n, 3))
            normal[:, axis] = side
            parts.append(p * [a, b, height] + [0, 0, height / 2])
            normals.append(normal)
    return _seen(np.concatenate(parts), np.concatenate(normals), heading, a * b * height / 1000, rng)


def cylinder(radius, height, seed=0, count=60_000) -> Cloud:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, count)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    side = ring * radius + np.column_stack([np.zeros((count, 2)), rng.uniform(0, height, count)])
    r = radius * np.sqrt(rng.uniform(0, 1, count // 2))
    lid = ring[: count // 2] * r[:, None] + [0, 0, height]
    normals = np.concatenate([ring, np.tile([0.0, 0.0, 1.0], (count // 2, 1))])
    return _seen(np.concatenate([side, lid]), normals, 0.0, np.pi * radius**2 * height / 1000, rng)


def _seen(points, normals, heading, volume_ml, rng) -> Cloud:
    turn = np.array(
        [[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]], np.float64
    )
    points, normals = points @ turn.T + PLACE_MM, normals @ turn.T
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    view = CAMERA_MM - points
    view /= np.linalg.norm(view, axis=1)[:, None]
    facing = (normals * view).sum(axis=1)
    # A camera samples what faces it more densely, and stereo fails at grazing incidence.
    keep = (facing > 0.15) & (rng.random(len(points)) < facing)
    noisy = points[keep] + view[keep] * rng.normal(0, 0.3, (int(keep.sum()), 1))
    return Cloud(noisy, volume_ml)
