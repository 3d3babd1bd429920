"""Choose a meal's camera or rig, in order: from its metadata, its phone's calibration, that of the model, the study's.

A calibration that does not fit the photographs (another aspect ratio) is skipped. A camera or rig
of the meal's metadata never is, so that a wrong one is reported. If there is no camera, EXIF gives
the focal length.
"""

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median
from typing import Literal

from sqlalchemy.orm import Session

from app.core.errors import Failure
from app.meals.stored.models import Meal
from app.meals.stored.run_answer import RunAnswer
from app.people import calibration_queries as calibrations
from app.people.models import CameraCalibration, CameraDetails, Study
from app.photos.slots import PAIR_SLOTS
from app.vision.intrinsics import Camera, adapt_camera, camera_from_mapping
from app.vision.rig import StereoRig, adapt_rig, rig_from_mapping, rig_to_json

Size = tuple[int, int]  # width, height, px, upright
ChosenFrom = Literal["meal", "device", "model", "study", "exif"]


@dataclass(frozen=True, slots=True)
class ChosenCamera:
    """camera None: from EXIF, or the rig's.

    calibrations: those that the camera was computed from, or the rig is.
    """

    camera: Camera | None
    chosen_from: ChosenFrom
    calibrations: tuple[uuid.UUID, ...] = ()
    rig: StereoRig | None = None

    def note_in(self, answer: RunAnswer) -> None:
        """Record the choice in a run's answer."""
        answer.parameters["camera_from"] = self.chosen_from
        if self.rig is not None:
            answer.parameters["rig"] = rig_to_json(self.rig)
        for camera in (answer.camera, answer.camera_right):
            if camera is not None:
                camera |= {
                    "chosen_from": self.chosen_from,
                    "calibrations": [str(each) for each in self.calibrations],
                }


def choose_camera(
    session: Session,
    *,
    meal_camera: CameraDetails | None,
    device_id: uuid.UUID,
    study: Study,
    sizes: Sequence[Size],
) -> ChosenCamera:
    """Choose the camera for photographs of these sizes. meal_camera: of the meal's metadata."""
    if meal_camera is not None:
        return ChosenCamera(camera_from_mapping(meal_camera), "meal")
    for chosen in _stored(session, device_id, study, sizes):
        if chosen.camera is not None and _fits(chosen.camera, sizes):
            return chosen
    return ChosenCamera(None, "exif")


def choose_rig(
    session: Session, *, meal: Meal, study: Study, sizes: Sequence[Size], has_depth: bool
) -> ChosenCamera | None:
    """Choose the rig for a pair of the meal; None: the marker, the poses or a depth map give the scale.

    sizes: of all of its photographs. A marker of the meal's own metadata goes before stored rigs,
    and these go before the study's marker. There, a rig serves only meals that came after it and
    name no camera or poses of their own: the others were taken by hand beside the marker. If no
    stored rig fits and nothing else gives the scale, the first is chosen, so that the mismatch is
    reported.
    """
    own = meal.details.get("rig")
    if own is not None:
        return ChosenCamera(None, "meal", rig=rig_from_mapping(own))
    if meal.details["marker"] is not None or len(sizes) != len(PAIR_SLOTS):
        return None
    has_poses = meal.details.get("poses") is not None
    if study.marker is not None and (has_poses or meal.details["camera"] is not None):
        return None
    rigs = list(
        stored_rigs(
            session,
            meal.device_id,
            study.id,
            meal.received_at if study.marker is not None else None,
        )
    )
    fitting = (
        each
        for each in rigs
        if each.rig is not None and not isinstance(adapt_rig(each.rig, *sizes), Failure)
    )
    is_only_scale = study.marker is None and not has_poses and not has_depth
    return next(fitting, rigs[0] if rigs and is_only_scale else None)


def stored_rigs(
    session: Session, device_id: uuid.UUID, study_id: uuid.UUID, before: datetime | None = None
) -> Iterator[ChosenCamera]:
    """Yield the rigs that a phone's meals may use: its own, its model's, the study's.

    before: kept by then.
    """
    own = calibrations.newest_rig_of_device(session, device_id, before)
    if own is not None:
        yield _chosen_rig(own, "device")
    model = calibrations.model_of_device(session, device_id)
    places: tuple[tuple[ChosenFrom, str | None], ...] = (("model", model), ("study", None))
    for chosen_from, of_model in places if model is not None else places[1:]:
        row = calibrations.newest_rig_of_study(session, study_id, of_model, before)
        if row is not None:
            yield _chosen_rig(row, chosen_from)


def _chosen_rig(row: CameraCalibration, chosen_from: ChosenFrom) -> ChosenCamera:
    return ChosenCamera(None, chosen_from, (row.id,), rig_from_mapping(row.rig))


def median_camera(cameras: Sequence[Camera], size: Size) -> Camera | None:
    """Return the component-wise median of the cameras that can be adapted to this size; None if none can."""
    adapted = [
        each
        for each in (adapt_camera(camera, *size) for camera in cameras)
        if not isinstance(each, Failure)
    ]
    if not adapted:
        return None
    k1, k2, p1, p2, k3 = (
        median(camera.distortion[place] for camera in adapted) for place in range(5)
    )
    return Camera(
        *size,
        fx=median(camera.fx for camera in adapted),
        fy=median(camera.fy for camera in adapted),
        cx=median(camera.cx for camera in adapted),
        cy=median(camera.cy for camera in adapted),
        distortion=(k1, k2, p1, p2, k3),
        source="given",
    )


def _stored(
    session: Session, device_id: uuid.UUID, study: Study, sizes: Sequence[Size]
) -> Iterator[ChosenCamera]:
    own = calibrations.newest_of_device(session, device_id)
    if own is not None:
        yield ChosenCamera(camera_from_mapping(own.camera), "device", (own.id,))
    model = calibrations.model_of_device(session, device_id)
    if model is not None:
        rows = calibrations.newest_of_model(session, study.id, model)
        fitting = [row for row in rows if _fits(camera_from_mapping(row.camera), sizes)]
        camera = median_camera([camera_from_mapping(row.camera) for row in fitting], sizes[0])
        if camera is not None:
            yield ChosenCamera(camera, "model", _ids(fitting))
    if study.camera is not None:
        yield ChosenCamera(camera_from_mapping(study.camera), "study")


def _fits(camera: Camera, sizes: Sequence[Size]) -> bool:
    return not any(isinstance(adapt_camera(camera, *size), Failure) for size in sizes)


def _ids(rows: Sequence[CameraCalibration]) -> tuple[uuid.UUID, ...]:
    return tuple(sorted(row.id for row in rows))
