"""Reminders on participants' phones by Web Push: who wants them, when they are due, how they are encrypted and sent.

Not here: what a reminder says, which the phone's page adds in its own language; webhooks, whose guarded POST it uses.
"""
