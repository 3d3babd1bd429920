"""Ids of meals are made by the phone, once per meal: sending again doubles nothing."""

from collections import defaultdict

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

LEAST_MEALS = 2


def check_ids(conversation: Conversation) -> Verdict:
    """Fail for a photograph that comes again under another id, and for an id that is used for two meals."""
    reused = next((each for each in conversation.exchanges if each.code == "meal_id_reused"), None)
    if reused is not None:
        return failed(
            f"The id {reused.meal} came again with other content ({reused.method} {reused.path})."
        )
    captured_at = {
        each.meal: each.metadata.get("captured_at")
        for each in conversation.exchanges
        if each.metadata is not None
    }
    ids: dict[tuple[str, object], set[str | None]] = defaultdict(set)
    for exchange in conversation.exchanges:
        for photograph in exchange.photographs:
            ids[photograph.sha256, captured_at.get(exchange.meal)].add(exchange.meal)
    doubled = next((meals for meals in ids.values() if len(meals) > 1), None)
    if doubled is not None:
        return failed(
            f"One photograph came under several ids: {', '.join(sorted(map(str, doubled)))}."
        )
    count = len(conversation.complete_meals)
    if count < LEAST_MEALS:
        return not_seen(f"Send {LEAST_MEALS} meals; {count} arrived.")
    return passed(f"{count} meals, each with an id of its own.")
