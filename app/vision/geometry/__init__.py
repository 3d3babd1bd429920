"""Geometry and image operations that several rooms share and that know nothing of food: meshes, masks, slices."""
