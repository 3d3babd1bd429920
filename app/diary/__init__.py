"""Days: closed and open days, participants' feedback, and a study's overview and adequacy.

day_definition.py says what a day comes to.
"""
