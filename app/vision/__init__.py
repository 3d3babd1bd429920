"""From a pair of photographs to volumes: a file a step, NumPy and OpenCV only (frames and signs: CONVENTIONS.md)."""
