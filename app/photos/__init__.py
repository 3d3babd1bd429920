"""The bytes of a photograph, never decoded: what they are, whether they are whole, and where they tell a location.

Everything here runs in a limited child on whatever a phone, or somebody else, sends. So it is Python that reads
structure by offsets with every bound checked, in time linear in the file; no image library, no decompression.
"""
