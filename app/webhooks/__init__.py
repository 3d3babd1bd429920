"""Webhooks: manage a study's subscriptions, and send the outbox's deliveries, signed, to checked addresses."""
