"""Which food a described region is: pure mathematics over vectors; knows neither pictures nor the database."""
