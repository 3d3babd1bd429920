"""Webhooks: managing a study's subscriptions, and sending what the outbox holds, signed, to checked addresses."""
