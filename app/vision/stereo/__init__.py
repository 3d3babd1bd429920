"""Two views of one scene: matches, poses, rectification, disparity, points over the table, and their doubt."""
