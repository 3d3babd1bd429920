"""A meal as its phone describes it, checked and not yet kept.

The fields of the metadata stand in their schemas alone (MealMetadataIn, AfterMetadataIn,
DeclaredMealIn). A draft has them as the meal's row holds them (MealDetails, PairDetails), so that
what is sent again is compared with the row field by field.
"""

import json
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, cast

from pydantic import JsonValue
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError
from app.foods import queries as foods
from app.meals.estimate.camera_choice import stored_rigs
from app.meals.stored.meal_time import MealTime, meal_time
from app.meals.stored.models import (
    HintDetails,
    Meal,
    MealDetails,
    MealImage,
    MealOrigin,
    PairDetails,
    announced_slots,
)
from app.meals.stored.outline_json import rings_of
from app.meals.stored.receive_photo import SealablePhoto
from app.meals.upload.schemas import AfterMetadataIn, DeclaredMealIn
from app.people.access.caller import DeviceCaller
from app.people.calibrate_device import rig_details
from app.people.models import Study
from app.photos.slots import DEPTH_SLOTS, VOICE_NOTE, image_name
from app.records.meal_schemas import MealMetadataIn
from app.vessels.meal_vessels import require_known_vessels
from app.vision.known_object import parse_scale
from app.vision.known_poses import poses_from_mapping
from app.vision.photograph.depth_camera import depth_camera_from_mapping, size_mismatch

# not compared: a repetition may be cut to another policy, or pass through another server
KEPT_ASIDE = frozenset({"ignored", "unknown", "location", "wanted_outcome"})


@dataclass(frozen=True, slots=True)
class MealDraft:
    """A meal to be kept.

    client_id: made by the phone
    details: as the row holds them, but with the location as it was sent
    """

    client_id: uuid.UUID
    time: MealTime
    details: MealDetails
    origin: MealOrigin = "photographed"

    def row(
        self,
        caller: DeviceCaller,
        study: Study,
        meal_id: uuid.UUID,
        location: dict[str, float] | None,
    ) -> Meal:
        """Return the meal's row. location: as the study's policy allows."""
        captured_at = self.time.captured_at.astimezone(UTC)  # as the database returns it
        expects_after = study.expects_after_pair and self.origin == "photographed"
        window = timedelta(minutes=study.after_window_minutes)
        return Meal(
            id=meal_id,
            client_id=self.client_id,
            study_id=caller.study_id,
            participant_id=caller.participant_id,
            device_id=caller.device_id,
            origin=self.origin,
            captured_at=captured_at,
            utc_offset_minutes=self.time.utc_offset_minutes,
            time_zone=self.time.time_zone,
            local_date=self.time.local_date(study.day_starts_minutes),  # computed once, for ever
            details=self.details | {"location": location},
            status="receiving",
            after_due_at=captured_at + window if expects_after else None,
            version=1,
            received_at=datetime.now(UTC),
        )


def draft_meal(
    metadata: MealMetadataIn,
    client_id: uuid.UUID,
    unknown: Mapping[str, JsonValue],
    wanted_outcome: str | None,
) -> MealDraft:
    """Return the draft of a meal with photographs.

    unknown: fields that no model has, by their place
    wanted_outcome: how the estimate is to end, by a MetadataHook
    Raises InvalidInputError (time, zone, marker, rig, poses).
    """
    if metadata.marker is not None:
        parse_scale(metadata.marker)
    time = meal_time(metadata.captured_at, metadata.time_zone, datetime.now(UTC))
    details = _details(metadata, time, unknown)
    if metadata.rig is not None:
        details["rig"] = rig_details(metadata.rig)
    if metadata.depth_camera is not None:
        details["depth_maps"] = metadata.announced_maps
    else:
        details.pop("depth_maps", None)
    if wanted_outcome is not None:
        details["wanted_outcome"] = wanted_outcome
    return MealDraft(client_id, time, cast(MealDetails, details))


def draft_declared(declared: DeclaredMealIn) -> MealDraft:
    """Return the draft of a meal without photographs. Raises InvalidInputError (time, zone)."""
    time = meal_time(declared.captured_at, declared.time_zone, datetime.now(UTC))
    details = {"marker": None, "camera": None, "hints": []} | _details(declared, time, {})
    details["declared"] = details.pop("items")
    for item in details["declared"]:
        # as rows of earlier versions are, with which a repetition is compared
        if not item["copied"]:
            del item["copied"]
    return MealDraft(declared.id, time, cast(MealDetails, details), "declared")


def draft_after(
    metadata: AfterMetadataIn, time_zone: str, unknown: Mapping[str, JsonValue]
) -> PairDetails:
    """Return the metadata of an after-meal pair as the meal's row holds them.

    time_zone: the meal's, unless the metadata name another
    Raises InvalidInputError (time, zone, poses).
    """
    zone = metadata.time_zone or time_zone
    time = meal_time(metadata.captured_at, zone, datetime.now(UTC))
    return cast(PairDetails, _details(metadata, time, unknown))


def changed_fields(details: PairDetails, stored: PairDetails | None) -> list[str]:
    """Return the names of the fields that differ from the stored ones."""
    sent: Mapping[str, object] = details
    before: Mapping[str, object] = stored or {}
    names = (sent.keys() | before.keys()) - KEPT_ASIDE
    return sorted(name for name in names if sent.get(name) != before.get(name))


def other_meal(**facts: object) -> ConflictError:
    """Return the error of an id that another meal has."""
    return ConflictError(
        "A meal with this id is already here with other content. Use a new id for a new meal.",
        code="meal_id_reused",
        **facts,
    )


