"""One view of a scene or several: matches, poses, rectification, disparity, points over the table, and their doubt."""
