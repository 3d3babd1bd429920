"""A study's vessel library: mugs and bowls measured once, changed under the version that a change is of, and retired.

Nothing is deleted: each change is a new version, and a run refers to the versions that it was
given.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.db.session import Database
from app.http.paging import TEXT, Page, all_rows, decode_cursor, page_of
from app.http.parameters import require_version
from app.people.access.audit import note
from app.people.access.caller import DeviceCaller, StaffCaller
from app.people.models import Study
from app.people.studies import load_study
from app.vessels import queries as vessels
from app.vessels.models import StudyVessel, StudyVesselVersion
from app.vessels.vessel_measures import MeasuredVessel, known_capacity_ml, measured_vessel, name_key
from app.vision.vessel_frustum import profile_capacity_ml
from app.vision.vessel_library import MAX_VESSELS, VesselModel, vessel_to_json

FILL_LINE = ("fill_line_mm", "fill_line_ml")
MEASURES = ("kind", "rim_diameter_mm", "height_mm", "capacity_ml", *FILL_LINE, "inside_profile_mm")


@dataclass(frozen=True, slots=True)
class VesselView:
    """A vessel of a study, in its current or an earlier version."""

    vessel: StudyVessel
    version: StudyVesselVersion

    @property
    def model(self) -> VesselModel:
        """The pipeline's value."""
        row = self.version
        model = VesselModel(
            name=self.vessel.name,
            kind=row.kind,
            rim_diameter_mm=row.rim_diameter_mm,
            height_mm=row.height_mm,
            capacity_ml=row.capacity_ml,
            inside_profile_mm=tuple((radius, height) for radius, height in row.inside_profile_mm),
        )
        return replace(
            model, capacity_ml=known_capacity_ml(model, row.fill_line_mm, row.fill_line_ml)
        )

    @property
    def held_ml(self) -> float | None:
        """What it holds to the brim: measured, or following from the fill line or the profile."""
        model = self.model
        if model.capacity_ml is None and model.inside_profile_mm:
            return profile_capacity_ml(model.inside_profile_mm)
        return model.capacity_ml

    @property
    def held_by(self) -> str:
        """What held_ml follows from."""
        if self.version.capacity_ml is not None:
            return "capacity"
        return "profile" if self.version.inside_profile_mm else "fill line"


@dataclass(frozen=True, slots=True)
class VesselAuthor:
    """Who changes the library. caller: for the audit log; None: by the command line."""

    name: str
    caller: StaffCaller | None = None


@dataclass(frozen=True, slots=True)
class ImportedVessels:
    """How many vessels of a file were added, changed, and there already."""

    added: int
    changed: int
    unchanged: int


def stored_measures(version: StudyVesselVersion) -> dict[str, object]:
    """A version's measures by their JSON keys."""
    return {name: getattr(version, name) for name in MEASURES}


def list_vessels(
    database: Database, study_code: str, *, is_in_use: bool | None, cursor: str | None, limit: int
) -> Page[VesselView]:
    """A study's vessels by name.

    is_in_use: only these; None: retired ones too. Raises NotFoundError.
    """
    listed = f"vessels of {study_code} {is_in_use}"
    after = decode_cursor(listed, cursor, TEXT)
    with database.read() as session:
        study = load_study(session, study_code)
        rows = vessels.page_of_vessels(
            session, study.id, is_in_use=is_in_use, after=after, limit=limit + 1
        )
    views = [VesselView(*row) for row in rows]
    return page_of(listed, views, limit, lambda view: view.vessel.name_key)


def all_vessels(database: Database, study_code: str) -> list[VesselView]:
    """A study's vessels by name, retired ones too, however many. Raises NotFoundError."""

    def read(cursor: str | None) -> Page[VesselView]:
        return list_vessels(database, study_code, is_in_use=None, cursor=cursor, limit=1000)

    return list(all_rows(read))


def vessels_of_phone(database: Database, caller: DeviceCaller) -> list[VesselView]:
    """All vessels in use of a phone's study, by name; at most MAX_VESSELS."""
    with database.read() as session:
        rows = vessels.page_of_vessels(
            session, caller.study_id, is_in_use=True, after=None, limit=MAX_VESSELS
        )
    return [VesselView(*row) for row in rows]


def read_vessel(
    database: Database, study_code: str, vessel_id: uuid.UUID, version: int | None = None
) -> VesselView:
    """A vessel as it is now, or as it was in `version`. Raises NotFoundError."""
    with database.read() as session:
        study = load_study(session, study_code)
        vessel, current = _known(vessels.find_vessel(session, study.id, vessel_id))
        earlier = (
            current if version is None else vessels.vessel_version(session, vessel.id, version)
        )
        if earlier is None:
            raise NotFoundError("The vessel never had this version.", code="vessel_not_found")
        return VesselView(vessel, earlier)


def add_vessel(
    database: Database, study_code: str, measured: MeasuredVessel, author: VesselAuthor
) -> VesselView:
    """Keep a new vessel.

    Raises NotFoundError, ConflictError (`vessel_exists`, `vessels_too_many`).
    """
    with database.write() as session:
        return _add(session, _locked_study(session, study_code), measured, author)


