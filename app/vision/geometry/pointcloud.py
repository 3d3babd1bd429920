"""Point clouds as PLY, the format that viewers of scanned shapes read: binary, little endian, with colours."""

import numpy as np

from app.vision.model import Float64Array, ImageArray

VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])


def write_ply(points_mm: Float64Array, colours_bgr: ImageArray) -> bytes:
    """A PLY file of (n, 3) points in mm with (n, 3) uint8 BGR colours. Raises ValueError if the lengths differ."""
    if len(points_mm) != len(colours_bgr):
        raise ValueError(f"There are {len(points_mm)} points, but {len(colours_bgr)} colours.")
    vertices = np.zeros(len(points_mm), VERTEX)
    vertices["xyz"] = points_mm
    vertices["rgb"] = colours_bgr[:, ::-1]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment table frame, mm, z up from the marker's plane",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {colour}" for colour in ("red", "green", "blue")),
        "end_header",
    ]
    return ("\n".join(header) + "\n").encode("ascii") + vertices.tobytes()
