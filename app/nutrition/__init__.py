"""From millilitres to grams to nutrients: pure functions and the starter food table; knows no database."""
