"""What a call was refused with."""


def refusal(answer):
    """(status, code) of a problem document; the code of another answer is None."""
    return answer.status_code, answer.json().get("code")
