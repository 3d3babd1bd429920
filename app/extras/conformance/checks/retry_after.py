"""429 and 503 say how long to wait, and the phone waits for so long."""

from app.extras.conformance.conversation import GRACE_SECONDS, Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

TOLERANCE_SECONDS = 0.2  # the phone's clock starts when the answer arrives


def check_retry_after(conversation: Conversation) -> Verdict:
    """Fail for a request that comes again too early, or not at all."""
    waited = 0
    for refused in conversation.exchanges:
        if refused.status not in {429, 503} or refused.retry_after is None:
            continue
        again = conversation.again(refused)
        if again is None:
            if conversation.is_overdue(refused, refused.retry_after + GRACE_SECONDS):
                return failed(
                    f"{refused.method} {refused.path} was answered {refused.status} and did not come again."
                )
            continue
        pause = again.at - refused.ended_at
        if pause < refused.retry_after - TOLERANCE_SECONDS:
            return failed(
                f"{refused.method} {refused.path} came again after {pause:.1f} s, "
                f"Retry-After was {refused.retry_after:g}."
            )
        waited += 1
    if waited:
        return passed(f"Refused requests that came again no earlier than Retry-After: {waited}.")
    return not_seen("A photograph is answered 503, and the next meal 429: send two meals.")
