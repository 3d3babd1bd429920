"""The values that pass between the steps: photographs, marker, camera, views, hints, options, estimates.

Frozen dataclasses only, no behaviour beyond what their fields define; frames and signs: CONVENTIONS.md.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.core.errors import Failure
from app.vision.intrinsics import Camera
from app.vision.known_object import KnownObject
from app.vision.known_poses import KnownPoses
from app.vision.marker_spec import MarkerSpec
from app.vision.rig import StereoRig
from app.vision.vessel_library import VesselModel

Float64Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Int64Array = NDArray[np.int64]
ImageArray = NDArray[np.uint8]
MaskArray = NDArray[np.bool_]

Method = Literal["shape", "paper", "paper-strict"]
SliceForm = Literal["circle", "ellipse"]
FoodForm = Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"]
ColourKind = Literal["colour", "white", "none"]


@dataclass(frozen=True, slots=True)
class DepthMap:
    """Depth along the optical axis of a pinhole in its photograph's pose. depth_mm: (h, w), NaN: not measured.

    fx, fy, cx, cy: px of the map. sd_share: noise over depth. error_area_px: of the map, over which errors are one.
    is_aligned: its pixels are the photograph's, reduced; fx, fy, cx, cy count for nothing until the photograph's camera
    is known (views/aligned_depth.py). is_relative: 1 / depth_mm is an unknown affine function of the inverse depth.
    """

    depth_mm: Float32Array
    fx: float
    fy: float
    cx: float
    cy: float
    sd_share: float
    error_area_px: float
    is_aligned: bool = False
    is_relative: bool = False


@dataclass(frozen=True, slots=True)
class Photo:
    """One decoded photograph, upright. pixels_bgr: (H, W, 3) uint8. focal_35mm: EXIF's 35 mm equivalent, mm.

    model: the phone's, as EXIF names it. depth: measured beside it. orientation: EXIF's, of the stored file, which has
    been applied; known poses need it.
    """

    pixels_bgr: ImageArray
    focal_35mm: float | None = None
    model: str | None = None
    depth: DepthMap | None = None
    orientation: int = 1


@dataclass(frozen=True, slots=True)
class PhotoPair:
    """The left and the right photograph, as the phone named them, and others of the same scene.

    right: None where there is but one photograph.
    """

    left: Photo
    right: Photo | None = None
    others: tuple[Photo, ...] = ()

    @property
    def both(self) -> tuple[Photo, Photo]:
        """Left and right. Raises ValueError for a single photograph."""
        if self.right is None:
            raise ValueError("There is one photograph only.")
        return self.left, self.right


@dataclass(frozen=True, slots=True)
class MarkerObservation:
    """The marker in one photograph: (n, 2) of the print's points, px, in the print's order (CONVENTIONS.md).

    point_ids: (n,) which of the print's points they are, ascending; None: all of them, as of every checkerboard. A
    board of tags may be partly covered.
    """

    spec: MarkerSpec
    corners_px: Float64Array
    point_ids: Int64Array | None = None

    def seen_of(self, points: Float64Array) -> Float64Array:
        """Those of (m, ...), one row per point of the print, that are observed."""
        return points if self.point_ids is None else points[self.point_ids]

    @property
    def grid_px(self) -> Float64Array:
        """(rows - 1, columns - 1, 2) the corners of a checkerboard."""
        return self.corners_px.reshape(self.spec.rows - 1, self.spec.columns - 1, 2)


@dataclass(frozen=True, slots=True)
class ColourCorrection:
    """What brings one photograph's colours to those under neutral light, exposed for the marker (color.py).

    matrix: (3, 3) in linear sRGB, red first: corrected = matrix @ as taken. kind: "colour", from the colour board's
    colours; "white", one gain a channel from its paper; "none", the identity. delta_e_mean, delta_e_worst: CIEDE2000
    of the coloured squares at the board's own exposure, None without them. flags: stable codes.
    """

    matrix: Float64Array
    kind: ColourKind
    delta_e_mean: float | None = None
    delta_e_worst: float | None = None
    flags: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class View:
    """One photograph with its camera and pose: x_camera = rotation @ x_table + translation_mm.

    rotation: (3, 3); translation_mm: (3,). marker: None for a rig's, whose table is found in the scene. rms_px:
    reprojection error of the marker's corners, 0 without a marker. known: the thing of known size that lies at the
    table frame's origin, where it gave the scale.
    """

    photo: Photo
    camera: Camera
    marker: MarkerObservation | None
    rotation: Float64Array
    translation_mm: Float64Array
    rms_px: float
    known: KnownObject | None = None

    @property
    def centre_mm(self) -> Float64Array:
        """(3,) camera centre in the table frame, mm."""
        return -self.rotation.T @ self.translation_mm

    @property
    def required_marker(self) -> MarkerObservation:
        """The marker. Raises ValueError for a view without one."""
        if self.marker is None:
            raise ValueError("This view has no marker: its poses come from a rig.")
        return self.marker


@dataclass(frozen=True, slots=True)
class Hint:
    """Where a food is in the left photograph, px upright, and what it is.

    point (x, y), box (x, y, width, height) or polygon (rings of corners, holes by the even-odd rule). form: how the
    food lies there, as a person says; usual_form: as the food table says of this food. vessel: the name of the
    library's vessel that holds it. slice_form: how the paper's method fits its slices (section V); None: decided from
    the slices. food, lies_as: the food table's terms, carried along for the services that weigh the item.
    """

    point: tuple[float, float] | None = None
    box: tuple[float, float, float, float] | None = None
    polygon: tuple[tuple[tuple[float, float], ...], ...] | None = None
    food: str | None = None
    lies_as: str | None = None
    form: FoodForm | None = None
    usual_form: FoodForm | None = None
    usual_height: float | None = None
    vessel: str | None = None
    slice_form: SliceForm | None = None

    @property
    def has_place(self) -> bool:
        """Whether it says where the food is."""
        return self.point is not None or self.box is not None or self.polygon is not None


@dataclass(frozen=True, slots=True)
class LikelyFood:
    """What a food may be by its looks. probability: 0 to 1. height: over its width, as this food has it, if known."""

    form: FoodForm
    probability: float
    height: float | None = None


FoodsByLooks = Callable[[Float64Array], Sequence[LikelyFood]]


@dataclass(frozen=True, slots=True)
class EstimateOptions:
    """What the pipeline is told beside the photographs.

    marker, known, rig: where the scale comes from; with a rig, nothing else is looked for and camera is not used.
    poses: give it where there is no rig, and no marker or none is seen. camera: for upright pixels; None: from EXIF.
    is_complete: the hints are all that there is, and no other food is looked for. vessels: the study's library. seed:
    for its draws.
    foods_by_looks: what an index of foods says of a food, by its description (d,) of looks/vcm.py, for a single view.
    """

    marker: MarkerSpec | None
    camera: Camera | None = None
    method: Method = "shape"
    hints: tuple[Hint, ...] = ()
    is_complete: bool = False
    vessels: tuple[VesselModel, ...] = ()
    seed: int = 0
    rig: StereoRig | None = None
    poses: KnownPoses | None = None
    foods_by_looks: FoodsByLooks | None = None
    known: KnownObject | None = None

    @property
    def marker_text(self) -> str | None:
        """Return the board or the known object that was announced, as text."""
        announced = self.marker or self.known
        return None if announced is None else str(announced)


@dataclass(frozen=True, slots=True)
class ItemTraits:
    """What an item is known again by in another pair of the same meal; None: not to be seen.

    centre_mm: (x, y) in the table frame, the middle of its surface; radius_mm: of a disc that spreads as far. lab:
    CIELAB (D65), the mean over it, colours corrected by the marker.
    """

    centre_mm: tuple[float, float] | None = None
    radius_mm: float | None = None
    lab: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class ItemEstimate:
    """One food: its outline, its volume and the doubt about it.

    rings: (n, 2) outlines in the left photograph, px, outer ring first, then holes (even-odd rule).
    volume_ml: None where too little is seen to tell (flag "not_measurable"): the interval is None, relative_sd empty.
    volume_interval_ml: 90 %. relative_sd: the volume's relative standard deviations by part, which add up in squares:
    "pair" is shared by all items of the pair (pose, scale), "item" is its own.
    hint: index into options.hints of the hint that this item answers, or None. flags: stable codes.
    vcm: what it looks like in the left photograph (vcm.py, of vcm.VCM_VERSION); None where nothing of it is in view.
    """

    rings: tuple[Float64Array, ...]
    volume_ml: float | None
    volume_interval_ml: tuple[float, float] | None
    relative_sd: Mapping[str, float]
    hint: int | None = None
    flags: tuple[str, ...] = ()
    traits: ItemTraits = ItemTraits()
    vcm: Float32Array | None = None


@dataclass(frozen=True, slots=True)
class Artefact:
    """A picture or a point cloud of one step: name such as "matches.jpg", media type, bytes."""

    name: str
    media_type: str
    content: bytes


@dataclass(frozen=True, slots=True)
class MealEstimate:
    """What one run of the pipeline found. failure and items exclude each other.

    views: (left, right), or None if it failed before; right is None where one photograph was measured. stages: seconds
    by step, in order.
    parameters: what the run depended on beside its inputs and the version (for the record).
    colours: the corrections of the (left, right) photograph, or None if a marker was not found. second_place: which
    photograph views, colours and artefacts have as the right one, counted from the left one's 0; 1: the right one.
    """

    method: Method
    pipeline_version: str
    stages: Mapping[str, float]
    items: tuple[ItemEstimate, ...] = ()
    failure: Failure | None = None
    views: tuple[View, View | None] | None = None
    parameters: Mapping[str, object] = field(default_factory=dict)
    artefacts: Sequence[Artefact] = ()
    colours: tuple[ColourCorrection, ColourCorrection] | None = None
    second_place: int = 1
