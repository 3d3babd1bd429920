"""Limited child processes: whatever decodes uploaded bytes runs in one, with limits of memory and processor time.

What a child computes is given by name (`module:TASKS`) and belongs to the domains; durable work belongs to jobs.
"""
