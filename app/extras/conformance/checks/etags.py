"""A change names the version that it was made from (If-Match); a refused one is made anew from the meal as it is."""

import re

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

_CHANGE = re.compile(r"^/v1/meals/[^/]+/events$|^/v1/me/days/[^/]+$")


def check_etags(conversation: Conversation) -> Verdict:
    """Fail for a change without If-Match, and for one that is repeated with a version that was refused."""
    changes = [
        each for each in conversation.exchanges if each.method != "GET" and _CHANGE.match(each.path)
    ]
    without = next((change for change in changes if change.if_match is None), None)
    if without is not None:
        return failed(f"{without.method} {without.path} came without If-Match.")
    refused = next((change for change in changes if change.fault == "stale"), None)
    if refused is None:
        return not_seen(
            "The first change of a meal is answered as if the meal had changed: confirm or correct a food."
        )
    for later in conversation.after(refused):
        if later.meal != refused.meal:
            continue
        if later.method == "GET" or later.if_match != refused.if_match:
            return passed(
                "Changes name their version, and a refused one was followed by reading the meal."
            )
        if later in changes:
            return failed(
                f"{later.method} {later.path} came again with the version that was refused."
            )
    if conversation.is_overdue(refused):
        return failed(
            f"{refused.path} was refused because the meal had changed, and the meal was not read again."
        )
    return not_seen(
        f"{refused.path} was refused because the meal had changed; it was not read again yet."
    )
