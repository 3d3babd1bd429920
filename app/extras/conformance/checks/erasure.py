"""An erased meal is not sent again; a phone whose participant has left sends nothing."""

from app.extras.conformance.conversation import Conversation, Exchange
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

UNDER_WAY_SECONDS = 2.0  # requests that were sent before the answer was read
LEAVING = "/v1/me/withdrawal"


def check_erasure(conversation: Conversation) -> Verdict:
    """Fail if an erased meal comes again, or if a phone goes on calling after its participant has left."""
    seen = 0
    for exchange in conversation.exchanges:
        is_leaving = _ends_participation(exchange)
        if not is_leaving and not _erases_meal(exchange):
            continue
        seen += 1
        for later in conversation.after(exchange):
            if later.at - exchange.ended_at < UNDER_WAY_SECONDS:
                continue
            if is_leaving and later.is_authorised:
                return failed(
                    f"The participant had left, and {later.method} {later.path} came with the token."
                )
            if later.meal == exchange.meal and later.content is not None:
                return failed(
                    f"The meal {later.meal} was erased, and {later.method} {later.path} came again."
                )
    if seen:
        return passed("What was erased did not come again.")
    return not_seen("Erase a meal in the app, or leave the study.")


def _ends_participation(exchange: Exchange) -> bool:
    return (exchange.is_ok and exchange.path == LEAVING) or exchange.code == "withdrawn"


def _erases_meal(exchange: Exchange) -> bool:
    return exchange.meal is not None and (
        (
            exchange.is_ok
            and exchange.method == "DELETE"
            and exchange.path == f"/v1/meals/{exchange.meal}"
        )
        or exchange.code == "meal_deleted"
    )
