"""The printed board: found, identified, its colours, and the camera that sees it (intrinsics, pose over the board)."""
