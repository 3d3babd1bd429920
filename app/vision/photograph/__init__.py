"""A photograph's file: its pixels upright, its lens, and the depth map that came with it."""
