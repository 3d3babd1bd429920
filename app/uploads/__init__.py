"""What a phone sends and asks: meals, after-meal pairs, declared meals, checks before sending, waiting, cancelling."""
