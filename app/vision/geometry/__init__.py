"""Geometry and image operations that know nothing of food: meshes, masks, slices, the view from above."""
