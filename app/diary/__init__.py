"""Days: closed and open days, their stored sums, participants' feedback, and a study's overview and adequacy.

Sums of days are read from day_sum_queries.py and nowhere else; day_definition.py defines them.
"""
