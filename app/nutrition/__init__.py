"""Millilitres to grams to nutrients: pure functions and the starter food table, without a database."""