def require_same(draft: MealDraft, meal: Meal) -> None:
    """Raise ConflictError (`meal_id_reused`) unless the draft is of this meal."""
    if meal.origin != draft.origin:
        raise other_meal()
    changed = changed_fields(draft.details, meal.details)
    if changed:
        raise other_meal(fields=changed)


def require_scale(
    session: Session, device_id: uuid.UUID, study: Study, details: MealDetails
) -> None:
    """Raise InvalidInputError (`marker_missing`) if nothing gives the scale.

    A marker, a rig or the depth map of the left photograph do; of a pair, its poses or a stored
    rig.
    """
    has_scale = (
        "left_depth" in details.get("depth_maps", ())
        or details["marker"] is not None
        or "rig" in details
        or study.marker is not None
    )
    if not has_scale and "views" not in details:
        has_scale = "poses" in details or any(stored_rigs(session, device_id, study.id))
    if not has_scale:
        raise InvalidInputError(
            "Neither the metadata nor the study says which marker lies beside the plate: send "
            "marker, such as plain:9x7:11, or a stereo rig or the cameras' poses.",
            code="marker_missing",
        )


def require_announced(details: MealDetails, photos: Mapping[str, SealablePhoto]) -> None:
    """Raise InvalidInputError for a slot that was not announced, or a map of another depth camera."""
    slots = announced_slots(details)
    surplus = [slot for slot in photos if slot not in slots and slot != VOICE_NOTE]
    if surplus:
        raise InvalidInputError(
            f"The metadata announced {', '.join(slots)} (by views and depth_maps), so there is no "
            f"{', '.join(surplus)}.",
            code="view_not_announced",
            slots=surplus,
        )
    if "depth_camera" not in details:
        return
    camera = depth_camera_from_mapping(details["depth_camera"])
    for slot, photo in photos.items():
        if slot not in DEPTH_SLOTS:
            continue
        mismatch = size_mismatch(photo.width_px, photo.height_px, camera)
        if mismatch is not None:
            raise InvalidInputError(
                f"The {image_name(slot)}: {mismatch.message} {mismatch.advice}",
                code=mismatch.code,
                slot=slot,
            )


def require_valid_hints(
    session: Session,
    study_id: uuid.UUID,
    hints: Sequence[HintDetails],
    photo: SealablePhoto | MealImage | None,
) -> None:
    """Raise InvalidInputError (`vessel_unknown`, `food_unknown`, `hint_outside`) for the first hint that cannot be.

    photo: the one that the hints point at; None: it has not arrived, so their places are not
    checked.
    """
    require_known_vessels(session, study_id, hints)
    keys = {hint["food"] for hint in hints if hint.get("food")}
    unknown = sorted(keys - set(foods.foods_by_key(session, keys))) if keys else []
    if unknown:
        raise InvalidInputError(
            f"No food table in force has {', '.join(unknown)}: GET /v1/foods lists the foods that there are.",
            code="food_unknown",
            foods=unknown,
        )
    if photo is not None:
        _require_within(hints, photo.width_px, photo.height_px)


def _require_within(hints: Sequence[HintDetails], width_px: int, height_px: int) -> None:
    outside = [
        number
        for number, hint in enumerate(hints)
        for left, top, right, bottom in _bounds(hint)
        if left > width_px or top > height_px or right < 0 or bottom < 0
    ]
    if outside:
        raise InvalidInputError(
            f"Hint {outside[0]} lies outside the photograph, which is {width_px} x {height_px} pixels when upright.",
            code="hint_outside",
            hints=outside,
        )


def _bounds(hint: HintDetails) -> Iterator[tuple[float, float, float, float]]:
    """Yield the left, top, right and bottom of the hint's place, px; nothing if it has no place."""
    if "point" in hint:
        x, y = hint["point"]
        yield x, y, x, y
    elif "box" in hint:
        x, y, width, height = hint["box"]
        yield x, y, x + width, y + height
    elif "polygon" in hint:
        corners = [corner for ring in rings_of(hint["polygon"]) for corner in ring]
        xs, ys = zip(*corners, strict=True)
        yield min(xs), min(ys), max(xs), max(ys)


def _details(
    metadata: MealMetadataIn | AfterMetadataIn | DeclaredMealIn,
    time: MealTime,
    unknown: Mapping[str, JsonValue],
) -> dict[str, Any]:
    """Return the metadata as rows hold them.

    A field with its default is left out unless every row has it. Unknown fields are JSON text, so
    that every database can hold any of them. Raises InvalidInputError (poses).
    """
    fields = type(metadata).model_fields
    details: dict[str, Any] = {
        name: value
        for name, value in metadata.model_dump(mode="json", by_alias=True, exclude={"id"}).items()
        if name in MealDetails.__required_keys__ or value != fields[name].default
    }
    details["captured_at"], details["time_zone"] = time.captured_at.isoformat(), time.time_zone
    if "hints" in details:
        details["hints"] = [_without_nulls(hint) for hint in details["hints"]]
    if details.get("location") is not None:
        details["location"] = _without_nulls(details["location"])
    if "poses" in details:
        poses_from_mapping(details["poses"])
    if unknown:
        details["ignored"], details["unknown"] = sorted(unknown), json.dumps(unknown)
    return details


def _without_nulls(value: Mapping[str, Any]) -> dict[str, Any]:
    return {name: field for name, field in value.items() if field is not None}
