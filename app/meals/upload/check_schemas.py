"""A check of a pair over the wire."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.http.text_schemas import Text
from app.people.calibration_schemas import CameraIn
from app.people.models import Locale


class CheckMetadataIn(BaseModel):
    """The metadata of a check; every field is optional."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"locale": "es"}})

    marker: Text | None = Field(
        default=None,
        max_length=64,
        description="The board, such as plain:9x7:11; default: the study's.",
    )
    camera: CameraIn | None = Field(
        default=None, description="Default: as for a meal of this phone."
    )
    locale: Locale | None = Field(
        default=None, description="Of the sentences; default: Accept-Language, or else the study's."
    )


class CheckProblemOut(BaseModel):
    """One thing to do better."""

    code: str = Field(description="Stable; docs/checks.md and docs/errors.md list them.")
    severity: Literal["stop", "warn"] = Field(
        description="stop: this pair will not be measured. warn: it will be, but worse."
    )
    side: Literal["left", "right"] | None = Field(description="The photograph; null: the pair.")
    message: str = Field(description="One sentence for the participant.")


class CheckOut(BaseModel):
    """The result of a check. Nothing of the pair was kept."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "ok": False,
                "problems": [
                    {
                        "code": "marker_cut_off",
                        "severity": "stop",
                        "side": "left",
                        "message": "The printed pattern is cut off at the edge in the left photo: please step back a "
                        "little or move the phone.",
                    }
                ],
                "measures": {"edge_width_px_right": 3.9, "square_px_right": 58.1},
                "locale": "en",
                "seconds": 0.31,
            }
        }
    )

    ok: bool = Field(description="Nothing stops this pair from being measured.")
    problems: list[CheckProblemOut] = Field(description="Problems of the pair; empty: none.")
    measures: dict[str, float] = Field(
        description="Measured numbers, each with its unit in the name."
    )
    locale: Locale = Field(description="Of the sentences.")
    seconds: float = Field(description="Duration of the check, without the upload.")
