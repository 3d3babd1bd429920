"""The description of an operator's network, `TADA_CLASSIFIER`: which file, its digest, its labels, its input.

A TOML file; docs/identification.md, "A network of your own", has an example. Paths in it are relative to its folder.
"""

import csv
import hashlib
import io
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from app.core.errors import Failure

MAX_MODEL_BYTES = 512 * 1024 * 1024
MAX_TEXT_BYTES = 1024 * 1024  # of the description and of the labels
MAX_SIDE_PX = 1024
MAX_LABELS = 10_000

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Described(BaseModel):
    """The TOML file."""

    model_config = ConfigDict(extra="forbid")

    model: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    labels: str
    width_px: int = Field(ge=1, le=MAX_SIDE_PX)
    height_px: int = Field(ge=1, le=MAX_SIDE_PX)
    mean: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    scale: tuple[Finite, Finite, Finite] = (1 / 255, 1 / 255, 1 / 255)
    channels: Literal["rgb", "bgr"] = "rgb"
    answers: Literal["scores", "probabilities"] = "scores"
    studies: list[str] | None = None


@dataclass(frozen=True, slots=True)
class FoodClassifier:
    """A described network. food_keys: of each of its outputs, None for what is no food of a table.

    studies: codes of those whose meals it sees; None: all. network_input: keys of vision/looks/food_model.NetworkInput.
    """

    model: Path
    sha256: str
    food_keys: tuple[str | None, ...]
    network_input: dict[str, Any]
    studies: frozenset[str] | None

    @property
    def version(self) -> str:
        """Names the network in a run's parameters."""
        return f"{self.model.stem[:60]} {self.sha256[:12]}"


def read_classifier(path: Path) -> FoodClassifier | Failure:
    """Return the described network. Failure "classifier_unreadable"."""
    try:
        described = _Described.model_validate(tomllib.loads(_text(path)))
        keys = _food_keys(_text(path.parent / described.labels))
    except ValidationError as error:
        first = error.errors()[0]
        return _unreadable(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}")
    except (OSError, ValueError, csv.Error) as error:
        return _unreadable(path, str(error))
    network_input = described.model_dump(exclude={"model", "sha256", "labels", "studies"}) | {
        "labels": len(keys)
    }
    return FoodClassifier(
        model=path.parent / described.model,
        sha256=described.sha256,
        food_keys=keys,
        network_input=network_input,
        studies=None if described.studies is None else frozenset(described.studies),
    )


def read_model(path: Path, sha256: str) -> bytes | Failure:
    """Return the model's bytes, which have this digest.

    Failures "classifier_unreadable", "classifier_too_large" and "classifier_digest_differs".
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_MODEL_BYTES + 1)
    except OSError as error:
        return _unreadable(path, str(error.strerror))
    if len(content) > MAX_MODEL_BYTES:
        limit = MAX_MODEL_BYTES // 1024**2
        return Failure("classifier_too_large", f"The model {path} is larger than {limit} MiB.")
    actual = hashlib.sha256(content).hexdigest()
    if actual != sha256:
        return Failure(
            "classifier_digest_differs", f"The model {path} has the SHA-256 {actual}, not {sha256}."
        )
    return content


def _food_keys(text: str) -> tuple[str | None, ...]:
    """Lines of label and food_key, in the order of the network's outputs; an empty key is no food."""
    rows = list(csv.DictReader(io.StringIO(text)))
    if not rows or len(rows) > MAX_LABELS or any(row.get("food_key") is None for row in rows):
        raise ValueError(
            f"the labels need the columns label and food_key, and 1 to {MAX_LABELS} lines"
        )
    return tuple(row["food_key"].strip() or None for row in rows)


def _text(path: Path) -> str:
    with path.open("rb") as file:
        content = file.read(MAX_TEXT_BYTES + 1)
    if len(content) > MAX_TEXT_BYTES:
        raise ValueError(f"{path} is larger than {MAX_TEXT_BYTES // 1024} KiB")
    return content.decode()


def _unreadable(path: Path, reason: str) -> Failure:
    return Failure("classifier_unreadable", f"{path} cannot be used: {reason}.")
