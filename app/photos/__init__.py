"""The bytes of a photograph, never decoded: what they are, whether they are whole, and where they tell a location."""
