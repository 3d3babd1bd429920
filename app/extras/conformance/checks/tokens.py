"""Tokens and enrolment codes travel in headers and bodies: addresses end up in logs and histories."""

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

LEAST_CALLS = 5


def check_tokens(conversation: Conversation) -> Verdict:
    """Fail for an address that contains one."""
    leaking = next((each for each in conversation.exchanges if each.has_secret_in_url), None)
    if leaking is not None:
        return failed(
            f"A token or an enrolment code stood in the address of {leaking.method} {leaking.path}."
        )
    count = sum(each.is_authorised for each in conversation.exchanges)
    if count < LEAST_CALLS:
        return not_seen(f"{count} calls with a token; {LEAST_CALLS} are looked at.")
    return passed(f"None in the addresses of {count} calls.")
