import json
from datetime import UTC, datetime

import pytest
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from app.http.model_response import ModelResponse


class Answer(BaseModel):
    name: str
    at: datetime
    grams: float | None
    pair: tuple[float, float]


@pytest.mark.parametrize("grams", [None, -0.0, 1 / 3, 1e16, 5e-324])
def test_model_is_written_as_json_of_its_values(grams):
    answer = Answer(name='日 "ü"\n</script>', at=datetime(2026, 11, 20, 12, tzinfo=UTC), grams=grams, pair=(1.0, 2.5))
    response = ModelResponse(answer, status_code=201, headers={"ETag": '"1"'})
    as_values = JSONResponse(answer.model_dump(mode="json"))
    assert json.loads(response.body) == json.loads(as_values.body)
    assert response.headers["content-type"] == as_values.headers["content-type"]
    assert (response.status_code, response.headers["ETag"]) == (201, '"1"')
