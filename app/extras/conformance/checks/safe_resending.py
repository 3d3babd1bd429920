"""A request whose answer was lost is sent again as it was: the server knows it by its id."""

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed


def check_safe_resending(conversation: Conversation) -> Verdict:
    """Fail if the metadata did not come again after a lost answer, or came changed."""
    lost = next(conversation.with_fault("lost_answer"), None)
    if lost is None:
        return not_seen("The answer to the first meal's metadata is lost: send a meal.")
    again = conversation.again(lost)
    if again is None:
        if conversation.is_overdue(lost):
            return failed(
                f"The answer to {lost.method} {lost.path} was lost, and the request did not come again."
            )
        return not_seen(
            f"The answer to {lost.method} {lost.path} was lost; it has not come again yet."
        )
    if again.metadata != lost.metadata:
        return failed(f"{again.method} {again.path} came again with other metadata.")
    return passed(
        f"{again.method} {again.path} came again unchanged, and was answered {again.status}."
    )
