"""A photograph stays on the phone until the server has called it durable: one that is lost before comes again."""

from app.extras.conformance.conversation import Conversation, Exchange
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed


def check_durable(conversation: Conversation) -> Verdict:
    """Fail if photographs that were accepted, but not called durable, do not come again with the same bytes."""
    accepted = next(conversation.with_fault("not_durable"), None)
    if accepted is None:
        return not_seen(
            "One photograph is accepted without being durable: send two meals, or five in one request each."
        )
    if accepted.method == "PATCH":
        return _check_pieces(conversation, accepted)
    for sent in accepted.photographs:
        again = [
            photograph.sha256
            for later in conversation.after(accepted)
            for photograph in later.photographs
            if later.meal == accepted.meal and photograph.slot == sent.slot
        ]
        if any(sha256 != sent.sha256 for sha256 in again):
            return failed(f"{sent.slot} of the meal {accepted.meal} came again with other bytes.")
        if not again and conversation.is_overdue(accepted):
            return failed(
                f"{sent.slot} of the meal {accepted.meal} was `missing` in the answer, and did not come again: was it "
                "dropped before it was durable?"
            )
        if not again:
            return not_seen(
                f"{sent.slot} of the meal {accepted.meal} was not durable; it has not come again yet."
            )
    return passed("A photograph that was not durable was kept, and came again with the same bytes.")


def _check_pieces(conversation: Conversation, lost: Exchange) -> Verdict:
    """Judge a photograph whose pieces the server has lost: it is to come again from its first byte."""
    is_back = any(
        later.content == lost.content
        and later.is_ok
        and (later.upload_offset == 0 or later.photographs)
        for later in conversation.after(lost)
    )
    if is_back:
        return passed(
            "A photograph whose pieces the server had lost came again from its first byte."
        )
    if conversation.is_overdue(lost):
        return failed(
            f"The server lost the pieces of {lost.path}, and the photograph did not come again."
        )
    return not_seen(
        f"The server lost the pieces of {lost.path}; the photograph has not come again yet."
    )