def change_vessel(
    database: Database,
    study_code: str,
    vessel_id: uuid.UUID,
    measures: Mapping[str, object],
    author: VesselAuthor,
    *,
    expected: frozenset[int] | None,
) -> VesselView:
    """Replace a vessel's measures; a retired one is in use again.

    expected: versions the change may be of; None: any.

    measures: as measured_vessel reads them; the name may be None. Raises NotFoundError,
    PreconditionFailedError, InvalidInputError, ConflictError (`vessel_name_fixed`,
    `vessels_too_many`).
    """
    with database.write() as session:
        study = _locked_study(session, study_code)
        vessel, current = _known(vessels.find_vessel(session, study.id, vessel_id))
        require_version(vessel.version, expected, "vessel")
        name = measures.get("name")
        if isinstance(name, str) and name_key(name) != vessel.name_key:
            raise ConflictError(
                "A vessel's name is fixed, since hints and estimates refer to it: retire it and add another.",
                code="vessel_name_fixed",
            )
        measured = measured_vessel({**measures, "name": vessel.name})
        return _change(session, study, VesselView(vessel, current), measured, author)


def retire_vessel(
    database: Database, study_code: str, vessel: uuid.UUID | str, author: VesselAuthor
) -> VesselView:
    """Take a vessel out of use: estimates get it no more, unless a hint names it.

    The same again changes nothing.

    vessel: its id, or its name.
    """
    with database.write() as session:
        study = _locked_study(session, study_code)
        if isinstance(vessel, str):
            view = VesselView(
                *_known(vessels.find_vessel_by_key(session, study.id, name_key(vessel)))
            )
        else:
            view = VesselView(*_known(vessels.find_vessel(session, study.id, vessel)))
        if view.version.is_retired:
            return view
        view.vessel.version += 1
        measures = stored_measures(view.version)
        return _keep_version(
            session, view.vessel, measures, author, "vessel.retire", is_retired=True
        )


def import_vessels(
    database: Database, study_code: str, value: object, author: VesselAuthor
) -> ImportedVessels:
    """All vessels of a parsed JSON list, by name: new ones added, others changed where they differ; all or none.

    Raises NotFoundError, InvalidInputError, ConflictError (`vessels_too_many`).
    """
    if not isinstance(value, list) or len(value) > MAX_VESSELS:
        raise InvalidInputError(
            f"A library is a list of at most {MAX_VESSELS} objects.", code="vessel_invalid"
        )
    library = [measured_vessel(data) for data in value]
    keys = [name_key(measured.model.name) for measured in library]
    if len(set(keys)) < len(keys):
        raise InvalidInputError(
            "Two vessels of the list have the same name.", code="vessel_invalid"
        )
    added = changed = 0
    with database.write() as session:
        study = _locked_study(session, study_code)
        for key, measured in zip(keys, library, strict=True):
            row = vessels.find_vessel_by_key(session, study.id, key)
            if row is None:
                _add(session, study, measured, author)
                added += 1
                continue
            view, before = VesselView(*row), row[0].version
            # an exported capacity may be a fill line's
            if view.version.is_retired or view.model != measured.model:
                changed += _change(session, study, view, measured, author).vessel.version > before
    return ImportedVessels(added, changed, len(library) - added - changed)


def export_vessels(database: Database, study_code: str) -> list[dict[str, object]]:
    """A study's vessels in use, as import_vessels and `tada estimate --vessels` read them.

    Raises NotFoundError.
    """
    page = list_vessels(database, study_code, is_in_use=True, cursor=None, limit=MAX_VESSELS)
    return [
        vessel_to_json(view.model)
        | {name: line for name in FILL_LINE if (line := getattr(view.version, name)) is not None}
        for view in page.rows
    ]


def _add(
    session: Session, study: Study, measured: MeasuredVessel, author: VesselAuthor
) -> VesselView:
    name = measured.model.name
    if vessels.find_vessel_by_key(session, study.id, name_key(name)) is not None:
        raise ConflictError(
            f"The study has a vessel {name!r} already, in use or retired: change that one, or give another name.",
            code="vessel_exists",
        )
    _require_room(session, study)
    vessel = StudyVessel(
        id=uuid.uuid4(),
        study_id=study.id,
        name=name,
        name_key=name_key(name),
        version=1,
        created_at=datetime.now(UTC),
    )
    session.add(vessel)
    session.flush()  # its row first: the version names it
    return _keep_version(session, vessel, measured.columns(), author, "vessel.add")


def _change(
    session: Session, study: Study, view: VesselView, measured: MeasuredVessel, author: VesselAuthor
) -> VesselView:
    if not view.version.is_retired and stored_measures(view.version) == measured.columns():
        return view
    if view.version.is_retired:
        _require_room(session, study)
    view.vessel.version += 1
    return _keep_version(session, view.vessel, measured.columns(), author, "vessel.change")


def _keep_version(
    session: Session,
    vessel: StudyVessel,
    measures: Mapping[str, object],
    author: VesselAuthor,
    action: str,
    *,
    is_retired: bool = False,
) -> VesselView:
    version = StudyVesselVersion(
        vessel_id=vessel.id,
        version=vessel.version,
        **measures,
        is_retired=is_retired,
        author=author.name,
        changed_at=datetime.now(UTC),
    )
    session.add(version)
    note(
        session,
        author.caller,
        action,
        study_id=vessel.study_id,
        subject=vessel.id,
        version=vessel.version,
    )
    session.flush()  # a list that is imported asks for what is there
    return VesselView(vessel, version)


def _require_room(session: Session, study: Study) -> None:
    if vessels.count_in_use(session, study.id) >= MAX_VESSELS:
        raise ConflictError(
            f"The study has {MAX_VESSELS} vessels in use, the limit: retire some first.",
            code="vessels_too_many",
            limit=MAX_VESSELS,
        )


def _locked_study(session: Session, code: str) -> Study:
    """The study, held: of two that add at the same time the second sees the first's."""
    return load_study(session, code, lock=True)


def _known(row: vessels.VesselRow | None) -> vessels.VesselRow:
    if row is None:
        raise NotFoundError("The study has no such vessel.", code="vessel_not_found")
    return row
