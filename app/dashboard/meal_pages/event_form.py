"""A form's fields as a word about a meal: into the same models that check what comes over the API."""

import json
import re
import uuid
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from app.core.errors import InvalidInputError
from app.dashboard.refusals import sentence
from app.records.review.schemas import AnyEventIn, EventIn

EVENTS: TypeAdapter[AnyEventIn] = TypeAdapter(EventIn)
LABELS: Mapping[str, str] = {
    "mass_g": "Grams",
    "volume_ml": "Millilitres",
    "relative_sd": "How far off it may be",
    "polygon": "Outline",
    "food": "Food",
    "text": "Text",
    "share": "Share",
    "portion": "Household measure",
    "count": "How many",
}
LEFTOVER_FIELDS = {"leftover_of": "of", "leftover_class": "class"}
AMOUNT_FIELDS = ("mass_g", "volume_ml", "portion", "count", "of", "relative_sd")
_PAIR = re.compile(r"[\s,;]+")

Short = Annotated[str, Field(max_length=200)]


class EventForm(BaseModel):
    """What the forms send; a field that is empty is not told.

    id: made with the form, so that a form that is sent twice says one thing. version: of the meal as it was shown.
    seen: number of the last event that the page showed, so that a conflict can tell what came after it. q: what was
    typed in a search of foods; a food's key, where none was chosen from the list.
    """

    model_config = ConfigDict(extra="forbid")

    id: uuid.UUID
    kind: Annotated[str, Field(max_length=32)]
    version: Annotated[int, Field(ge=0)]
    seen: Annotated[int, Field(ge=0)] = 0
    item: Short = ""
    food: Short = ""
    q: Short = ""
    lies_as: Short = ""
    mass_g: Short = ""
    of: Short = ""
    portion: Short = ""
    count: Short = ""
    volume_ml: Short = ""
    relative_sd: Short = ""
    share: Short = ""
    text: Annotated[str, Field(max_length=4000)] = ""
    event: Short = ""
    leftover_of: Short = ""
    leftover_class: Short = ""
    polygon: Annotated[str, Field(max_length=100_000)] = ""

    def told(self) -> dict[str, str]:
        """The fields that say something, for a form that says it again."""
        fields: dict[str, str] = self.model_dump(exclude={"id", "version", "seen", "q"})
        fields["food"] = self.food or self.q
        return {name: value for name, value in fields.items() if value.strip()}


def event_of(form: EventForm) -> AnyEventIn:
    """The event that a form tells. Raises InvalidInputError."""
    try:
        return EVENTS.validate_python(_body(form))
    except ValidationError as error:
        raise _refused(error) from None


def read_polygon(text: str) -> list[tuple[float, float]]:
    """Corners as JSON, [[x, y], ...], or a corner a line: `812, 560`. Raises InvalidInputError."""
    stripped = text.strip()
    try:
        if stripped.startswith("["):
            rows = json.loads(stripped)
            return [(float(x), float(y)) for x, y in rows]
        return [(float(x), float(y)) for x, y in (_PAIR.split(line.strip()) for line in stripped.splitlines() if line)]
    except (ValueError, TypeError, RecursionError):
        raise InvalidInputError(
            "Outline: write one corner a line, x and y in pixels of the left photograph, such as `812, 560`."
        ) from None


def _body(form: EventForm) -> dict[str, Any]:
    """In the words of the API."""
    told: dict[str, Any] = {name: value.strip() for name, value in form.told().items()}
    if "polygon" in told:
        told["polygon"] = read_polygon(told["polygon"])
    if "mass_g" not in told:  # a choice that is always there says nothing by itself
        told.pop("of", None)
    if form.kind == "add":
        amount = {name: told.pop(name) for name in AMOUNT_FIELDS if name in told}
        told |= {"amount": amount} if amount else {}
        told |= {"region": {"polygon": told.pop("polygon")}} if "polygon" in told else {}
    if form.kind == "set_leftover":
        told = {LEFTOVER_FIELDS.get(name, name): value for name, value in told.items()}
        told.setdefault("of", None)
    return {"id": form.id, **told}


def _refused(error: ValidationError) -> InvalidInputError:
    """The first thing that is wrong, in a sentence that names the field as the form does."""
    first = error.errors(include_url=False, include_input=False)[0]
    names = [str(part) for part in first["loc"]]
    label = next((LABELS[name] for name in names if name in LABELS), None)
    told = sentence(first["type"], first["msg"])
    return InvalidInputError(f"{label}: {told}" if label else f"This cannot be said of a meal: {told}")
