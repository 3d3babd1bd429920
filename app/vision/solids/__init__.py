"""From a mask to a volume with its interval: closed forms fitted to all views, and what fills a bowl."""
