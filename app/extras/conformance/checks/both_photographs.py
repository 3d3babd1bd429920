"""A meal has two photographs, from the left and from the right, and both arrive."""

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

PAIR = {"left", "right"}


def check_both_photographs(conversation: Conversation) -> Verdict:
    """Fail for a pair of the same photograph, and for a meal that stays incomplete."""
    whole = 0
    announced = {
        each.meal: each
        for each in conversation.exchanges
        if each.metadata is not None and each.meal
    }
    for meal, first in announced.items():
        if first.metadata is None or first.metadata.get("views", 2) != 2:
            continue
        digests = {
            photograph.slot: photograph.sha256
            for exchange in conversation.exchanges
            if exchange.meal == meal
            for photograph in exchange.photographs
        }
        if digests.keys() >= PAIR and digests["left"] == digests["right"]:
            return failed(f"The photographs of the meal {meal} are the same file twice.")
        if meal in conversation.complete_meals:
            whole += 1
        elif conversation.is_overdue(first) and not _is_erased(conversation, meal):
            return failed(
                f"The meal {meal} is not complete: its photographs are {', '.join(sorted(digests)) or 'none'}."
            )
    return (
        passed(f"Pairs that arrived: {whole}.")
        if whole
        else not_seen("Send a meal with two photographs.")
    )


def _is_erased(conversation: Conversation, meal: str | None) -> bool:
    return any(
        each.meal == meal and (each.method == "DELETE" or each.status == 410)
        for each in conversation.exchanges
    )
