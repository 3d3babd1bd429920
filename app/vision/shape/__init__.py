"""From a mask to a volume with its interval: closed forms fitted to both views, the paper's slices, bowls."""
