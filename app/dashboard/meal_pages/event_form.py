"""The forms that send a review event: their fields as the API's event models."""

import json
import re
import uuid
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from app.core.errors import InvalidInputError
from app.dashboard.forms import sentence, with_point
from app.http.closed_model import ClosedModel
from app.records.review.schemas import AnyEventIn, EventIn

EVENTS: TypeAdapter[AnyEventIn] = TypeAdapter(EventIn)
HAND_LABELS: Mapping[str, str] = {  # the numbers of a form by hand
    "section": "Form",
    "length_mm": "Length",
    "width_mm": "Width",
    "height_mm": "Height",
    "yaw_deg": "Turned by",
    "lean_deg": "Leans by",
    "base_mm": "Foot above the table",
    "x_mm": "Place, x",
    "y_mm": "Place, y",
}
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
    **HAND_LABELS,
    "centre_mm": "Place",
}
LEFTOVER_FIELDS = {"leftover_of": "of", "leftover_class": "class"}
AMOUNT_FIELDS = ("mass_g", "volume_ml", "portion", "count", "of", "relative_sd")
NUMBERS = ("mass_g", "count", "volume_ml", "relative_sd", "share", *HAND_LABELS)
_PAIR = re.compile(r"[\s,;]+")

Short = Annotated[str, Field(max_length=200)]


class EventForm(ClosedModel):
    """The fields of all these forms; empty ones are left out.

    id: made with the form, so that sending it twice makes one event. version: of the meal as it was
    shown. seen: number of the last event that the page showed, so that a conflict can show the
    later ones. q: text of the food search; a food's key if none was chosen from the list. accepts:
    not empty: store an implausible amount.
    """

    id: uuid.UUID
    kind: Annotated[str, Field(max_length=32)]
    version: Annotated[int, Field(ge=0)]
    seen: Annotated[int, Field(ge=0)] = 0
    accepts: Short = ""
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
    polygon: Annotated[str, Field(max_length=200_000)] = ""
    section: Short = ""
    length_mm: Short = ""
    width_mm: Short = ""
    height_mm: Short = ""
    yaw_deg: Short = ""
    lean_deg: Short = ""
    base_mm: Short = ""
    x_mm: Short = ""
    y_mm: Short = ""

    def filled_fields(self) -> dict[str, str]:
        """Return the fields that are not empty, for a form that sends the event again."""
        fields: dict[str, str] = self.model_dump(exclude={"id", "version", "seen", "q", "accepts"})
        fields["food"] = self.food or self.q
        return {name: value for name, value in fields.items() if value.strip()}


def event_of(form: EventForm) -> AnyEventIn:
    """Return the event of a form. Raises InvalidInputError."""
    try:
        return EVENTS.validate_python(_body(form))
    except ValidationError as error:
        raise _refusal(error) from None


def read_polygon(text: str) -> object:
    """Read corners one per line, `812, 560`, or JSON as the API takes it: a ring or rings.

    Raises InvalidInputError.
    """
    stripped = text.strip()
    try:
        if stripped.startswith("["):
            return json.loads(stripped)
        return [
            (float(x), float(y))
            for x, y in (_PAIR.split(line.strip()) for line in stripped.splitlines() if line)
        ]
    except (ValueError, TypeError, RecursionError):
        raise InvalidInputError(
            "Outline: write one corner per line, x and y in pixels of the left photograph, such as `812, 560`."
        ) from None


def _body(form: EventForm) -> dict[str, object]:
    """Return the fields as the API's body has them."""
    body: dict[str, object] = {name: value.strip() for name, value in form.filled_fields().items()}
    body |= {name: with_point(str(body[name])) for name in NUMBERS if name in body}
    if "polygon" in body:
        body["polygon"] = read_polygon(form.polygon)
    if "mass_g" not in body:  # the form always sends this choice
        body.pop("of", None)
    if form.kind == "add":
        amount = {name: body.pop(name) for name in AMOUNT_FIELDS if name in body}
        body |= {"amount": amount} if amount else {}
        body |= {"region": {"polygon": body.pop("polygon")}} if "polygon" in body else {}
    if form.kind == "reshape":
        shaped = {name: body.pop(name) for name in HAND_LABELS if name in body}
        centre = [shaped.pop(name, None) for name in ("x_mm", "y_mm")]
        body["form"] = {**shaped, "centre_mm": centre}
    if form.kind == "set_leftover":
        body = {LEFTOVER_FIELDS.get(name, name): value for name, value in body.items()}
        body.setdefault("of", None)
    return {"id": form.id, "strict": not form.accepts, **body}


def _refusal(error: ValidationError) -> InvalidInputError:
    """Return the first error as a sentence that names the field by its label."""
    first = error.errors(include_url=False, include_input=False)[0]
    names = [str(part) for part in first["loc"]]
    label = next((LABELS[name] for name in names if name in LABELS), None)
    text = sentence(first["type"], first["msg"])
    return InvalidInputError(f"{label}: {text}" if label else f"This event is not possible: {text}")
