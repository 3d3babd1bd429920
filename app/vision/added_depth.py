"""What depth maps add to a scene: to a pair's parallax, or in its place where there is one view.

Views whose photographs have depth maps and the scene -> the scene with them, if the table that they show is the
reference's; else without them and with the flag "depth_ignored". The marker, or the rig, decides the scale.
"""

from dataclasses import replace

import numpy as np

from app.vision.model import MaskArray, View
from app.vision.shape.tuning import TUNING
from app.vision.stereo.depth_fusion import agree_with_table, fuse_depths
from app.vision.stereo.depth_parallax import parallax_of_depth
from app.vision.stereo.disparity import DisparityMap, unmatched
from app.vision.stereo.reconstruction import back_project
from app.vision.stereo.rectification import RectifiedPair
from app.vision.stereo.relative_pose import RefinedViews
from app.vision.stereo.single_view import SingleView
from app.vision.trace import Reconstruction

TABLE_MM = 8.0  # over or under the marker's plane: where a pair's points tell how far the table is
IGNORED = ("depth_ignored",)


def parallax_alone(pair: RectifiedPair, view: View, sheet: MaskArray) -> tuple[DisparityMap, tuple[str, ...]]:
    """The parallax of a single view by its depth map, in the scale of the marker if there is one, and flags.

    sheet: (H, W) where the marker is seen; nowhere without one.
    """
    if view.photo.depth is None:
        return unmatched(pair.shape), ()
    shown = parallax_of_depth(pair, view, view.photo.depth)
    if view.marker is None:
        return shown, ()
    print_share = pair.first_centre_mm[2] / (pair.first_centre_mm[2] - view.marker.spec.thick_mm)
    print_px = pair.parallax_from_disparity(pair.plane_disparity_px() * np.float32(print_share))
    agreed = agree_with_table(pair, shown, print_px, sheet, has_tilt=False)
    return (unmatched(pair.shape), IGNORED) if agreed is None else (agreed, ())


def add_depth_maps(scene: Reconstruction, refined: RefinedViews | SingleView) -> Reconstruction:
    """A pair's scene with the depth maps of its photographs; a single view's is its map's already."""
    if isinstance(refined, SingleView):
        return scene
    pair, match = scene.rectified, scene.disparity
    views = (refined.first, refined.second)
    maps = [parallax_of_depth(pair, view, view.photo.depth) for view in views if view.photo.depth is not None]
    is_table = np.abs(scene.points_table[..., 2]) < TABLE_MM
    agreed = [agree_with_table(pair, each, match.parallax_px, is_table, has_tilt=True) for each in maps]
    depths = tuple(each for each in agreed if each is not None)
    flags = IGNORED if len(depths) < len(maps) else ()
    if not depths:
        return replace(scene, flags=flags)
    fused = fuse_depths(pair, match, depths, TUNING.dense_sd_px)
    points = back_project(pair, scene.depth.depth_mm(pair.disparity_from_parallax(fused.parallax_px)))
    return replace(scene, disparity=fused, points_table=points, depths=depths, flags=flags)
