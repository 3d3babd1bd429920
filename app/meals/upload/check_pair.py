"""Check a pair before it is sent: problems, each with a sentence in the participant's language. Nothing is kept."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from app.children.api_children import ApiChildren, Whose
from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.db.session import Database
from app.http.upload import ReceivedFile
from app.meals.estimate.camera_choice import choose_camera
from app.meals.estimate.camera_json import camera_to_json
from app.messages.catalogue import choose_locale, sentence
from app.people.access.caller import DeviceCaller
from app.people.calibration_models import CameraDetails
from app.people.models import Locale, Study
from app.vision.marker_spec import parse_marker

SECONDS = 10.0  # limit of one check: many times the need of a slow machine


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """The metadata of a check. camera: as in a camera file. locale, accept_language: as sent."""

    marker: str | None = None
    camera: CameraDetails | None = None
    locale: str | None = None
    accept_language: str | None = None


@dataclass(frozen=True, slots=True)
class PairProblem:
    """A problem with its sentence. severity: "stop" or "warn"; side: "left", "right" or None, the pair."""

    code: str
    severity: str
    side: str | None
    message: str


@dataclass(frozen=True, slots=True)
class CheckedPair:
    """is_ok: no problem with the severity "stop". measures: by name with unit. seconds: duration of the check."""

    is_ok: bool
    problems: tuple[PairProblem, ...]
    measures: Mapping[str, float]
    locale: Locale
    seconds: float


def check_pair(
    database: Database,
    children: ApiChildren,
    settings: Settings,
    caller: DeviceCaller,
    request: CheckRequest,
    files: Mapping[str, ReceivedFile],
) -> CheckedPair:
    """Check a pair. Raises InvalidInputError (`marker_missing`), UnavailableError (`server_busy`), PhotographError."""
    started = time.perf_counter()
    whose = Whose(caller.study_id, caller.device_id)
    inspected = children.inspect([file.path for file in files.values()], whose)
    with database.read() as session:
        study = session.get_one(Study, caller.study_id)
        marker = request.marker or study.marker
        chosen = choose_camera(
            session,
            meal_camera=request.camera,
            device_id=caller.device_id,
            study=study,
            sizes=inspected.sizes or [(1, 1)],
        )
    if marker is None:
        raise InvalidInputError(
            "Neither the metadata nor the study says which marker lies beside the plate: send marker, "
            "such as plain:9x7:11.",
            code="marker_missing",
        )
    parse_marker(marker)
    locale = choose_locale(request.locale, request.accept_language, study.locale)
    result = children.run(
        "check",
        {
            "left": str(files["left"].path),
            "right": str(files["right"].path),
            "marker": marker,
            "camera": camera_to_json(chosen.camera) if chosen.camera is not None else None,
            "max_pixels": settings.max_photo_pixels,
        },
        seconds=SECONDS,
        whose=whose,
        is_costly=inspected.is_costly,
    )
    problems = tuple(
        _problem(each["code"], each["severity"], each["side"], locale)
        for each in result["problems"]
    )
    return CheckedPair(
        result["ok"], problems, result["measures"], locale, round(time.perf_counter() - started, 3)
    )


def _problem(
    code: str, severity: str, side: Literal["left", "right"] | None, locale: Locale
) -> PairProblem:
    return PairProblem(code, severity, side, sentence(code, locale, side) or code)
