"""Answers may have fields that the app does not know: all of the observer's have one."""

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

STUCK = 4  # times the same call, answered and unanswered by what should follow


def check_unknown_fields(conversation: Conversation) -> Verdict:
    """Fail if the same request comes again and again, though each was carried out: its answer was not understood."""
    runs: dict[str, tuple[tuple[str, str], int]] = {}
    for exchange in conversation.exchanges:
        if exchange.meal is None or exchange.method == "GET":
            continue
        call = exchange.method, exchange.path
        before, count = runs.get(exchange.meal, (call, 0))
        count = count + 1 if before == call and exchange.is_ok and exchange.fault is None else 0
        if count >= STUCK:
            return failed(
                f"{exchange.method} {exchange.path} was answered {count} times, and the phone did not go on."
            )
        runs[exchange.meal] = call, count
    if conversation.complete_meals:
        return passed("A meal was sent whole, by answers with fields that no app knows.")
    return not_seen("Send a meal: the answers have a field that no app knows.")
