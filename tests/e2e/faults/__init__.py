"""A deployment of real processes, phones that send it meals, faults by a seed, and a checker of what must hold.

deployment.py starts it all, schedule.py breaks it, phones.py sends, invariants.py looks at what came of it.
"""
