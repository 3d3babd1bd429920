"""Studies, participants, their phones and cameras, and what is remembered of those who were erased.

Who may do what is in people/access. What a participant ate belongs to meals, records and diary.
"""
