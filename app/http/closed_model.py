"""The base of what is sent to us as JSON: a field that it does not know is refused, not ignored."""

from pydantic import BaseModel, ConfigDict


class ClosedModel(BaseModel):
    """A model without further fields."""

    model_config = ConfigDict(extra="forbid")
