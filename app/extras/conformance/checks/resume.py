"""After a broken upload the phone sends what is missing, and nothing that is already durable."""

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed


def check_resume(conversation: Conversation) -> Verdict:
    """Fail if the broken photograph did not come again, or if a durable one is sent again by itself."""
    durable: set[tuple[str, str]] = set()
    for exchange in conversation.exchanges:
        if exchange.content in durable and exchange.method == "PUT":
            return failed(
                f"{exchange.path} was sent again, though the server had said that it is durable."
            )
        durable |= {(exchange.meal, slot) for slot in exchange.durable if exchange.meal is not None}
    broken = next(conversation.with_fault("lost_request"), None)
    if broken is None:
        return not_seen("The upload of the first photograph is broken off: send a meal.")
    again = conversation.again(broken)
    while again is not None and not again.is_ok:
        again = conversation.again(again)
    if again is not None:
        return passed(f"{broken.path} was broken off and came again.")
    if conversation.is_overdue(broken):
        return failed(f"{broken.path} was broken off and never arrived.")
    return not_seen(f"{broken.path} was broken off; it has not arrived yet.")
