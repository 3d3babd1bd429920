"""Limited child processes: everything that decodes uploaded bytes runs in one, with limits of memory and time.

The tasks themselves belong to the domains and are named `module:TASKS`; durable work belongs to jobs.
"""
