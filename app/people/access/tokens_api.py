"""/v1/tokens: personal API tokens of the signed-in staff member. Tokens cannot create tokens."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path, Response

from app.http.flat_list import ListRoute
from app.http.problems import problem_responses
from app.people.access import access_tokens
from app.people.access.deps import CurrentStaff, State
from app.people.access.staff_schemas import TokenIn, TokenIssued, TokenList, TokenOut

router = APIRouter(prefix="/v1/tokens", tags=["tokens"], route_class=ListRoute)


@router.get("", responses=problem_responses(401, 403))
def get_tokens(state: State, caller: CurrentStaff) -> TokenList:
    """The caller's valid tokens, without their secrets."""
    tokens = access_tokens.list_tokens(state.database, caller)
    return TokenList(
        items=[TokenOut.model_validate(token, from_attributes=True) for token in tokens]
    )


@router.post("", status_code=201, responses=problem_responses(401, 403, 404, 409, 422))
def post_token(body: TokenIn, state: State, caller: CurrentStaff) -> TokenIssued:
    """Create a token; it is shown once. At each call it has its creator's rights, restricted by scope and study."""
    token, view = access_tokens.create_token(
        state.database,
        caller,
        name=body.name,
        scope=body.scope,
        study_code=body.study,
        days=body.days,
    )
    return TokenIssued(
        token=token, **TokenOut.model_validate(view, from_attributes=True).model_dump()
    )


@router.delete("/{token_id}", status_code=204, responses=problem_responses(401, 403, 404, 422))
def delete_token(
    token_id: Annotated[uuid.UUID, Path(description="The token's id.")],
    state: State,
    caller: CurrentStaff,
) -> Response:
    """End one of the caller's tokens."""
    access_tokens.revoke_token(state.database, caller, token_id)
    return Response(status_code=204)
