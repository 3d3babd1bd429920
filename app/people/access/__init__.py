"""Who calls and what they may do: staff, sign-in, tokens, roles in a study, the rule of each route, the audit log.

Routes without a rule are refused to everybody.
"""
